"""The paper's page: its chapters computed, put in order, with a first table of everything the paper prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from evalkit.core.errors import BadExperiment, UnknownName
from evalkit.execution.task import AnyTask, Result
from evalkit.io.toml import load_toml
from evalkit.report.html.document import Cell, Column, Document, Section, Table, Text, Tone
from evalkit_paper.chapter import Chapter, Finding, Settings, Verdict

TITLE = "The paper, reproduced"
LEAD = (
    "Every table, figure and claim of 'Occupancy grid mapping based on ICP for indoor autonomous vehicles' beside what "
    "this software measures, with the verdict and its reason, and the study that the paper announces."
)
TONES: Mapping[Verdict, Tone] = {
    "reproduced": "good",
    "reproduced with a correction": "warn",
    "not determined by the text": "warn",
    "not reproducible in software": "",
}


def read(file: Path, chapters: Sequence[Chapter]) -> dict[str, Settings]:
    """The settings of every chapter that stands in the file, checked; BadExperiment names the key."""
    content = load_toml(file, "the paper's settings (*.toml)")
    known = {chapter.name: chapter for chapter in chapters}
    for name, table in content.items():
        if name not in known:
            raise BadExperiment(str(file), "", str(UnknownName("chapter", name, known)))
        if not isinstance(table, Mapping):
            raise BadExperiment(str(file), name, f"found {table!r}, expected a table [{name}]")
    if not content:
        raise BadExperiment(str(file), "", f"no chapter; write at least one table of: {', '.join(known)}")
    return {name: known[name].settings(f"{file}: [{name}]", table) for name, table in content.items()}


def jobs(settings: Mapping[str, Settings], chapters: Sequence[Chapter]) -> dict[str, tuple[AnyTask, ...]]:
    """What every chosen chapter must have computed, by the chapter's name."""
    return {chapter.name: chapter.jobs(settings[chapter.name]) for chapter in chapters if chapter.name in settings}


def document(
    settings: Mapping[str, Settings],
    chapters: Sequence[Chapter],
    results: Mapping[str, Mapping[str, Result]],
    facts: Sequence[tuple[str, str]],
    provenance: Section,
) -> Document:
    """The page: findings first, then the chapters in order, then where the numbers come from."""
    chosen = [chapter for chapter in chapters if chapter.name in settings]
    found = [item for chapter in chosen for item in chapter.findings(settings[chapter.name], results[chapter.name])]
    shown = [part for chapter in chosen for part in chapter.sections(settings[chapter.name], results[chapter.name])]
    return Document("evalkit paper", TITLE, LEAD, (overview(found), *shown, provenance), facts)


def overview(findings: Sequence[Finding]) -> Section:
    """Every item of the paper in a line: printed, measured, verdict, why."""
    counted = {verdict: sum(item.verdict == verdict for item in findings) for verdict in TONES}
    told = ", ".join(f"{number} {verdict}" for verdict, number in counted.items() if number)
    rows = [
        (
            Cell(item.item, link=f"#{item.anchor}"),
            item.printed,
            item.measured,
            Cell(item.verdict, tone=TONES[item.verdict]),
            item.why,
        )
        for item in findings
    ]
    columns = ("Item", Column("The paper"), Column("Measured here"), "Verdict", "Why")
    return Section("Findings", (Text(f"{len(findings)} items: {told}."), Table(columns, rows)), "findings")
