"""Check printed numbers, medians, intervals, gaps and differences against recomputed ones."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from statistics import median
from typing import Any

from facts import Facts
from scipy import stats

NUMBER = r"-?[\d,]*\.?\d+"
AMOUNT = rf"{NUMBER}(?: (?:mm|m|%|deg|°|nat|cm2|cm²|ms|MiB|m2|m²))?"


def parse_amount(text: str) -> tuple[float, float, str]:
    """Return a printed number in its own unit (mm as m), half of its last digit, and the unit."""
    digits, _, unit = text.strip().partition(" ")
    value, decimals = float(digits.replace(",", "")), len(digits.partition(".")[2])
    scale = 0.001 if unit == "mm" else 1.0
    return value * scale, (0.5 * 10.0**-decimals) * scale * (1.0 + 1e-6) + 1e-12, "m" if unit == "mm" else unit


def check_amount(what: str, text: str, value: float) -> Iterator[str]:
    """Yield a fault unless a printed amount is the value, rounded."""
    printed, half, _ = parse_amount(text)
    if abs(printed - value) > half:
        yield f"{what}: printed {text}, recomputed {value:.6g}"


def check_bounds(what: str, low: str, high: str, unit: str, bounds: tuple[float, float]) -> Iterator[str]:
    """Yield faults of two printed bounds that share the unit of a value."""
    for name, text, value in (("low", low, bounds[0]), ("high", high, bounds[1])):
        yield from check_amount(f"{what}, {name}", f"{text} {unit}".strip(), value)


def unit_of(text: str) -> str:
    """Return the unit that is printed with an amount."""
    return text.partition(" ")[2]


MEDIAN = (
    rf"({AMOUNT})(?: \((?:95 % interval( of this run)? ({NUMBER}) to ({NUMBER})|({NUMBER}) to ({NUMBER}) in (\d+)"
    r"( repeated)? runs)\))?"
)


def check_median(facts: Facts, sequence: str, metric: str, method: str, text: str) -> Iterator[str]:
    """Check "14 mm (95 % interval 12 to 17)" and its kin."""
    found = facts.find(sequence, metric).get(method)
    match = re.fullmatch(MEDIAN, text)
    if match is None or found is None or not found.values:
        yield f"{sequence}, {method}: cannot be checked: {text}"
        return
    what, values = f"{sequence}, {method}, {metric}", list(found.values.values())
    yield from check_amount(what, match[1], found.median)
    if match[3] and len(values) > 1:
        low, high = interval_of(values)
        yield from check_bounds(what, match[3], match[4], unit_of(match[1]), (low, high))
        if match[2] or len(values) < 3 or found.perturbed:
            yield f"{what}: wrong words for {len(values)} runs: {text}"
    elif match[3] and match[2]:
        own = {"sequence": sequence, "method": method, "metric": metric}
        (interval,) = (one for one in facts.content["intervals"] if own.items() <= one.items())
        yield from check_bounds(what, match[3], match[4], unit_of(match[1]), (interval["low"], interval["high"]))
    elif match[3]:
        yield f"{what}: the interval of one run must be called so: {text}"
    elif match[5]:
        bounds = min(values), max(values)
        yield from check_bounds(what, match[5], match[6], unit_of(match[1]), bounds)
        if int(match[7]) != len(values) or bool(match[8]) != found.perturbed:
            yield f"{what}: wrong words for {len(values)} runs: {text}"
    elif len(values) > 1:
        yield f"{what}: no spread of {len(values)} runs: {text}"


def interval_of(values: Sequence[float]) -> tuple[float, float]:
    """Return the 95 % interval of Student's t over three or more runs, on logarithms where all are positive."""
    logs = min(values) > 0.0
    series = [math.log(value) if logs else value for value in values]
    mean, middle = sum(series) / len(series), median(values)
    error = math.sqrt(sum((x - mean) ** 2 for x in series) / (len(series) - 1) / len(series))
    half = stats.t.ppf(0.975, len(series) - 1) * error
    low, high = (math.exp(x) if logs else x for x in (mean - half, mean + half))
    return min(low, middle), max(high, middle)


def check_gap(what: str, metric: Mapping[str, Any], text: str, value: float, best: float) -> Iterator[str]:
    """Check "4.8 times as much", "12 % more" and "120 mm less"."""
    if match := re.fullmatch(rf"({NUMBER}) times as much", text):
        yield from check_amount(what, match[1], value / best)
    elif match := re.fullmatch(r"(\d+) % more", text):
        yield from check_amount(what, match[1], 100.0 * (value / best - 1.0))
    elif text == "less than 1 % more":
        if not -1e-12 <= value / best - 1.0 < 0.01:
            yield f"{what}: {text}, recomputed {value / best:.4f}"
    elif match := re.fullmatch(rf"({AMOUNT}) (more|less)", text):
        yield from check_amount(what, match[1], abs(value - best))
        if match[2] != ("more" if metric["better"] == "lower" else "less"):
            yield f"{what}: wrong direction: {text}"
    else:
        yield f"{what}: unknown words: {text}"


def check_difference(
    facts: Facts, sequence: str, metric: str, one: str, other: str, text: str, runs: str,
    turned: bool = False,
) -> Iterator[str]:  # fmt: skip
    """Check "11.0 mm (99 % interval 10.0 to 12.0)" as "one worse than other", or better if ``turned``; two pairs of
    runs have no interval.
    """
    what, sign = f"{sequence}, {one} - {other}", 1.0 if facts.metrics[metric]["better"] == "lower" else -1.0
    sign = -sign if turned else sign
    match = re.fullmatch(rf"({AMOUNT})(?: \((\d+) % interval ({NUMBER}) to ({NUMBER})\))?", text)
    apart = facts.difference(sequence, metric, one, other)
    if match is None or apart is None:
        yield f"{what}: cannot be checked: {text}"
        return
    value, low, high, count = apart
    bounds = (low, high) if sign > 0.0 else (-high, -low)
    yield from check_amount(what, match[1], sign * value)
    if (count > 2) != bool(match[2]) or int(runs) != count:
        yield f"{what}: {count} pairs of runs: {text}, over {runs}"
    if match[2]:
        yield from check_bounds(what, match[3], match[4], unit_of(match[1]), bounds)
        yield from check_amount(
            f"{what}, confidence",
            match[2],
            100.0 * facts.confidence(count, facts.find(sequence, metric)[one].perturbed),
        )


def list_of(text: str) -> list[str]:
    """Return the parts of "a, b and c"."""
    return [] if text == "none" else re.split(r", | and ", text)
