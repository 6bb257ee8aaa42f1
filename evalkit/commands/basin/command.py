"""``evalkit basin``: convergence basins of registrations, success against the error of the initial guess."""

from __future__ import annotations

import math
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evalkit.config.experiment import RESULTS
from evalkit.execution import environment
from evalkit.io.json_values import indent_json
from evalkit.io.output_files import write_texts
from evalkit.plugins import registry
from evalkit.plugins.parameters import split_settings
from evalkit.plugins.specs import RegistrationSpec
from evalkit.terminal import options, progress
from evalkit.terminal.console import err, out, print_json, table_width
from evalkit.terminal.options import Jobs, Json, Out

if TYPE_CHECKING:
    from evalkit.commands.basin.result import BasinResult


def basin(
    backend: options.Backends = None,
    scene: Annotated[list[str] | None, typer.Option(help="Only this scene (repeatable).", show_default="all")] = None,
    on: options.On = None,
    setting: options.BackendSettings = None,
    offsets: Annotated[int, options.count(10, high=1_000_000, help="Disturbed guesses per back end and scene.")] = 1024,
    distance: Annotated[float, options.number(0.01, 1000.0, help="Largest shift of a guess (m).")] = 1.0,
    turn: Annotated[float, options.number(0.1, 180.0, help="Largest turn of a guess (deg).")] = 45.0,
    within_m: Annotated[float, options.number(1e-6, 1000.0, help="Success: largest error (m).")] = 0.1,
    within_deg: Annotated[float, options.number(1e-6, 180.0, help="Success: largest error (deg).")] = 2.0,
    noise: Annotated[float, options.number(0.0, 100.0, help="Standard deviation of a range (m).")] = 0.0483,
    beams: Annotated[int, options.count(8, high=100_000, help="Beams of a scan, over a full turn.")] = 720,
    pairs: Annotated[int, options.count(1, help="Pairs of scans per scene.")] = 16,
    seed: Annotated[int, typer.Option(min=0, help="Seed of scans and guesses.")] = 0,
    folder: Out = None,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Measure convergence basins: success against the error of the initial guess.

    Write a page and a JSON file. Exit code 1 if a back end raised an error or ended its process.
    """
    from evalkit.commands.basin import scenes, sequences  # noqa: PLC0415 - imports scipy
    from evalkit.commands.basin import trials as basin_trials  # noqa: PLC0415 - as above
    from evalkit.commands.basin.convergence import Criterion  # noqa: PLC0415 - as above
    from evalkit.commands.basin.result import make_result  # noqa: PLC0415 - as above

    options.add_working_directory()
    given = split_settings("--set", setting or [])
    methods = [basin_trials.find_method(name, given) for name in dict.fromkeys(backend or _registrations())]
    names = scene or ([] if on else list(scenes.SCENES))
    places: dict[str, dict[str, Any]] = {scenes.find_scene(name).name: {} for name in names}
    for each in map(sequences.PairSource.of, dict.fromkeys(on or ())):
        if each.label in places:
            raise typer.BadParameter(f"--on {each.label}: a scene has the same name; select one of them at a time")
        places[each.label] = each.data
    trials = [
        basin_trials.TrialPlan(name, offsets, pairs, beams, noise, distance, math.radians(turn), seed, data)
        for name, data in places.items()
    ]
    for one in trials:
        one.pairs_of_scans()  # raises before any trial if there is no pair
    folder = folder or RESULTS / "basin"
    outcomes = _run(methods, trials, folder / "results", jobs or environment.physical_cores())
    result = make_result(trials, methods, outcomes, Criterion(within_m, math.radians(within_deg)))
    _finish(result, folder, as_json)


def _registrations() -> list[str]:
    """Every registered registration, and back ends that do not load, which are reported."""
    specs = {name: registry.find_backend(name) for name in registry.names("backends")}
    return [name for name, spec in specs.items() if isinstance(spec, RegistrationSpec) or spec.missing()]


def _run(methods: list[Any], trials: list[Any], folder: Path, workers: int) -> list[Any]:
    from evalkit.commands.basin import trials as basin_trials  # noqa: PLC0415 - as above
    from evalkit.execution.task_store import TaskStore  # noqa: PLC0415 - loaded only where a basin is computed

    count = sum(not each.reason for each in methods) * sum(
        -(-one.offsets // basin_trials.TRIALS_PER_TASK) for one in trials
    )
    with progress.announce_kept(err, "finished jobs"), progress.show_tasks(err, count, workers) as done:
        return basin_trials.run_trials(methods, trials, TaskStore(folder), workers, done)


def _finish(result: BasinResult, folder: Path, as_json: bool) -> None:
    """Write page and JSON file and print the result; exit code 1 if a back end raised or ended its process."""
    from evalkit.commands.basin import page  # noqa: PLC0415 - imports matplotlib
    from evalkit.report.html.blocks import render  # noqa: PLC0415 - as above

    content = result.as_json() | {"command": shlex.join(["evalkit", *sys.argv[1:]])}
    html, file = render(page.document(result, content["command"])), folder / "index.html"
    write_texts(folder, {"basin.json": indent_json(content), "index.html": html})
    if as_json:
        print_json(content | {"page": str(file)})
    else:
        progress.print_table(out, _table(result, table_width(out)))
        for row in result.rows:
            if row.reason:
                out.print(f"{row.backend} over {row.scene}: {row.reason}")
        out.print(str(file.resolve()))
    if result.broken:
        raise typer.Exit(1)


WIDEST_WORDS = (7, 5, 5, 5, 5)
"""Characters that the columns of numbers need at least, so that no word of their heads is cut."""


def _table(result: BasinResult, width: int) -> Any:
    """Return the table; names are broken only where a terminal of that width cannot hold them beside the numbers."""
    from rich.table import Table  # noqa: PLC0415 - only where a table is printed

    table = Table()  # its heads are printed as they are: a unit in brackets is no markup
    names = max(len(row.backend) for row in result.rows) + max(len(row.scene) for row in result.rows)
    whole = names + sum(WIDEST_WORDS) + 3 * (2 + len(WIDEST_WORDS)) + 1 <= width
    for head in ("back end", "scene"):
        table.add_column(head, no_wrap=whole)
    heads = ("success [%]", "reach [m]", "reach [deg]", "A50 [m]", "A95 [m]")
    for head, least in zip(heads, WIDEST_WORDS, strict=True):
        table.add_column(head, min_width=least)
    for row in result.rows:
        if row.basin is None:
            table.add_row(row.backend, row.scene, *["-"] * len(heads))
            continue
        share, accuracy = row.basin.overall(), row.basin.accuracy()[:, 0]
        table.add_row(
            row.backend, row.scene,
            f"{100 * share.value:.0f} ({100 * share.low:.0f} to {100 * share.high:.0f})",
            f"{row.reach_m(0.95):.2f}", f"{row.reach_deg(0.95):.0f}", f"{accuracy[0]:.3f}", f"{accuracy[2]:.3f}",
        )  # fmt: skip
    return table
