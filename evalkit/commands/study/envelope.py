"""The operating envelope: how far two conditions can grow together while a response keeps its limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from evalkit.commands.study.plan import Design, EnvelopeChoice, Point
from evalkit.commands.study.result import StudyResult
from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats
from evalkit.design.factors import Factor
from evalkit.stats.intervals import Interval, wilson_interval


@dataclass(frozen=True, eq=False)
class Panel:
    """One map of the envelope, (R, C) over the levels of y and x, for the levels ``others`` of the other factors.

    ``worst``: of all seeds, nan if one is lost; ``lost``: number of lost seeds. ``inside``: this cell and all cells
    with smaller conditions keep the limit. ``box``: columns and rows of the largest rectangle inside, from the smallest
    levels on; (0, 0) if there is none. ``held``: interval of the probability that a drive within the box keeps the
    limit.
    """

    others: Mapping[str, str]
    worst: Floats
    lost: Floats
    inside: Bools
    box: tuple[int, int]
    held: Interval | None

    @property
    def label(self) -> str:
        """The other factors' levels as text."""
        return ", ".join(describe_level(name, level) for name, level in self.others.items())


def describe_level(factor: str, level: str) -> str:
    """A level as text: with its factor if it is a number or a switch, alone if it is a name."""
    return level if level[:1].isalpha() and level not in ("on", "off") else f"{factor} {level}"


def mark_enclosed_cells(within: Bools) -> Bools:
    """Marks (R, C) of the cells that are true together with all cells before them in both directions."""
    rows = np.logical_and.accumulate(within, axis=0)
    return np.asarray(np.logical_and.accumulate(rows, axis=1))


def find_largest_box(inside: Bools) -> tuple[int, int]:
    """Columns and rows of the largest rectangle inside from the first cell on; the widest of equal ones."""
    heights = [int(column.argmin()) if not column.all() else len(column) for column in inside.T]
    box = (0, 0)
    for width, height in enumerate(np.minimum.accumulate(heights).tolist(), 1):
        if height and width * height >= box[0] * box[1]:
            box = (width, height)
    return box


def compute_panels(outcome: StudyResult, choice: EnvelopeChoice) -> tuple[Panel, ...]:
    """A panel for every combination of the other factors' levels, in the order of the design."""
    design = outcome.study.design(choice.design)
    x, y = find_envelope_axes(design, choice)
    others = [factor for factor in design.factors if factor.name not in (choice.x, choice.y)]
    grouped: dict[tuple[str, ...], dict[tuple[str, str], Point]] = {}
    for point in design.points:
        name = tuple(point.levels[factor.name].label for factor in others)
        grouped.setdefault(name, {})[point.levels[y.name].label, point.levels[x.name].label] = point
    return tuple(
        _compute_panel(outcome, design, choice, dict(zip((f.name for f in others), name, strict=True)), points)
        for name, points in grouped.items()
    )


def find_envelope_axes(design: Design, choice: EnvelopeChoice) -> tuple[Factor, Factor]:
    """The factors of the two axes."""
    return design.factor(choice.x), design.factor(choice.y)


def is_within_limit(choice: EnvelopeChoice, values: Floats) -> Bools:
    """Marks of the values that keep the limit; nan does not."""
    higher = choice.response.metric.better == "higher"
    return np.asarray(values >= choice.limit if higher else values <= choice.limit)


def describe_panels(choice: EnvelopeChoice, design: Design, panels: Sequence[Panel]) -> list[str]:
    """A sentence for each level of the last other factor: the ends of the box, and the number of drives."""
    lines = []
    for name in dict.fromkeys(_format_last(panel) for panel in panels):
        own = [panel for panel in panels if _format_last(panel) == name]
        reached = [describe_reach(choice, design, panel) for panel in own]
        drives = [panel.held.support if panel.held else 0 for panel in own]
        if len(set(reached)) == 1:
            words = reached[0] + ("" if len(own) == 1 else f" at every {' and '.join(list(own[0].others)[:-1])}")
            parts = [_add_drives(words, sum(drives))]
        else:
            heads = (", ".join(f"{key} {value}" for key, value in list(panel.others.items())[:-1]) for panel in own)
            parts = [
                _add_drives(f"{words} at {head}", count)
                for words, head, count in zip(reached, heads, drives, strict=True)
            ]
        lines.append(f"{name}: {'; '.join(parts)}." if name else f"{parts[0]}.")
    return lines


def describe_reach(choice: EnvelopeChoice, design: Design, panel: Panel) -> str:
    """The ends of a panel's box as text."""
    x, y = find_envelope_axes(design, choice)
    columns, rows = panel.box
    if not columns:
        return f"not even at {_format_level(x, 0)} and {_format_level(y, 0)}"
    most = columns == len(x.levels) and rows == len(y.levels)
    ends = f"up to {_format_level(x, columns - 1)} and {_format_level(y, rows - 1)}"
    return f"{ends}, the largest levels tested," if most else ends


def _format_last(panel: Panel) -> str:
    return describe_level(list(panel.others)[-1], list(panel.others.values())[-1]) if panel.others else ""


def _add_drives(words: str, drives: int) -> str:
    return f"{words.rstrip(',')} ({drives} of {drives} drives)" if drives else words.rstrip(",")


def _compute_panel(
    outcome: StudyResult,
    design: Design,
    choice: EnvelopeChoice,
    others: Mapping[str, str],
    points: Mapping[tuple[str, str], Point],
) -> Panel:
    x, y = find_envelope_axes(design, choice)
    rows = [[points[b.label, a.label] for a in x.levels] for b in y.levels]
    response = choice.response
    values = np.array([[outcome.row(design, response, point) for point in row] for row in rows])
    lost = np.array([[[bool(outcome.lost(p.key, seed)) for seed in design.runs(p)] for p in row] for row in rows])
    pick = np.min if response.metric.better == "higher" else np.max
    worst = np.where(lost.any(axis=2), np.nan, pick(values, axis=2))
    inside = mark_enclosed_cells(is_within_limit(choice, worst))
    columns, height = find_largest_box(inside)
    drives = columns * height * values.shape[2]
    held = wilson_interval(drives, drives) if drives else None
    return Panel(others, worst, lost.sum(axis=2).astype(np.float64), inside, (columns, height), held)


def _format_level(factor: Factor, number: int) -> str:
    return f"{factor.levels[number].label} {factor.unit}".rstrip()
