"""``evalkit validate``: the whole dossier of an implementation, held against its twin on every level."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from evalkit.commands.validate.acceptance import Claim, Dossier
from evalkit.config.experiment import Experiment
from evalkit.core.errors import BadParameter
from evalkit.execution import environment
from evalkit.execution.scheduler import Progress
from evalkit.plugins import registry
from evalkit.results.store import Store
from evalkit.terminal import options, progress
from evalkit.terminal.options import Jobs, Json, err, out

FULL_ON = ("room laps=0.6", "lab laps=0.6", "fr079 limit=600")
QUICK_ON = ("room laps=0.15", "lab laps=0.15", "fr079 limit=90")
MOST = 4
"""Lines of a level that are printed; the page has all."""

AGAINST = ("open3d-icp", "kiss-icp")

Target = Annotated[
    str,
    typer.Argument(
        help="A registered name, module:SPEC, lib:./libmine.so or 'exec:ssh board ./my_icp'.", show_default=False
    ),
]


def validate(
    backend: Target,
    twin: Annotated[str, typer.Option(help="What it shall be equal to.", show_default="paper, by its role")] = "",
    against: Annotated[
        list[str] | None, typer.Option(help="A reference beside it.", show_default="open3d-icp, kiss-icp")
    ] = None,
    on: Annotated[
        list[str] | None, typer.Option(help="'lab laps=0.3' (repeatable).", show_default="room, lab, fr079")
    ] = None,
    seeds: Annotated[int | None, typer.Option(min=1, help="Of synthetic ones.", show_default="3, quick: 1")] = None,
    claim: Annotated[str, typer.Option(help="equal: the twin's very answers; as-good: no worse.")] = "equal",
    margin: Annotated[str, typer.Option(help="auto, exact (1e-9), float32 (computed) or metres.")] = "auto",
    share: Annotated[float, typer.Option(min=0.01, max=1.0, help="Of the noise's own spread, that is no worse.")] = 0.5,
    setting: Annotated[list[str] | None, typer.Option("--set", help="NAME=VALUE, for the twin too.")] = None,
    set_twin: Annotated[list[str] | None, typer.Option(help="NAME=VALUE for the twin.")] = None,
    mapper: Annotated[str, typer.Option(help="Its own mapper.", show_default="of the same module")] = "",
    quick: Annotated[bool, typer.Option("--quick", help="Under a minute.")] = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Compute all again, measure times again.")] = False,
    folder: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder.", show_default="reports/build/validate-NAME")
    ] = None,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Validate an implementation: is it right, how fast, and where does it first differ from its twin? 0 yes, 1 no."""
    from evalkit.commands.validate import examination  # noqa: PLC0415 - loads scipy.stats: only who validates pays for it

    _modules_from_here(backend, twin, *(against or []))
    asked = examination.Asked(
        backend=backend, given=options.settings(setting or []), twin=twin,
        given_twin=options.settings(set_twin or [], "--set-twin"), against=tuple(against or AGAINST),
        on=tuple(on or (QUICK_ON if quick else FULL_ON)), seeds=seeds or (1 if quick else 3), claim=_claim(claim),
        margin=_margin(margin), share=share, mapper=mapper, effort=examination.QUICK if quick else examination.FULL,
    )  # fmt: skip
    examined = examination.examination(asked)
    place = folder or Path("reports") / "build" / f"validate-{_word(backend)}"
    if fresh:
        for kept in ("jobs", "runs"):  # no more than what is made here: the folder may be somebody's own
            shutil.rmtree(place / kept, ignore_errors=True)
    for name, why in examined.absent.items():
        err.print(f"missing here: {name}: {why}", markup=False, highlight=False)
    watch = examination.Watch(lambda total, workers: progress.jobs(err, total, workers), _runs)
    found = examined.dossier(place, jobs or environment.physical_cores(), watch)
    page = _write(found, place, "evalkit " + shlex.join(sys.argv[1:]))
    if as_json:
        options.print_json(found.as_json())
    else:
        _tell(found, page)
    if not found.passed:
        raise typer.Exit(1)


@contextmanager
def _runs(plan: Experiment, workers: int) -> Iterator[Progress]:
    with progress.progress(err, list(plan.runs()), workers) as shown:
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
    progress.show(out, table)
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


def _modules_from_here(*names: str) -> None:
    """A module under development stands in the working directory, for this process and for those it starts."""
    options.modules_from_here()
    if any(":" in name and name.partition(":")[0] not in registry.names("schemes") for name in names):
        path = [entry for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry]
        os.environ["PYTHONPATH"] = os.pathsep.join([*path, str(Path.cwd())])


def _word(backend: str) -> str:
    return re.sub(r"[^\w.=+-]+", "-", backend)[:60].strip("-.") or "backend"
