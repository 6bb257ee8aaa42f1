"""The page on how each method was tuned and on what, generated from the specs and the shipped experiments."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from evalkit.config.experiment import Method
from evalkit.config.experiment_file import load_experiment
from evalkit.odometry.frontend import settable_parameters
from evalkit.plugins import registry
from evalkit_docs.markup import code, page, table, text

REPORTS = Path(__file__).resolve().parents[2] / "reports"
EXPERIMENTS = ("quick.toml", "default.toml", "peers.toml", "matchers.toml")
"""The comparisons that are shipped."""


def write_tuning() -> str:
    """Return the page (Markdown)."""
    return page(
        "# How each method was tuned, on what",
        "Results on a data set that a method was tuned on are optimistic: the report marks such rows, and its "
        "answer does not count them there.",
        "## The same for all",
        "The largest distance of a pair has more influence than any other setting. For every registration it was "
        "chosen from the same four values (0.2, 0.3, 0.5, 1.0 m) on the same runs: `lab`, `loop` and `office` with "
        "seed 7, which no shipped experiment uses, and the recordings `fr079` and `intel`. The cells of KISS-ICP's "
        "map were chosen from 0.12, 0.2, 0.3 and 0.5 m on the same runs. This choice had the same budget for all "
        "and does not count as tuning below. Neither does KISS-ICP's longest range, 12 m rather than 30 m, which "
        "was chosen on `intel` and favours it there.",
        "## Back ends",
        "Defaults of these back ends alone were chosen on:",
        table(("back end", "data sets"), _back_end_rows()),
        "No other default of these was chosen on any data set: "
        + ", ".join(f"`{name}`" for name in registry.names("backends") if not registry.backend(name).tuned_on)
        + ".",
        "## Methods of the shipped experiments",
        "Methods with settings of their own, each against the same choice of local maps: `keyframes` (the last ten) or "
        "`voxels` (one lasting map). The settings of the lasting map were chosen for the paper's ICP on `fr079` and "
        "`intel`; every method that uses them carries these names.",
        table(("experiment", "method", "differs from its back end by", "tuned on"), _method_rows()),
        "`kiss-icp tuned` is the result of `evalkit tune` on `lab` and `loop` with 24 points, as every method of "
        "`reports/tune.toml` gets: on fresh seeds of these worlds its error is 0.51 (0.42 to 0.65) of that of the "
        "default, at 5.7 times the time per scan. [Tune](../tune.md) describes the search.",
    )


def _back_end_rows() -> Iterator[tuple[str, str]]:
    for name in registry.names("backends"):
        if spec := registry.backend(name).tuned_on:
            yield code(name), text(", ".join(spec))


def _method_rows() -> Iterator[tuple[str, str, str, str]]:
    for file in EXPERIMENTS:
        for method in load_experiment(REPORTS / file).methods:
            if method.label != method.backend or method.tuned_on:
                yield code(file), text(method.label), _differences(method), text(", ".join(method.tuned_on) or "none")


def _differences(method: Method) -> str:
    defaults = {one.name: one.default for one in settable_parameters(registry.backend(method.backend))}
    changed = (f"{name} = {value}" for name, value in method.parameters.items() if defaults.get(name) != value)
    return ", ".join([code(method.backend), *map(code, changed)])
