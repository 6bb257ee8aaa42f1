"""Format numbers, intervals and lists for sentences and tables."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from statistics import median

from evalkit.core.errors import show_controls
from evalkit.core.run_result import LostTrack
from evalkit.metrics.metric import Metric
from evalkit.plugins.specs import MapUse
from evalkit.report.analysis.pairwise import PairedDifference
from evalkit.report.analysis.scores import MethodScore
from evalkit.stats.intervals import Interval
from evalkit.stats.runs import MIN_RUNS

MAP_USES: Mapping[MapUse, str] = {"matches": "matched", "reads": "given the file", "starts there": "start only"}
"""What a method does with a known map, in the words of a table."""


def escape_markdown(text: str) -> str:
    r"""Escape what Markdown, or the HTML made of it, reads as mark-up: ``[a](b)`` becomes ``[a]\(b)``.

    Also the sign of a heading, list or quotation at the beginning, and control characters.
    """
    marked = re.sub(r"([\\`|*]|(?<=\])\(|^[#>+-](?=[\s#]))", r"\\\1", show_controls(text))
    return marked.replace("&", "&amp;").replace("<", "&lt;")


def format_number(value: float, digits: int) -> str:
    """Format a number with so many decimals, a true minus sign, and no minus before zero."""
    text = f"{value:.{digits}f}"
    return text.replace("-", "" if float(text) == 0.0 else "\u2212")


def choose_decimals(unit: str, digits: int, *values: float) -> int:
    """Return how many decimals values of a unit have: ``digits``, or as many as show two digits of a shorter time."""
    largest = max(map(abs, values))
    if unit != "ms" or not 0.0 < largest < 0.995 * 10.0**-digits:
        return digits
    return 1 - math.floor(math.log10(largest))


def format_amount(metric: Metric, value: float, more: int = 0) -> str:
    """Format a value with its unit and a no-break space: "0.95 %"; metres below 1 m in millimetres: "8.4 mm".

    ``more``: additional decimals.
    """
    (text,), unit = _format_alike(metric, [value], more)
    return f"{text}\u00a0{unit}".rstrip()


def format_spread(metric: Metric, value: float, low: float, high: float) -> str:
    """Format a value and the bounds of its interval in the value's unit: "4.6 mm (3.3 to 6.4)"."""
    middle, least, most = _format_bounded(metric, value, low, high)
    return f"{middle} ({least} to {most})"


def _format_bounded(metric: Metric, value: float, low: float, high: float, more: int = 0) -> tuple[str, str, str]:
    """Return a value with its unit, and two bounds with as many decimals in the same unit."""
    (text, least, most), unit = _format_alike(metric, [value, low, high], more)
    return f"{text}\u00a0{unit}".rstrip(), least, most


def _format_alike(metric: Metric, values: Sequence[float], more: int = 0) -> tuple[list[str], str]:
    """Return values with the same decimals and their common unit: millimetres if all are below 1 m."""
    if metric.unit != "m":
        decimals = more + choose_decimals(metric.unit, metric.digits, *values)
        return [format_number(value, decimals) for value in values], metric.unit
    return _format_lengths(values, more)


def _format_lengths(values: Sequence[float], more: int = 0) -> tuple[list[str], str]:
    """Return metres with the same decimals and their common unit."""
    largest = max(abs(value) for value in values)
    if largest >= 1.0:
        return [format_number(value, more + (2 if largest < 100.0 else 0)) for value in values], "m"
    return [format_number(1000.0 * value, more + (1 if largest < 0.00995 else 0)) for value in values], "mm"


def format_length(value: float) -> str:
    """Format metres; below 1 m in millimetres: "8.4 mm", "376 mm", "6.77 m"."""
    (text,), unit = _format_lengths([value])
    return f"{text}\u00a0{unit}"


def format_tick(value: float) -> str:
    """Format round metres of an axis: "0", "20 mm", "1 m"."""
    if value == 0.0:
        return "0"
    return f"{value:g}\u00a0m" if abs(value) >= 1.0 else f"{1000.0 * value:g}\u00a0mm"


def format_milliseconds(value: float) -> str:
    """Format a time with two digits: "0.0035 ms", "0.72 ms", "8.1 ms", "120 ms"."""
    digits = 2 if value < 0.995 else 1 if value < 9.95 else 0
    return f"{value:.{choose_decimals('ms', digits, value)}f}\u00a0ms"


