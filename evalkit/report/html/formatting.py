"""How numbers and lists are said in a sentence."""

from __future__ import annotations

import re
from collections.abc import Iterable
from statistics import median

from evalkit.metrics.table import Metric
from evalkit.report.analysis.cells import Apart, Cell, interval
from evalkit.stats.intervals import Interval


def as_markdown(text: str) -> str:
    r"""A text that is no mark-up in Markdown, nor in the HTML made of it: ``[a](b)`` becomes ``[a]\(b)``."""
    return re.sub(r"([\\`|]|(?<=\])\()", r"\\\1", text).replace("&", "&amp;").replace("<", "&lt;")


def amount(metric: Metric, value: float) -> str:
    """A value as printed, with its unit, never broken apart: "0.014 m"."""
    return f"{value:.{metric.digits}f}\u00a0{metric.unit}".rstrip()


def told(metric: Metric, cell: Cell) -> str:
    """The median of a cell's runs with its interval: "0.014 m (95 % interval 0.012 to 0.017)".

    Where there is none, with the lowest and highest of several runs: "0.95 (0.94 to 0.96 in 3 runs)".
    """
    middle, found = amount(metric, median(cell.values)), interval(cell)
    if found is not None:
        return f"{middle} (95\u00a0% interval {bounds(found, metric.digits)})"
    if len(cell.values) < 2:
        return middle
    low, high = (figure(value, metric.digits) for value in (min(cell.values), max(cell.values)))
    return f"{middle} ({low} to {high} in {len(cell.values)} runs)"


def difference(metric: Metric, apart: Apart, sign: float = 1.0) -> str:
    """A paired difference with its interval: "0.0021 m (95 % interval 0.0004 to 0.0038)", one decimal more."""
    found = apart.interval if sign > 0.0 else turned(apart.interval)
    value = f"{figure(found.value, metric.digits + 1)}\u00a0{metric.unit}".rstrip()
    return f"{value} (95\u00a0% interval {bounds(found, metric.digits + 1)})"


def bounds(found: Interval, digits: int) -> str:
    """The bounds of an interval: "0.012 to 0.017"."""
    return f"{figure(found.low, digits)} to {figure(found.high, digits)}"


def figure(value: float, digits: int) -> str:
    """A number with so many decimals, a true minus sign, and no minus before zero."""
    text = f"{value:.{digits}f}"
    return text.replace("-", "" if float(text) == 0.0 else "\u2212")


def turned(found: Interval) -> Interval:
    """The interval of the same difference taken the other way round."""
    return Interval(-found.value, -found.high, -found.low, found.support, found.confidence)


def gap(metric: Metric, value: float, best: float) -> str:
    """How far a value is from a better one: "4.8 times as much", "12 % more" or "0.120 less"."""
    if metric.better == "lower" and best > 0.0:
        ratio = value / best
        if ratio >= 2.0:
            return f"{ratio:.1f} times as much"
        percent = 100.0 * (ratio - 1.0)
        return f"{percent:.0f} % more" if percent >= 1.0 else "less than 1 % more"
    direction = "more" if metric.better == "lower" else "less"
    return f"{amount(metric, abs(value - best))} {direction}"


def joined(words: Iterable[str]) -> str:
    """Words as a list in a sentence: "a, b and c"."""
    listed = list(words)
    return listed[0] if len(listed) == 1 else f"{', '.join(listed[:-1])} and {listed[-1]}" if listed else "none"


def plain(text: str) -> str:
    """A text without its full stop, to go on within a sentence."""
    return text.rstrip(". ")
