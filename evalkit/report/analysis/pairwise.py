"""Everybody held against the leader and against the paper's method, over one sequence, on the same scans."""

from __future__ import annotations

from dataclasses import dataclass

from evalkit.metrics.table import Metric
from evalkit.report.analysis.cells import Apart, Cell, apart
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.standings import Standing, deciding, difference, method_of


@dataclass(frozen=True, slots=True)
class Held:
    """How much worse one cell is than another, in the metric's unit (below zero: better), and what is said of it."""

    apart: Apart | None
    said: str


@dataclass(frozen=True, slots=True)
class Pairs:
    """A sequence's methods (rows) against each reference (columns), in the metric that decides it."""

    metric: Metric
    references: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Held | None, ...]], ...]


def pairs(comparison: Comparison, sequence: str) -> Pairs | None:
    """The paired differences of a sequence, best first; None where nobody can be compared."""
    found = deciding(comparison, sequence)
    if found is None or len(found.ranked) < 2:
        return None
    paper = [who for who in method_of(comparison, "reference") if found.of(who) in found.ranked]
    references = tuple(dict.fromkeys([found.ranked[0].method, *paper[:1]]))
    rows = tuple(
        (cell.method, tuple(_held(found, cell, reference) for reference in references)) for cell in found.ranked
    )
    return Pairs(found.metric, references, rows)


def _held(found: Standing, cell: Cell, reference: str) -> Held | None:
    other = found.of(reference)
    if other is None or other is cell:
        return None
    level = difference(found.metric, cell, other)
    between = apart(cell, other) if found.metric.better == "lower" else apart(other, cell)
    if level == "clear" and between is not None:
        return Held(between, "worse" if between.interval.value > 0.0 else "better")
    why = {
        "within the noise floor": "less than the truth can tell",
        "within the margin": "too small to matter",
        "no interval": "one run, no interval",
    }
    return Held(between, why.get(level, "no difference shown"))
