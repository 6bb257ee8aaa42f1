"""The blocks of a study's page on single factors and operating envelopes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evalkit.commands.study import charts
from evalkit.commands.study.envelope import Panel, compute_panels, find_envelope_axes
from evalkit.commands.study.formatting import describe_limit
from evalkit.commands.study.plan import Design, EnvelopeChoice, Point
from evalkit.commands.study.result import StudyResult
from evalkit.design.factors import Factor
from evalkit.design.responses import Response, to_scale
from evalkit.report.html.blocks import Block, Cell, Column, Figures, Fold, Table, Text


def build_curve_blocks(outcome: StudyResult) -> tuple[Block, ...]:
    """A chart for every factor varied alone and every bounded response, and a table of all values."""
    designs = [design for design in outcome.study.designs if design.kind == "curves"]
    shown = [response for response in outcome.study.responses if response.lost is not None] or outcome.study.responses[
        :1
    ]
    blocks: list[Block] = []
    for factor in outcome.study.factors:
        own = [design for design in designs if factor in design.factors]
        if own and factor.numbers is not None:
            blocks.append(Figures([charts.draw_curve(outcome, response, factor, own) for response in shown]))
        elif own:
            blocks.append(_build_unordered_table(outcome, shown[0], factor, own))
    rows: list[tuple[Cell | str, ...]] = [
        (design.name, factor, Cell(level.label, level.number), *_make_cells(outcome, design, point))
        for design in designs
        for point in design.points
        for factor, level in point.levels.items()
    ]
    measured = (make_response_column(response) for response in outcome.study.responses)
    columns: tuple[Column | str, ...] = ("Design", "Factor", "Level", *measured, Column("Lost"))
    return (*blocks, Fold("All values", (Table(columns, rows),))) if rows else ()


def _build_unordered_table(
    outcome: StudyResult, response: Response, factor: Factor, designs: Sequence[Design]
) -> Table:
    """The levels of an unordered factor against the designs that vary it."""
    points = {(d.name, p.levels[factor.name].label): p for d in designs for p in d.points if factor.name in p.levels}
    rows: list[tuple[Cell | str, ...]] = [
        (
            level.label,
            *(make_value_cell(outcome, design, response, points[design.name, level.label]) for design in designs),
        )
        for level in factor.levels
    ]
    heads = (Column(design.name, response.metric.unit, number=True) for design in designs)
    caption = f"{response.metric.label} over {factor.name}: {_describe_mean(response)}, lowest to highest"
    return Table((factor.name, *heads), rows, caption, sortable=False)


def make_response_column(response: Response) -> Column:
    """The column of ``make_value_cell``."""
    tip = f"{_describe_mean(response)}, lowest to highest"
    return Column(response.metric.label, response.metric.unit, number=True, tip=tip)


def _describe_mean(response: Response) -> str:
    return f"{'geometric ' if response.scale == 'log' else ''}mean of the seeds"


def _make_cells(outcome: StudyResult, design: Design, point: Point) -> list[Cell]:
    cells = [make_value_cell(outcome, design, response, point) for response in outcome.study.responses]
    lost = [outcome.lost(point.key, seed) for seed in design.runs(point)]
    count = sum(map(bool, lost))
    return [
        *cells,
        Cell(f"{count} of {len(lost)}" if count else "", count, "bad" if count else "", "; ".join(filter(None, lost))),
    ]


def make_value_cell(outcome: StudyResult, design: Design, response: Response, point: Point) -> Cell:
    """The mean of a point's seeds on the response's scale, with the lowest and the highest."""
    values = outcome.row(design, response, point)
    if not np.isfinite(values).any():
        return Cell("no value")
    middle = float(charts.from_scale(response, np.array(float(np.nanmean(to_scale(response, values))))))
    digits = response.metric.digits
    lost = any(outcome.lost(point.key, seed) for seed in design.runs(point))
    text = f"{middle:.{digits}f} ({np.nanmin(values):.{digits}f} to {np.nanmax(values):.{digits}f})"
    return Cell(text, middle, "bad" if lost else "")


def build_envelope_blocks(outcome: StudyResult) -> tuple[Block, ...]:
    """For every envelope, the table of its boxes and its maps."""
    blocks: list[Block] = []
    for choice in outcome.study.envelopes:
        design = outcome.study.design(choice.design)
        panels = compute_panels(outcome, choice)
        known = np.concatenate([panel.worst[np.isfinite(panel.worst)] for panel in panels])
        limits = (float(known.min()), float(known.max())) if len(known) else (0.1, 1.0)
        blocks += [
            Text(f"{describe_limit(choice)} in every drive and with every seed, for all levels up to these:"),
            build_envelope_table(choice, design, panels),
            Text(
                "Every cell has the value of its worst seed; the white line is the limit, empty cells are lost.", "note"
            ),
        ]
        for name in dict.fromkeys(_format_last(panel) for panel in panels):
            row = [
                charts.draw_envelope(choice, design, panel, limits) for panel in panels if _format_last(panel) == name
            ]
            blocks.append(Figures(row, small=True))
    return tuple(blocks)


def build_envelope_table(choice: EnvelopeChoice, design: Design, panels: Sequence[Panel]) -> Table:
    """The largest box of every panel; rows: levels of the last other factor, columns: the others."""
    x, y = find_envelope_axes(design, choice)
    heads = list(dict.fromkeys(_format_head(panel) for panel in panels))
    names = list(dict.fromkeys(_format_last(panel) for panel in panels))
    by_place = {(_format_last(panel), _format_head(panel)): panel for panel in panels}
    rows: list[tuple[Cell | str, ...]] = [
        (name, *(_make_box_cell(x, y, by_place[name, head]) for head in heads)) for name in names
    ]
    return Table(("", *heads), rows, sortable=False)


def _format_last(panel: Panel) -> str:
    return list(panel.others.values())[-1] if panel.others else ""


def _format_head(panel: Panel) -> str:
    return ", ".join(f"{name} {level}" for name, level in list(panel.others.items())[:-1]) or "largest box"


def _make_box_cell(x: Factor, y: Factor, panel: Panel) -> Cell:
    columns, rows = panel.box
    lost = int((panel.lost > 0).sum())
    lost_cells = f"; {lost} of {panel.worst.size} cells lost" if lost else ""
    if not columns:
        return Cell(f"nowhere{lost_cells}", 0.0, "bad")
    whole = columns == len(x.levels) and rows == len(y.levels)
    text = f"{x.levels[columns - 1].label} {x.unit} and {y.levels[rows - 1].label} {y.unit}"
    held = panel.held
    tip = (
        ""
        if held is None
        else f"{held.support} drives; another one keeps the limit with at least {100.0 * held.low:.0f} %"
    )
    return Cell(f"{text}{lost_cells}", float(columns * rows), "good" if whole else "warn", tip)
