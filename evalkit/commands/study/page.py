"""The page of a study: what matters, by how much, how sure, and how far it holds."""

from __future__ import annotations

import shlex
from collections.abc import Mapping

import numpy as np

from evalkit.commands.study.curves import curve_blocks, envelope_blocks
from evalkit.commands.study.design import quality
from evalkit.commands.study.effect_tables import effect_blocks
from evalkit.commands.study.envelope import panels, sentences
from evalkit.commands.study.formatting import fitted, limit_words, lost_words, main_words, pair_words
from evalkit.commands.study.result import StudyResult
from evalkit.report.html.document import Block, Bullets, Cell, Column, Command, Document, Fold, Section, Table, Text

WHY = {
    "optimal": "mixed levels, the points chosen so that main effects and all pairs are told apart with the least "
    "uncertainty (D-optimal, coordinate exchange)",
    "fractional": "two levels, every column a parity of the others (regular fractional factorial)",
    "sobol": "points between the levels that leave no corner out (scrambled Sobol), to see whether effects hold there",
    "latin": "points between the levels, each factor's range divided evenly (Latin hypercube)",
    "curves": "one factor at a time, all else as in the study's own settings",
    "grid": "every combination, for the map of an envelope",
}


def document(outcome: StudyResult, ran_on: Mapping[str, str]) -> Document:
    """The whole page of one study."""
    study = outcome.study
    runs = len(outcome.results)
    facts = (("Back end", study.backend), ("Data set", study.dataset), ("Points", f"{len(study.points):,}"),
             ("Runs", f"{runs:,}"), ("CPU time", f"{cpu_minutes(outcome):.1f} min"))  # fmt: skip
    machine = Section("Provenance", (Command(study.command), Table(("What", "This machine"), list(ran_on.items()))))
    return Document("evalkit study", study.title, study.description, (*sections(outcome), machine), facts)


def sections(outcome: StudyResult, prefix: str = "") -> tuple[Section, ...]:
    """All parts of a study's page; ``prefix`` stands before their anchors where a page has other parts too."""
    made = [
        Section("What matters", summary(outcome), f"{prefix}summary"),
        Section("Design", design_blocks(outcome), f"{prefix}design"),
        Section("Effects", effect_blocks(outcome), f"{prefix}effects"),
        Section("One factor at a time", curve_blocks(outcome), f"{prefix}curves"),
        Section("Operating envelope", envelope_blocks(outcome), f"{prefix}envelope"),
        Section("Points", point_blocks(outcome), f"{prefix}points"),
    ]
    return tuple(section for section in made if section.blocks)


def summary(outcome: StudyResult) -> tuple[Block, ...]:
    """The sentences that the numbers make: lost runs, largest effects, interactions, envelopes."""
    told = []
    for response in [response for response in outcome.study.responses if response.lost is not None]:
        for design, fit in fitted(outcome, response):
            told.append(f"{design.name}: {main_words(response, design, fit)} Together, {pair_words(response, fit)}")
    for choice in outcome.study.envelopes:
        design = outcome.study.design(choice.design)
        told += [f"{limit_words(choice)}, {words}" for words in sentences(choice, design, panels(outcome, choice))]
    return (Bullets(told),) if told else ()


def design_blocks(outcome: StudyResult) -> tuple[Block, ...]:
    """What was tried and why so."""
    rows = []
    for design in outcome.study.designs:
        lost, runs = outcome.counts(design)
        full = int(np.prod([len(factor.levels) for factor in design.factors]))
        good = quality(design.model, design.positions) if design.kind in ("optimal", "fractional") else None
        rows.append((
            design.name,
            WHY[design.kind],
            ", ".join(factor.name for factor in design.factors),
            Cell(f"{len(design.points):,}", len(design.points)),
            Cell(f"{full:,}", full) if design.kind != "curves" else "",
            Cell(f"{runs:,}", runs),
            Cell(f"{lost}", lost, "warn" if lost else ""),
            f"{good.efficiency:.2f}" if good else "",
            f"{good.correlation:.2f}" if good else "",
        ))  # fmt: skip
    columns = (
        "Design", "Kind", "Factors", Column("Points", number=True),
        Column("Full grid", number=True, tip="all combinations of the same levels"),
        Column("Runs", number=True, tip="points times seeds"), Column("Lost", number=True),
        Column("Efficiency", number=True, tip="information per point and column, as a share of the full grid's"),
        Column("Correlation", number=True, tip="the largest between two factors' slopes; 0: orthogonal"),
    )  # fmt: skip
    return (Table(columns, rows, sortable=False), Text(lost_words(outcome.study), "note"))


def point_blocks(outcome: StudyResult) -> tuple[Block, ...]:
    """Every point with its key, and the command that computes it again."""
    rows = []
    for design in outcome.study.designs:
        for point in design.points:
            lost = sum(bool(outcome.lost(point.key, seed)) for seed in design.runs(point))
            first = outcome.study.responses[0]
            worst = outcome.row(design, first, point)
            cells = (point.key, design.name, point.label, f"{np.mean(worst):.{first.metric.digits}f}")
            rows.append((*cells, Cell(str(lost) if lost else "", lost, "bad" if lost else "")))
    metric = outcome.study.responses[0].metric
    columns = ("Key", "Design", "Levels", Column(metric.label, metric.unit, number=True), Column("Lost", number=True))
    key = rows[0][0]
    return (
        Text("Every point is computed again, and its settings are printed as an experiment, by its key:"),
        Command(point_command(outcome.study.command, key)),
        Fold(f"{len(rows):,} points", (Table(columns, rows),)),
    )


def point_command(command: str, key: str) -> str:
    """What computes one point alone."""
    return f"{command} --point {shlex.quote(key)}"


def cpu_minutes(outcome: StudyResult) -> float:
    """What all runs cost together."""
    return float(sum(result["cpu_s"] for result in outcome.results.values())) / 60.0
