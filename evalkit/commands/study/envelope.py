"""The operating envelope: how far two conditions may grow together before a response leaves its limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from evalkit.commands.study.factors import Factor
from evalkit.commands.study.plan import Design, EnvelopeChoice, Point
from evalkit.commands.study.result import StudyResult
from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats
from evalkit.stats.intervals import Interval, wilson_interval


@dataclass(frozen=True, eq=False)
class Panel:
    """One map of the envelope, (R, C) over the levels of y and x, for the levels ``others`` of the other factors.

    ``worst``: of all seeds, nan where one is lost; ``lost``: how many seeds are. ``inside``: within the limit, as is
    everything that is less in both conditions. ``box``: the columns and rows of the largest rectangle inside, from the
    smallest levels on; (0, 0) if there is none. ``held``: how sure it is that a drive within the box keeps the limit.
    """

    others: Mapping[str, str]
    worst: Floats
    lost: Floats
    inside: Bools
    box: tuple[int, int]
    held: Interval | None

    @property
    def label(self) -> str:
        """The other factors' levels in words."""
        return ", ".join(said(name, level) for name, level in self.others.items())


def said(factor: str, level: str) -> str:
    """A level in words: with its factor where it is a number or a switch, alone where it is a name."""
    return level if level[:1].isalpha() and level not in ("on", "off") else f"{factor} {level}"


def below(within: Bools) -> Bools:
    """Which cells (R, C) hold together with all cells that are not larger in either direction."""
    rows = np.logical_and.accumulate(within, axis=0)
    return np.asarray(np.logical_and.accumulate(rows, axis=1))


def largest_box(inside: Bools) -> tuple[int, int]:
    """Columns and rows of the largest rectangle from the first cell that lies inside; of equals the widest."""
    heights = [int(column.argmin()) if not column.all() else len(column) for column in inside.T]
    found = (0, 0)
    for width, height in enumerate(np.minimum.accumulate(heights).tolist(), 1):
        if height and width * height >= found[0] * found[1]:
            found = (width, height)
    return found


def panels(outcome: StudyResult, choice: EnvelopeChoice) -> tuple[Panel, ...]:
    """A panel for every combination of the other factors' levels, in the order of the design."""
    design = outcome.study.design(choice.design)
    x, y = axes(design, choice)
    others = [factor for factor in design.factors if factor.name not in (choice.x, choice.y)]
    grouped: dict[tuple[str, ...], dict[tuple[str, str], Point]] = {}
    for point in design.points:
        name = tuple(point.levels[factor.name].label for factor in others)
        grouped.setdefault(name, {})[point.levels[y.name].label, point.levels[x.name].label] = point
    return tuple(
        _panel(outcome, design, choice, dict(zip((f.name for f in others), name, strict=True)), points)
        for name, points in grouped.items()
    )


def axes(design: Design, choice: EnvelopeChoice) -> tuple[Factor, Factor]:
    """The factors of the two axes."""
    by_name = {factor.name: factor for factor in design.factors}
    return by_name[choice.x], by_name[choice.y]


def within(choice: EnvelopeChoice, values: Floats) -> Bools:
    """Which values keep the limit; nan keeps none."""
    higher = choice.response.metric.better == "higher"
    return np.asarray(values >= choice.limit if higher else values <= choice.limit)


def sentences(choice: EnvelopeChoice, design: Design, found: Sequence[Panel]) -> list[str]:
    """What the panels say, a sentence for each level of the last other factor: up to where, and on how many drives."""
    told = []
    for name in dict.fromkeys(_last(panel) for panel in found):
        own = [panel for panel in found if _last(panel) == name]
        reached = [reach(choice, design, panel) for panel in own]
        drives = [panel.held.support if panel.held else 0 for panel in own]
        if len(set(reached)) == 1:
            words = reached[0] + ("" if len(own) == 1 else f" at every {' and '.join(list(own[0].others)[:-1])}")
            parts = [_with_drives(words, sum(drives))]
        else:
            heads = (", ".join(f"{key} {value}" for key, value in list(panel.others.items())[:-1]) for panel in own)
            parts = [
                _with_drives(f"{words} at {head}", count)
                for words, head, count in zip(reached, heads, drives, strict=True)
            ]
        told.append(f"{name}: {'; '.join(parts)}." if name else f"{parts[0]}.")
    return told


def reach(choice: EnvelopeChoice, design: Design, panel: Panel) -> str:
    """The ends of a panel's box in words."""
    x, y = axes(design, choice)
    columns, rows = panel.box
    if not columns:
        return f"not even at {_level(x, 0)} and {_level(y, 0)}"
    most = columns == len(x.levels) and rows == len(y.levels)
    return f"up to {_level(x, columns - 1)} and {_level(y, rows - 1)}{', the most that was driven,' if most else ''}"


def _last(panel: Panel) -> str:
    return said(list(panel.others)[-1], list(panel.others.values())[-1]) if panel.others else ""


def _with_drives(words: str, drives: int) -> str:
    return f"{words.rstrip(',')} ({drives} of {drives} drives)" if drives else words.rstrip(",")


def _panel(
    outcome: StudyResult,
    design: Design,
    choice: EnvelopeChoice,
    others: Mapping[str, str],
    points: Mapping[tuple[str, str], Point],
) -> Panel:
    x, y = axes(design, choice)
    rows = [[points[b.label, a.label] for a in x.levels] for b in y.levels]
    response = choice.response
    values = np.array([[outcome.row(design, response, point) for point in row] for row in rows])
    gone = np.array([[[bool(outcome.lost(p.key, seed)) for seed in design.runs(p)] for p in row] for row in rows])
    pick = np.min if response.metric.better == "higher" else np.max
    worst = np.where(gone.any(axis=2), np.nan, pick(values, axis=2))
    inside = below(within(choice, worst))
    columns, height = largest_box(inside)
    drives = columns * height * values.shape[2]
    held = wilson_interval(drives, drives) if drives else None
    return Panel(others, worst, gone.sum(axis=2).astype(np.float64), inside, (columns, height), held)


def _level(factor: Factor, number: int) -> str:
    return f"{factor.levels[number].label} {factor.unit}".rstrip()
