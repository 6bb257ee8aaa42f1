"""``evalkit validate``: validate an implementation against a reference, level by level."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table
from rich.text import Text

from evalkit.commands.validate import single_level
from evalkit.commands.validate.acceptance import Claim, Dossier
from evalkit.config.experiment import Experiment
from evalkit.core.errors import BadParameter
from evalkit.execution import environment
from evalkit.execution.executors import Progress
from evalkit.plugins import defaults, registry
from evalkit.plugins.specs import Excerpt
from evalkit.results.store import Store
from evalkit.terminal import options, progress
from evalkit.terminal.options import Jobs, Json, err, out

if TYPE_CHECKING:
    from evalkit.commands.validate.examination import Asked

MOST = 4
"""Lines of a level that are printed; the page has all."""

RULES, LOCKSTEP, DETERMINISM = "Only rules", "Only lockstep", "Only determinism"
LEVELS = ("rules", "registrations", "lockstep", "determinism")
"""The levels that can be asked for alone."""


def validate(
    backends: options.Backends = None,
    only: Annotated[
        str,
        typer.Option(
            help=f"Only this level: {', '.join(LEVELS)}.", show_default="all", autocompletion=lambda: list(LEVELS)
        ),
    ] = "",
    reference: Annotated[
        str,
        typer.Option(
            help="What it is compared with.", show_default="by its role", autocompletion=options.complete("backends")
        ),
    ] = "",
    against: Annotated[
        list[str] | None,
        typer.Option(
            help="A further back end beside it (repeatable).",
            show_default=False,
            autocompletion=options.complete("backends"),
        ),
    ] = None,
    on: options.On = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, help="Seeds of synthetic sequences.", show_default="3, quick: 1")
    ] = None,
    claim: Annotated[str, typer.Option(help="equal: the same answers; as-good: no worse.")] = "equal",
    margin: Annotated[str, typer.Option(help="auto, exact (1e-9), float32 (computed) or metres.")] = "auto",
    share: Annotated[
        float, typer.Option(min=0.01, max=1.0, help="as-good: the tolerated share of the spread by noise.")
    ] = 0.5,
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="NAME=VALUE of the back end, and of the reference if it has it.")
    ] = None,
    set_reference: Annotated[list[str] | None, typer.Option(help="NAME=VALUE of the reference.")] = None,
    mapper: Annotated[
        str,
        typer.Option(
            help="The mapper of the back end.",
            show_default="of the same module",
            autocompletion=options.complete("mappers"),
        ),
    ] = "",
    quick: Annotated[bool, typer.Option("--quick", help="Fewer questions: under a minute.")] = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Discard earlier results, and measure times again.")] = False,
    rule: Annotated[
        list[str] | None, typer.Option(help="Only this rule (repeatable).", show_default="all", rich_help_panel=RULES)
    ] = None,
    limit: Annotated[float, typer.Option(min=0.1, help="Time limit of a rule (s).", rich_help_panel=RULES)] = 30.0,
    scans: Annotated[int, typer.Option(min=3, help="Scans compared.", rich_help_panel=LOCKSTEP)] = 30,
    margin_rad: Annotated[
        float | None,
        typer.Option(help="Margin of angles (rad).", show_default="metres at 1 m", rich_help_panel=LOCKSTEP),
    ] = None,
    margin_log_odds: Annotated[
        float, typer.Option(help="Margin of log-odds, for mappers.", rich_help_panel=LOCKSTEP)
    ] = 1e-5,
    disturb: Annotated[
        bool, typer.Option(help="Repeat with disturbed initial guesses.", rich_help_panel=LOCKSTEP)
    ] = True,
    threads: Annotated[
        int, typer.Option(min=2, help="Threads of libraries, beside one.", rich_help_panel=DETERMINISM)
    ] = 2,
    repetitions: Annotated[int, typer.Option(min=2, help="Runs of each.", rich_help_panel=DETERMINISM)] = 2,
    folder: Annotated[
        Path | None, typer.Option("--out", "-o", help="Results folder.", show_default="reports/build/validate-NAME")
    ] = None,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Validate an implementation against a reference, level by level.

    The levels are rules, registrations, scans in lockstep, trajectories, maps, and time and memory. Exit code 1 if a
    level fails. BACKENDS is one back end; --only determinism takes several. --only lockstep takes a mapper as well.
    """
    if only not in ("", *LEVELS):
        raise BadParameter("validate", "only", only, ", ".join(LEVELS))
    names = backends or []
    _add_working_directory(*names, reference, *(against or []))
    if only == "determinism":
        single_level.run_determinism(names, _one(on), threads, repetitions, as_json)
        return
    if len(names) != 1:
        raise typer.BadParameter(f"found {len(names)} back ends, expected one")
    given, given_reference = options.settings(setting or []), options.settings(set_reference or [], "--set-reference")
    if only == "rules":
        single_level.run_rules(names[0], given, rule or (), limit, as_json)
        return
    if only == "lockstep":
        single_level.run_lockstep(
            reference or _default_reference(names[0]), names[0], _one(on), (given_reference, given), _margin(margin),
            margin_rad, margin_log_odds, scans, disturb, as_json,
        )  # fmt: skip
        return
    from evalkit.commands.validate import examination  # noqa: PLC0415 - loads scipy.stats

    asked = examination.Asked(
        backend=names[0], given=given, twin=reference,
        given_twin=given_reference, against=tuple(against or defaults.backends_with_role("peer")),
        on=tuple(on or _excerpts("quick" if quick else "full")), seeds=seeds or (1 if quick else 3),
        claim=_claim(claim), margin=_margin(margin), share=share, mapper=mapper,
        effort=examination.QUICK if quick else examination.FULL,
    )  # fmt: skip
    _examine(asked, folder, jobs, fresh, only == "registrations", as_json)