def format_bounds(interval: Interval) -> str:
    """Format the bounds of an interval: "0.012 to 0.017"."""
    return f"{format_number(interval.low, 2)} to {format_number(interval.high, 2)}"


def format_median(metric: Metric, score: MethodScore) -> str:
    """Format the median of the runs with its interval: "14 mm (95 % interval 12 to 17)".

    Of a recording: "450 mm (350 to 640 in 9 repeated runs)".
    One run: "14 mm (95 % interval of this run 12 to 17)". Two runs: "0.95 (0.94 to 0.96 in 2 runs)".
    """
    value, spread = median(score.values), score.spread
    if spread is None:
        return format_amount(metric, value)
    middle, low, high = _format_bounded(metric, value, spread.low, spread.high)
    if spread.kind == "interval":
        return f"{middle} (95\u00a0% interval{' of this run' if spread.runs == 1 else ''} {low} to {high})"
    return f"{middle} ({low} to {high} in {spread.runs} {'repeated ' if spread.kind == 'perturbed' else ''}runs)"


def format_difference(metric: Metric, difference: PairedDifference, sign: float = 1.0) -> str:
    """Format a paired difference, one decimal more: "2.10 mm (99 % interval 0.40 to 3.80)".

    ``sign`` below zero: the difference taken the other way round. Two pairs of runs have no interval: "2.10 mm".
    """
    interval = difference.interval
    if interval.support < MIN_RUNS:
        return format_amount(metric, math.copysign(1.0, sign) * interval.value, 1)
    ends = (interval.low, interval.high) if sign >= 0.0 else (-interval.high, -interval.low)
    value, low, high = _format_bounded(metric, math.copysign(1.0, sign) * interval.value, *ends, more=1)
    return f"{value} ({100 * interval.confidence:.0f}\u00a0% interval {low} to {high})"


def format_gap(metric: Metric, value: float, best: float) -> str:
    """Format how far a value is from a better one: "4.8 times as much", "12 % more" or "120 mm less"."""
    if metric.better == "lower" and best > 0.0:
        ratio = value / best
        if ratio >= 2.0:
            return f"{ratio:.1f} times as much"
        percent = 100.0 * (ratio - 1.0)
        return f"{percent:.0f} % more" if percent >= 1.0 else "less than 1 % more"
    direction = "more" if metric.better == "lower" else "less"
    return f"{format_amount(metric, abs(value - best))} {direction}"


def format_loss(lost: LostTrack) -> str:
    """Return when a run lost the track, and when it was found again."""
    return f"lost {format_loss_times(lost)}"


def format_loss_times(lost: LostTrack) -> str:
    """Return the time of a loss, and that from which on the track was right again."""
    found = "" if lost.recovered_at_s is None else f", found at {lost.recovered_at_s:.0f} s"
    return f"at {lost.at_s:.0f} s{found}"


def format_losses(score: MethodScore) -> str:
    """Return when a method lost the track, "" if it held it: "at 12 s, found at 20 s".

    Of several runs: "in 1 of 3, at 12 s", "in 2 of 3, first at 12 s, 1 found again".
    """
    if score.lost is None:
        return ""
    if score.lost_runs < 2:
        return f"{f'in 1 of {score.expected}, ' if score.expected > 1 else ''}{format_loss_times(score.lost)}"
    found = f", {score.found_runs} found again" if score.found_runs else ""
    return f"in {score.lost_runs} of {score.expected}, first at {score.lost.at_s:.0f} s{found}"


def join_words(words: Iterable[str]) -> str:
    """Join words to a list in a sentence: "a, b and c"; "none" for an empty list."""
    listed = list(words)
    return listed[0] if len(listed) == 1 else f"{', '.join(listed[:-1])} and {listed[-1]}" if listed else "none"


def name_or_count(names: Sequence[str], most: int, noun: str = "methods") -> str:
    """List names in a sentence, or say how many there are where that is more than ``most``."""
    return join_words(names) if len(names) <= most else f"{len(names)} {noun}"


def strip_full_stop(text: str) -> str:
    """Remove the full stop at the end, for use within a sentence."""
    return text.rstrip(". ")


def capitalise(text: str) -> str:
    """Capitalise the first letter and keep the rest."""
    return text[:1].upper() + text[1:]


def label_with_unit(label: str, unit: str) -> str:
    """Return "label [unit]", or the label alone without a unit."""
    return f"{label} [{unit}]" if unit else label
