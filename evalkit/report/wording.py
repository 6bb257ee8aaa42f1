"""How numbers and lists are said in a sentence."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from statistics import median

from evalkit.metrics.table import Metric


def amount(metric: Metric, value: float) -> str:
    """A value as printed, with its unit, never broken apart: "0.014 m"."""
    return f"{value:.{metric.digits}f}\u00a0{metric.unit}".rstrip()


def spread(metric: Metric, values: Sequence[float]) -> str:
    """The median with lowest and highest of several runs: "0.014 m (0.012 to 0.016)"."""
    middle = amount(metric, median(values))
    if len(values) < 2:
        return middle
    return f"{middle} ({min(values):.{metric.digits}f} to {max(values):.{metric.digits}f})"


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