def _examine(
    asked: Asked, folder: Path | None, jobs: int | None, fresh: bool, registrations: bool, as_json: bool
) -> None:
    """Examine all levels, or the registrations alone; write the page and print the outcome."""
    from evalkit.commands.validate import examination  # noqa: PLC0415 - loads scipy.stats

    examined = examination.examination(asked)
    place = folder or Path("reports") / "build" / f"validate-{_word(asked.backend)}"
    if fresh:
        for name in ("jobs", "runs"):  # only the folders of this command: others may stand beside them
            shutil.rmtree(place / name, ignore_errors=True)
    for name, why in examined.absent.items():
        err.print(f"missing here: {name}: {why}", markup=False, highlight=False)
    watch = examination.Watch(lambda total, workers: progress.show_tasks(err, total, workers), _runs)
    compute = examined.registrations if registrations else examined.dossier
    found = compute(place, jobs or environment.physical_cores(), watch)
    page = _write(found, place, "evalkit " + shlex.join(sys.argv[1:]))
    if as_json:
        options.print_json(found.as_json())
    else:
        _tell(found, page)
    if not found.passed:
        raise typer.Exit(1)


def _one(on: list[str] | None) -> str:
    """Return the one sequence of a level that takes one."""
    if len(on or ()) > 1:
        raise typer.BadParameter(f"--on: found {len(on or ())} sequences, expected one")
    return on[0] if on else defaults.simulated_dataset()


def _excerpts(size: Excerpt) -> list[str]:
    """Return the excerpts that the data sets declare, each as "NAME KEY=VALUE"."""
    declared = defaults.excerpts(size).items()
    return [" ".join((name, *(f"{key}={value}" for key, value in given.items()))) for name, given in declared]


def _default_reference(backend: str) -> str:
    """Return the reference of a back end, or of a mapper."""
    is_mapper = backend in registry.names("mappers")
    return defaults.default_mapper() if is_mapper else defaults.reference_backend()


@contextmanager
def _runs(plan: Experiment, workers: int) -> Iterator[Progress]:
    with progress.show_runs(err, list(plan.runs()), workers) as shown:
        yield shown


def _write(found: Dossier, folder: Path, command: str) -> Path:
    """The page and the JSON of a dossier in its folder."""
    from evalkit.commands.validate import page as validate_page  # noqa: PLC0415 - loads matplotlib: only who draws pays for it

    store = Store(folder)
    store.write_text(folder / "dossier.json", validate_page.json_text(found))
    store.write_text(folder / "index.html", validate_page.html(found, command))
    return folder / "index.html"


def _tell(found: Dossier, page: Path) -> None:
    table = Table("level", "outcome", "what was found", expand=out.is_terminal)
    for level in found.levels:
        failed = level.failed(found.claim)
        passed = [line for line in level.lines if line.outcome == "passed" and line.decides(found.claim)]
        shown = failed or passed or [line for line in level.lines if line.outcome != "not applicable"] or level.lines
        said = "\n".join(f"{line.on + ': ' if line.on else ''}{line.name}: {line.observed}" for line in shown[:MOST])
        said += f"\n... and {len(shown) - MOST} more" if len(shown) > MOST else ""
        table.add_row(f"{level.number} {level.name}", level.outcome(found.claim), Text(said))
    progress.print_table(out, table)
    out.print(found.verdict, markup=False, emoji=False, highlight=False)
    out.print(str(page.resolve()), markup=False, highlight=False)


def _claim(word: str) -> Claim:
    known: dict[str, Claim] = {"equal": "equal", "as-good": "as-good"}
    if word not in known:
        raise BadParameter("validate", "claim", word, "equal or as-good")
    return known[word]


def _margin(word: str) -> str:
    if word in ("auto", "exact", "float32"):
        return word
    try:
        metres = float(word)
    except ValueError:
        metres = 0.0
    if not 0.0 < metres < 1e3:
        raise BadParameter("validate", "margin", word, "auto, exact, float32 or metres")
    return word


def _add_working_directory(*names: str) -> None:
    """A module under development stands in the working directory, for this process and for those it starts."""
    options.add_working_directory()
    if any(":" in name and name.partition(":")[0] not in registry.names("schemes") for name in names):
        path = [entry for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry]
        os.environ["PYTHONPATH"] = os.pathsep.join([*path, str(Path.cwd())])


def _word(backend: str) -> str:
    return re.sub(r"[^\w.=+-]+", "-", backend)[:60].strip("-.") or "backend"
