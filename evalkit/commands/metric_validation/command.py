"""Measure how map metrics follow the true error, and inject faults that the metrics must show.

Run it as ``python -m evalkit.commands.metric_validation validate`` or ``... selftest``.
"""

from __future__ import annotations

import json
import shlex
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evalkit.execution import environment
from evalkit.results.store import write_texts
from evalkit.terminal import options, progress
from evalkit.terminal.options import Json, Out, err, out

if TYPE_CHECKING:
    from evalkit.execution.task import AnyTask, Result

app = typer.Typer(help="Validate the metrics themselves.", no_args_is_help=True, add_completion=False)

Mapper = Annotated[str, typer.Option(help="What draws the maps.")]
Seed = Annotated[int, typer.Option(min=0, help="Draws the worlds' noise and the random ways to go wrong.")]


@app.command()
def validate(
    world: Annotated[
        list[str] | None, typer.Option(help="A data set (repeatable).", show_default="lab, office, room")
    ] = None,
    mapper: Mapper = "log-odds",
    scans: Annotated[int, typer.Option(min=20, help="Scans drawn into a map.")] = 150,
    sizes: Annotated[int, typer.Option(min=2, max=5, help="Sizes of every way to go wrong.")] = 5,
    seed: Seed = 0,
    quick: Annotated[bool, typer.Option("--quick", help="One world, two sizes, few scans: seconds.")] = False,
    folder: Out = None,
    jobs: options.Jobs = None,
    as_json: Json = False,
) -> None:
    """Measure how metrics without a truth follow the true error of maps that are spoiled in known ways."""
    from evalkit.commands.metric_validation import measured as trust  # noqa: PLC0415 - loads scipy.stats
    from evalkit.commands.metric_validation import page  # noqa: PLC0415 - loads matplotlib
    from evalkit.report.html.blocks import render  # noqa: PLC0415 - as above

    worlds = tuple(dict.fromkeys(world or (("lab",) if quick else trust.WORLDS)))
    asked = trust.Asked(worlds, 2 if quick else sizes, seed, mapper, min(scans, 40) if quick else scans)
    folder = folder or Path("reports") / "build" / "metrics"
    results = _made(trust.jobs(asked), folder, jobs)
    content = trust.record(asked, results, _how())
    texts = {
        "validated.json": json.dumps(content, indent=1) + "\n",
        "validated.csv": trust.as_csv(trust.rows(asked, results)),
        "index.html": render(page.document(content)),
    }
    write_texts(folder, texts)
    if as_json:
        options.print_json(content | {"page": str(folder / "index.html")})
    else:
        _print(content)
        out.print(str((folder / "index.html").resolve()), markup=False, highlight=False)
    _judge(content["planted"])


@app.command()
def selftest(
    world: Annotated[str, typer.Option(help="A data set with a true trajectory.")] = "lab",
    mapper: Mapper = "log-odds",
    seed: Seed = 0,
    folder: Out = None,
    jobs: options.Jobs = None,
    as_json: Json = False,
) -> None:
    """Plant mistakes between a sequence and its scores; exit code 1 if one of them is not plain in the numbers."""
    from evalkit.commands.metric_validation import measured as trust  # noqa: PLC0415 - loads scipy.stats

    asked = trust.Asked(seed=seed, mapper=mapper, plants_in=world)
    results = _made(trust.planting(asked), folder or Path("reports") / "build" / "metrics", jobs)
    found = [trust.told(name, seen) for name, seen in trust.sightings(results).items()]
    if as_json:
        options.print_json(found)
    else:
        progress.print_table(out, _planted(found))
    _judge(found)


def _made(jobs: list[AnyTask], folder: Path, workers: int | None) -> dict[str, Result]:
    from evalkit.execution.task_runner import run_tasks  # noqa: PLC0415 - loaded only if something is computed
    from evalkit.execution.task_store import TaskStore  # noqa: PLC0415 - as above

    at_once = workers or environment.physical_cores()
    with progress.say_what_is_kept(err, "finished jobs"), progress.show_tasks(err, len(jobs), at_once) as done:
        return run_tasks(TaskStore(folder / "results"), jobs, at_once, done)


def _how() -> dict[str, Any]:
    return {
        "command": shlex.join(["python", "-m", "evalkit.commands.metric_validation", *sys.argv[1:]]),
        "made": datetime.now(UTC).strftime("%Y-%m-%d"),
        "versions": environment.versions(("evalkit", "numpy", "scipy")),
    }


def _print(content: dict[str, Any]) -> None:
    from rich.table import Table  # noqa: PLC0415 - only where a table is printed

    ways = list(content["ways"])
    table = Table("metric", "Spearman", "95 %", *ways)
    for row in content["trust"]:
        table.add_row(row["metric"], *_overall(row["overall"]), *(_told(row["by_way"][way]) for way in ways))
    progress.print_table(out, table)
    progress.print_table(out, _planted(content["planted"]))


def _overall(found: dict[str, float] | None) -> tuple[str, str]:
    return ("-", "-") if found is None else (_told(found), f"{found['low']:.2f} to {found['high']:.2f}")


def _told(found: dict[str, float] | None) -> str:
    return "-" if found is None else f"{found['value']:.2f}"


def _planted(found: list[dict[str, Any]]) -> Any:
    from rich.table import Table  # noqa: PLC0415 - only where a table is printed

    from evalkit.commands.metric_validation.page import times  # noqa: PLC0415 - loads matplotlib

    table = Table("planted mistake", "what it is", "shown by (times as bad)")
    for row in found:
        shown = ", ".join(f"{seen['metric']} {times(seen['factor'])}" for seen in row["seen"][:3])
        table.add_row(row["plant"], row["what"], shown or "nothing")
    return table


def _judge(found: list[dict[str, Any]]) -> None:
    if any(not row["caught"] for row in found):
        raise typer.Exit(1)
