"""Build the paper's page: read the settings, run the computations, write the HTML."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from evalkit.execution import environment
from evalkit.execution.task import AnyTask
from evalkit.io.output_files import write_texts
from evalkit.report.html.blocks import Cell, Column, Command, Fold, Section, Table, Text, render
from evalkit.terminal.console import err
from evalkit.terminal.shown_tasks import run_shown_tasks
from evalkit_paper import (
    claims_chapter,
    equation_chapter,
    figure_10_chapter,
    flowchart_chapter,
    page,
    realtime_chapter,
    residual_chapter,
    stage_configurations,
    study_chapter,
    validation_chapter,
)
from evalkit_paper.chapter import Chapter

CHAPTERS: tuple[Chapter, ...] = (
    flowchart_chapter.CHAPTER,
    validation_chapter.CHAPTER,
    equation_chapter.CHAPTER,
    stage_configurations.CHAPTER,
    residual_chapter.CHAPTER,
    figure_10_chapter.CHAPTER,
    study_chapter.CHAPTER,
    study_chapter.MAP_CHAPTER,
    realtime_chapter.CHAPTER,
    claims_chapter.CHAPTER,
)
"""In the order of the page."""


def build_page(file: Path, folder: Path | None, workers: int | None) -> Path:
    """Build the page of a settings file in a folder and return its path; finished computations are kept and reused."""
    started = datetime.now(UTC)
    settings = page.read_settings(file, CHAPTERS)
    planned = page.make_tasks(settings, CHAPTERS)
    every = [_with_chapter_name(chapter, task) for chapter, own in planned.items() for task in own]
    folder = folder or Path("reports") / "build" / file.stem
    workers = workers or environment.physical_cores()
    ran_on = environment.describe(("numpy", "scipy", "open3d-cpu", "kiss-icp", "small-gicp"), jobs=workers)
    found = run_shown_tasks(every, folder, workers, "tasks")
    results = {
        chapter: {task.name: found[_with_chapter_name(chapter, task).name] for task in own}
        for chapter, own in planned.items()
    }
    facts = (("Computations", f"{len(every):,}"), ("Finished", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"))
    whole = page.build_document(
        settings, CHAPTERS, results, facts, _provenance_section(file, folder, settings, len(every), ran_on)
    )
    write_texts(folder, {"index.html": render(whole)})
    err.print(f"finished in {(datetime.now(UTC) - started).total_seconds():.0f} s")
    return (folder / "index.html").resolve()


def _with_chapter_name(chapter: str, task: AnyTask) -> AnyTask:
    """The task under a name that is unique among all chapters."""
    return replace(task, name=f"{chapter} {task.name}")


def _provenance_section(
    file: Path, folder: Path, settings: Mapping[str, Any], count: int, ran_on: Mapping[str, str]
) -> Section:  # fmt: skip
    """Section with machine, settings and the command that repeats the computation."""
    columns = ("Chapter", "Setting", Column("Value", number=True))
    rows = [
        (chapter, Cell(name), Cell(str(value)))
        for chapter, own in settings.items()
        for name, value in own.items()
    ]  # fmt: skip
    machine = Table(("What", "This machine"), list(ran_on.items()), sortable=False)
    return Section(
        "Provenance",
        (
            Text(f"{count:,} computations; each is stored in {folder / 'results'} under a key of its function, "
                 "arguments and sources, and is computed again if one of them changes."),
            Command(f"python -m evalkit_paper {shlex.quote(str(file))}"),
            machine,
            Fold("Settings of every chapter", (Table(columns, rows),)),
        ),
        "provenance",
    )  # fmt: skip
