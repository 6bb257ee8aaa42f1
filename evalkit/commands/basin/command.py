"""``evalkit basin``: from how far off a guess each registration still finds the truth."""

from __future__ import annotations

import json
import math
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evalkit.execution import environment
from evalkit.plugins import registry
from evalkit.plugins.specs import RegistrationSpec
from evalkit.results.store import write_texts
from evalkit.terminal import options, progress
from evalkit.terminal.options import Jobs, Json, Out, err, out

if TYPE_CHECKING:
    from evalkit.commands.basin.result import Result


def basin(
    backend: options.Backends = None,
    scene: Annotated[list[str] | None, typer.Option(help="Only this scene (repeatable).", show_default="all")] = None,
    on: options.On = None,
    setting: options.Settings = None,
    offsets: Annotated[int, typer.Option(min=10, help="Wrong guesses a back end and scene.")] = 1024,
    distance: Annotated[float, typer.Option(min=0.01, help="The farthest guess (m).")] = 1.0,
    turn: Annotated[float, typer.Option(min=0.1, max=180.0, help="The most turned guess (deg).")] = 45.0,
    within_m: Annotated[float, typer.Option(min=1e-6, help="Success: so near the truth (m).")] = 0.1,
    within_deg: Annotated[float, typer.Option(min=1e-6, help="Success: so near the truth (deg).")] = 2.0,
    noise: Annotated[float, typer.Option(min=0.0, help="Standard deviation of a range (m).")] = 0.0483,
    beams: Annotated[int, typer.Option(min=8, help="Beams of a scan, all round.")] = 720,
    pairs: Annotated[int, typer.Option(min=1, help="Pairs of scans a scene.")] = 16,
    seed: Annotated[int, typer.Option(min=0, help="Draws scans and guesses.")] = 0,
    folder: Out = None,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Measure convergence basins: success against the error of the initial guess.

    Write a page and a JSON file. Exit code 1 if a back end raised an error or ended its process.
    """
    from evalkit.commands.basin import page as basin_page  # noqa: PLC0415 - loads matplotlib and scipy.stats
    from evalkit.commands.basin import scenes, sequences  # noqa: PLC0415 - as above
    from evalkit.commands.basin import trials as attempts  # noqa: PLC0415 - as above
    from evalkit.commands.basin.convergence import Criterion  # noqa: PLC0415 - as above
    from evalkit.commands.basin.result import result  # noqa: PLC0415 - as above
    from evalkit.report.html.blocks import render  # noqa: PLC0415 - as above

    options.add_working_directory()
    given = options.settings(setting or [])
    entrants = [attempts.entrant(name, given) for name in dict.fromkeys(backend or _registrations())]
    names = scene or ([] if on else list(scenes.PLACES))
    places: dict[str, dict[str, Any]] = {scenes.place(name).name: {} for name in names}
    for each in map(sequences.Recorded.of, dict.fromkeys(on or ())):
        if each.label in places:
            raise typer.BadParameter(f"--on {each.label}: a scene is called so too; ask for one of them at a time")
        places[each.label] = each.data
    trials = [
        attempts.Trials(name, offsets, pairs, beams, noise, distance, math.radians(turn), seed, data)
        for name, data in places.items()
    ]
    for one in trials:
        one.seen()  # what has no pair is refused before anybody is asked
    folder = folder or Path("reports") / "build" / "basin"
    outcomes = _asked(entrants, trials, folder / "results", jobs or environment.physical_cores())
    found = result(trials, entrants, outcomes, Criterion(within_m, math.radians(within_deg)))
    content = found.as_json() | {"command": shlex.join(["evalkit", *sys.argv[1:]])}
    page = _write(folder, content, render(basin_page.document(found, content["command"])))
    _end(found, content, page, as_json)


def _registrations() -> list[str]:
    """Every registered back end but those that follow whole sequences; what does not load stays, to be told."""
    specs = {name: registry.find_backend(name) for name in registry.names("backends")}
    return [name for name, spec in specs.items() if isinstance(spec, RegistrationSpec) or spec.missing()]


def _asked(entrants: list[Any], trials: list[Any], folder: Path, workers: int) -> list[Any]:
    from evalkit.commands.basin import trials as attempts  # noqa: PLC0415 - as above
    from evalkit.execution.task_store import TaskStore  # noqa: PLC0415 - loaded only where a basin is computed

    count = sum(not each.reason for each in entrants) * sum(-(-one.offsets // attempts.AT_ONCE) for one in trials)
    with progress.say_what_is_kept(err, "finished jobs"), progress.show_tasks(err, count, workers) as done:
        return attempts.ask(entrants, trials, TaskStore(folder), workers, done)


def _write(folder: Path, content: dict[str, Any], page: str) -> Path:
    """Writes ``basin.json`` and ``index.html``; the page's path."""
    write_texts(folder, {"basin.json": json.dumps(content, indent=1) + "\n", "index.html": page})
    return folder / "index.html"


def _end(found: Result, content: dict[str, Any], page: Path, as_json: bool) -> None:
    """Prints what was found and where; exit code 1 if a back end raised or ended its process."""
    if as_json:
        options.print_json(content | {"page": str(page)})
    else:
        progress.print_table(out, _table(found))
        out.print(str(page.resolve()), highlight=False, markup=False)
    if found.broken:
        raise typer.Exit(1)


def _table(found: Result) -> Any:
    from rich.markup import escape  # noqa: PLC0415 - only where a table is printed
    from rich.table import Table  # noqa: PLC0415 - as above

    table = Table("back end", "scene", "success [%]", "reach [m]", "reach [deg]", "A50 [m]", "A95 [m]", "remark")
    for row in found.rows:
        if row.basin is None:
            table.add_row(escape(row.backend), row.scene, "-", "-", "-", "-", "-", escape(row.reason))
            continue
        share, accuracy = row.basin.overall(), row.basin.accuracy()[:, 0]
        table.add_row(
            escape(row.backend), row.scene,
            f"{100 * share.value:.0f} ({100 * share.low:.0f} to {100 * share.high:.0f})",
            f"{row.reach_m(0.95):.2f}", f"{row.reach_deg(0.95):.0f}", f"{accuracy[0]:.3f}", f"{accuracy[2]:.3f}",
            escape(row.reason),
        )  # fmt: skip
    return table
