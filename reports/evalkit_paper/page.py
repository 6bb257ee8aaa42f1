"""Contents of the paper's page: a table of all findings, then the chapters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from evalkit.core.errors import BadExperiment, UnknownName
from evalkit.execution.task import AnyTask, Result
from evalkit.io.toml import load_toml
from evalkit.report.html.blocks import Cell, Column, Document, Section, Table, Text, Tone
from evalkit_paper.chapter import Chapter, Finding, Judgement, Settings, Verdict

TITLE = "The paper, reproduced"
LEAD = (
    "Every table, figure and claim of 'Occupancy grid mapping based on ICP for indoor autonomous vehicles' beside what "
    "this software measures, each with a verdict computed from the measurement, and the study that the paper announces."
)
TONES: Mapping[Verdict, Tone] = {
    "reproduced": "good",
    "reproduced with a correction": "warn",
    "not reproduced": "bad",
    "not determined by the text": "warn",
    "not reproducible in software": "",
}


def read_settings(file: Path, chapters: Sequence[Chapter]) -> dict[str, Settings]:
    """Read and check the settings of the chapters in a file. Raises BadExperiment naming the key."""
    content = load_toml(file, "the paper's settings (*.toml)")
    known = {chapter.name: chapter for chapter in chapters}
    for name, table in content.items():
        if name not in known:
            raise BadExperiment(str(file), "", str(UnknownName("chapter", name, known)))
        if not isinstance(table, Mapping):
            raise BadExperiment(str(file), name, f"found {table!r}, expected a table [{name}]")
    if not content:
        raise BadExperiment(str(file), "", f"no chapter; write at least one of the tables: {', '.join(known)}")
    return {name: known[name].settings(f"{file}: [{name}]", table) for name, table in content.items()}


def make_tasks(settings: Mapping[str, Settings], chapters: Sequence[Chapter]) -> dict[str, tuple[AnyTask, ...]]:
    """Tasks of every chosen chapter, by chapter name."""
    return {chapter.name: chapter.tasks(settings[chapter.name]) for chapter in chapters if chapter.name in settings}


def build_document(
    settings: Mapping[str, Settings],
    chapters: Sequence[Chapter],
    results: Mapping[str, Mapping[str, Result]],
    facts: Sequence[tuple[str, str]],
    provenance: Section,
) -> Document:
    """Assemble the page: findings, chapters in order, provenance."""
    chosen = [chapter for chapter in chapters if chapter.name in settings]
    found = [item for chapter in chosen for item in chapter.findings(settings[chapter.name], results[chapter.name])]
    shown = [part for chapter in chosen for part in chapter.sections(settings[chapter.name], results[chapter.name])]
    return Document("evalkit paper", TITLE, LEAD, (findings_section(found), *shown, provenance), facts)


def findings_section(findings: Sequence[Finding]) -> Section:
    """Table of all findings: printed, measured, verdict, reason."""
    counted = {verdict: sum(item.judgement.verdict == verdict for item in findings) for verdict in TONES}
    text = ", ".join(f"{number} {verdict}" for verdict, number in counted.items() if number)
    columns = ("Item", Column("The paper"), Column("Measured here"), "Verdict", "Reason")
    rows = [
        (
            Cell(item.item, link=f"#{item.anchor}"),
            item.printed,
            item.measured,
            Cell(item.judgement.verdict, tone=TONES[item.judgement.verdict]),
            _describe_reason(item.judgement),
        )
        for item in findings
    ]
    return Section("Findings", (Text(f"{len(findings)} items: {text}."), Table(columns, rows)), "findings")


def _describe_reason(judgement: Judgement) -> str:
    correction = f"Correction: {judgement.correction}. " if judgement.correction else ""
    return f"{correction}{judgement.why[:1].upper()}{judgement.why[1:]}."
