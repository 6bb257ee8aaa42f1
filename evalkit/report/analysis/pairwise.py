"""Paired differences of two methods over one sequence: size, interval, and whether the difference is clear."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

import numpy as np

from evalkit.metrics.table import Metric
from evalkit.report.analysis.scores import MethodScore, median_over_runs
from evalkit.stats.bootstrap import BootstrapDraws, expanded_percentile_interval
from evalkit.stats.intervals import CONFIDENCE, Interval
from evalkit.stats.paired_tests import detectable_standard_errors

RELATIONS_FLOOR = {"m": 0.03, "deg": 0.4, "°": 0.4}
"""Accuracy of the published relations themselves, by unit."""

MARGIN_SHARE = 0.05
MARGIN_M = 0.002
"""A smaller difference does not matter: a share of the better value, and metres for positions."""

Separation = Literal["clear", "within the noise floor", "no interval", "not shown", "within the margin"]
"""Whether two methods differ clearly, or why not."""


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """How far one method lies above another, run by run, with the interval of that difference.

    ``error``: standard error with ``freedom`` degrees of freedom. ``resampled``: "blocks" of scans of the same runs
    (and the runs, if there are several), or only the "runs".
    """

    interval: Interval
    error: float
    freedom: float
    resampled: Literal["blocks", "runs"]

    @property
    def detectable(self) -> float:
        """The difference that these runs detect with 80 % power at 5 %."""
        return self.error * detectable_standard_errors(self.freedom)


def compute_difference(one: MethodScore, other: MethodScore) -> PairedDifference | None:
    """Compute ``one - other`` over the common seeds; None for a single pair of runs without draws.

    Both sides use the same blocks of the same runs. Without draws within the runs, Student's t over the runs.
    """
    pairs = _pair_runs(one, other)
    if not pairs:
        return None
    differences = [value - other_value for value, other_value, _, _ in pairs]
    draws = [(a, b) for _, _, a, b in pairs if a is not None and b is not None and len(a.values) == len(b.values)]
    if len(draws) == len(pairs):
        blocks = sum(min(a.blocks, b.blocks) for a, b in draws)
        resampled = median_over_runs([a.values - b.values for a, b in draws])
        interval = expanded_percentile_interval(median(differences), resampled, len(pairs), blocks)
        return PairedDifference(interval, float(resampled.std()), max(blocks - 1.0, 1.0), "blocks")
    if len(pairs) < 2:
        return None
    return _student_difference(differences)


def separation(metric: Metric, one: MethodScore, other: MethodScore) -> Separation:
    """Return whether two scores with values differ clearly, compared run by run.

    Clear: the 95 % interval of the paired difference excludes zero, and its median is at least the margin.
    """
    differences = _value_differences(one, other)
    if not differences:
        return "no interval"
    size = abs(median(differences))
    if size < noise_floor(metric):
        return "within the noise floor"
    difference = compute_difference(one, other)
    if difference is None:
        return "no interval"
    if not difference.interval.excludes(0.0):
        return "not shown"
    return "within the margin" if size < margin(metric, _better_median(metric, one, other)) else "clear"


def is_distinct(metric: Metric, one: MethodScore, other: MethodScore) -> bool:
    """Return whether two scores differ by at least the margin, in the same direction in every run."""
    differences = _value_differences(one, other)
    if not differences or (min(differences) <= 0.0 <= max(differences)):
        return False
    return abs(median(differences)) >= max(margin(metric, _better_median(metric, one, other)), noise_floor(metric))


def noise_floor(metric: Metric) -> float:
    """Return the difference below the accuracy of the ground truth itself (in the metric's unit); 0: none."""
    return RELATIONS_FLOOR.get(metric.unit, 0.0) if metric.group == "relations" else 0.0


def is_position(metric: Metric) -> bool:
    """Return whether a metric compares positions in metres."""
    return metric.unit == "m" and metric.group in ("drift", "relations")


def margin(metric: Metric, better: float) -> float:
    """Return the smallest difference that matters: 5 % of the better value, one printed digit, 2 mm of a position."""
    return max(MARGIN_SHARE * abs(better), 10.0**-metric.digits, MARGIN_M if is_position(metric) else 0.0)


def is_behind(metric: Metric, one: MethodScore | None, other: MethodScore | None) -> bool:
    """Return whether the median of one score is worse than that of another, by any amount."""
    if not metric.better or one is None or other is None or not one.values or not other.values:
        return False
    difference = median(one.values) - median(other.values)
    return difference > 0.0 if metric.better == "lower" else difference < 0.0


def is_clearly_worse(metric: Metric, one: MethodScore | None, other: MethodScore | None) -> bool:
    """Return whether one score is clearly worse than another; False if they cannot be compared."""
    if one is None or other is None or not is_behind(metric, one, other):
        return False
    return separation(metric, one, other) == "clear"


def _pair_runs(
    one: MethodScore, other: MethodScore
) -> list[tuple[float, float, BootstrapDraws | None, BootstrapDraws | None]]:
    by_seed = {seed: (value, draws) for seed, value, draws in _runs(other)}
    return [(value, by_seed[seed][0], draws, by_seed[seed][1]) for seed, value, draws in _runs(one) if seed in by_seed]


def _runs(score: MethodScore) -> list[tuple[int | None, float, BootstrapDraws | None]]:
    draws = score.draws or (None,) * len(score.values)
    return list(zip(score.seeds, score.values, draws, strict=True))


def _student_difference(differences: Sequence[float]) -> PairedDifference:
    from scipy import stats  # noqa: PLC0415 - slow to load

    series, freedom = np.asarray(differences), len(differences) - 1
    middle, error = float(series.mean()), float(series.std(ddof=1)) / math.sqrt(len(series))
    half = float(stats.t.ppf(0.5 + CONFIDENCE / 2.0, freedom)) * error
    return PairedDifference(Interval(middle, middle - half, middle + half, len(series)), error, freedom, "runs")


def _value_differences(one: MethodScore, other: MethodScore) -> list[float]:
    return [value - other_value for value, other_value, _, _ in _pair_runs(one, other)]


def _better_median(metric: Metric, one: MethodScore, other: MethodScore) -> float:
    medians = (median(one.values), median(other.values))
    return max(medians) if metric.better == "higher" else min(medians)
