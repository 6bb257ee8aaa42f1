"""The paper's page from its file to the HTML: read, compute, word, write."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Any

from evalkit.execution import environment
from evalkit.execution.task import AnyTask
from evalkit.execution.task_runner import run_tasks
from evalkit.execution.task_store import TaskStore
from evalkit.report.html.document import Cell, Column, Command, Fold, Section, Table, Text, render
from evalkit.results.store import reported
from evalkit.terminal import progress
from evalkit.terminal.options import err
from evalkit_paper import page
from evalkit_paper.chapters import CHAPTERS


def make(file: Path, folder: Path | None, workers: int | None) -> Path:
    """The page of an experiment file, written into a folder; what is done is kept there, and taken the next time."""
    started = datetime.now(UTC)
    settings = page.read(file, CHAPTERS)
    planned = page.jobs(settings, CHAPTERS)
    every = [_within(chapter, job) for chapter, own in planned.items() for job in own]
    folder = folder or Path("reports") / "build" / file.stem
    workers = workers or environment.physical_cores()
    ran_on = environment.describe(("numpy", "scipy", "open3d-cpu", "kiss-icp", "small-gicp"), jobs=workers)
    with progress.say_what_is_kept(err, "finished jobs"), progress.jobs(err, len(every), workers) as done:
        found = run_tasks(TaskStore(folder / "results"), every, workers, done)
    results = {
        chapter: {job.name: found[_within(chapter, job).name] for job in own} for chapter, own in planned.items()
    }
    facts = (("Computations", f"{len(every):,}"), ("Finished", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"))
    whole = page.document(settings, CHAPTERS, results, facts, _provenance(file, folder, settings, planned, ran_on))
    written = _written(folder / "index.html", render(whole))
    err.print(f"made in {(datetime.now(UTC) - started).total_seconds():.0f} s", markup=False, highlight=False)
    return written


def _within(chapter: str, job: AnyTask) -> AnyTask:
    """The job under a name of its own among all chapters."""
    return replace(job, name=f"{chapter} {job.name}")


def _written(path: Path, body: str) -> Path:
    with reported(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(body, encoding="utf-8")
    return path.resolve()


def _provenance(
    file: Path, folder: Path, settings: Mapping[str, Any], planned: Mapping[str, tuple[AnyTask, ...]],
    ran_on: Mapping[str, str],
) -> Section:  # fmt: skip
    """What was computed with what, where, and the command that does it again."""
    columns = ("Chapter", "Setting", Column("Value", number=True))
    rows = [
        (chapter, Cell(name), Cell(str(value)))
        for chapter, own in settings.items()
        for name, value in own.items()
    ]  # fmt: skip
    machine = Table(("What", "This machine"), list(ran_on.items()), sortable=False)
    count = sum(1 for _ in chain.from_iterable(planned.values()))
    return Section(
        "Provenance",
        (
            Text(f"{count:,} computations; each is kept in {folder / 'results'} under a key of its function, its "
                 "arguments and the sources it stands on, and is computed again when one of them changes."),
            Command(f"python -m evalkit_paper {shlex.quote(str(file))}"),
            machine,
            Fold("Settings of every chapter", (Table(columns, rows),)),
        ),
        "provenance",
    )  # fmt: skip
