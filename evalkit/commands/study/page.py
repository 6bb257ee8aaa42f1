"""The page of a study: effects with their intervals, single factors, operating envelopes, points."""

from __future__ import annotations

import shlex
from collections.abc import Mapping

import numpy as np

from evalkit.commands.study.curves import (
    build_curve_blocks,
    build_envelope_blocks,
    make_response_column,
    make_value_cell,
)
from evalkit.commands.study.effect_tables import build_effect_blocks
from evalkit.commands.study.envelope import compute_panels, describe_panels
from evalkit.commands.study.formatting import (
    describe_interactions,
    describe_limit,
    describe_lost_runs,
    describe_main_effects,
)
from evalkit.commands.study.result import WITH_EFFECTS, StudyResult
from evalkit.design.designs import assess_design
from evalkit.report.html.blocks import Block, Bullets, Cell, Column, Command, Document, Fold, Section, Table, Text

KIND_SENTENCES = {
    "optimal": "mixed levels; the points estimate main effects and all pairs with the least uncertainty "
    "(D-optimal, coordinate exchange)",
    "fractional": "two levels, every column a parity of the others (regular fractional factorial)",
    "sobol": "points spread evenly between the levels (scrambled Sobol), to check the effects there",
    "latin": "points between the levels, evenly over the range of each factor (Latin hypercube)",
    "curves": "one factor at a time, all others at the study's own settings",
    "grid": "every combination, for the operating envelope",
}


def build_document(outcome: StudyResult, ran_on: Mapping[str, str]) -> Document:
    """The whole page of one study."""
    study = outcome.study
    facts = (("Back end", study.backend), ("Data set", study.dataset), ("Points", f"{len(study.points):,}"),
             ("Runs", f"{len(outcome.results):,}"), ("CPU time", f"{sum_cpu_minutes(outcome):.1f} min"))  # fmt: skip
    provenance = Section("Provenance", (Command(study.command), Table(("What", "This machine"), list(ran_on.items()))))
    sections = (*build_sections(outcome), provenance)
    return Document("evalkit study", study.title, study.description, sections, facts)


def build_sections(outcome: StudyResult, heading: str = "", anchor: str = "") -> tuple[Section, ...]:
    """The sections on the results, without those that are empty; ``heading`` and ``anchor`` precede theirs."""
    every = (
        ("What matters", build_summary(outcome), "summary"),
        ("Design", build_design_blocks(outcome), "design"),
        ("Effects", build_effect_blocks(outcome), "effects"),
        ("One factor at a time", build_curve_blocks(outcome), "curves"),
        ("Operating envelope", build_envelope_blocks(outcome), "envelope"),
        ("Points", build_point_blocks(outcome), "points"),
    )
    return tuple(Section(heading + title, blocks, anchor + own) for title, blocks, own in every if blocks)


def build_summary(outcome: StudyResult) -> tuple[Block, ...]:
    """Sentences on the largest effects, the interactions and the envelopes."""
    lines = []
    for response in [response for response in outcome.study.responses if response.lost is not None]:
        for design, fit in outcome.fits(response):
            lines.append(
                f"{design.name}: {describe_main_effects(response, design, fit)} {describe_interactions(response, fit)}"
            )
    for choice in outcome.study.envelopes:
        design = outcome.study.design(choice.design)
        lines += [
            f"{describe_limit(choice)}, {words}"
            for words in describe_panels(choice, design, compute_panels(outcome, choice))
        ]
    return (Bullets(lines),) if lines else ()


def build_design_blocks(outcome: StudyResult) -> tuple[Block, ...]:
    """The table of designs, and the definition of a lost run."""
    rows = []
    for design in outcome.study.designs:
        lost, runs = outcome.counts(design)
        full = int(np.prod([len(factor.levels) for factor in design.factors]))
        good = assess_design(design.model, design.positions) if design.kind in WITH_EFFECTS else None
        rows.append((
            design.name,
            KIND_SENTENCES[design.kind],
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
    notes = [Text(describe_lost_runs(outcome.study), "note")]
    if all(design.kind not in WITH_EFFECTS for design in outcome.study.designs):
        notes.append(Text(f"No design here estimates effects: that takes kind {' or '.join(WITH_EFFECTS)}.", "note"))
    return (Table(columns, rows, sortable=False), *notes)


def build_point_blocks(outcome: StudyResult) -> tuple[Block, ...]:
    """Every point with its key, and the command that computes it again."""
    rows: list[tuple[Cell | str, ...]] = []
    first = outcome.study.responses[0]
    for design in outcome.study.designs:
        for point in design.points:
            lost = sum(bool(outcome.lost(point.key, seed)) for seed in design.runs(point))
            cells = (point.key, design.name, point.label, make_value_cell(outcome, design, first, point))
            rows.append((*cells, Cell(str(lost) if lost else "", lost, "bad" if lost else "")))
    columns = ("Key", "Design", "Levels", make_response_column(first), Column("Lost", number=True))
    key = outcome.study.designs[0].points[0].key
    return (
        Text("Compute one point again, and print its settings as an experiment, by its key:"),
        Command(format_point_command(outcome.study.command, key)),
        Fold(f"{len(rows):,} points", (Table(columns, rows),)),
    )


def format_point_command(command: str, key: str) -> str:
    """The command that computes one point."""
    return f"{command} --point {shlex.quote(key)}"


def sum_cpu_minutes(outcome: StudyResult) -> float:
    """CPU time of all runs, in minutes."""
    return float(sum(result["cpu_s"] for result in outcome.results.values())) / 60.0
