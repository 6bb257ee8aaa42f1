"""Paired differences of two methods over one sequence: size, interval, and whether the difference is clear."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median
from typing import Literal

from evalkit.metrics.metric import Metric
from evalkit.report.analysis.scores import MethodScore, median_over_runs
from evalkit.stats.bootstrap import expanded_percentile_interval
from evalkit.stats.intervals import Interval
from evalkit.stats.runs import FEW_RUNS, PairedRuns, paired_runs

RELATION_ACCURACY = {"m": 0.03, "deg": 0.4}
"""Mean error of one measured relation, by unit."""

SHARED_ERROR = 1.0 / 6.0
"""The share of it that all relations of a recording may have in common, so that no number of them averages it out."""

NEAR_SHARE = 0.25
"""Two methods are tied only if their medians differ by at most this share of the better one: a larger difference that
the runs do not show is undecided."""

MARGIN_SHARE = 0.05
MARGIN_M = 0.002
"""A smaller difference does not matter: a share of the better value, and metres for positions."""

MARGIN_POINTS = 1.0
"""Shares of wrong positions by map fit that are less than so many percentage points apart: the probabilities were not
measured better."""

SHOWN_BY_CHANCE = 0.05
"""Share of comparisons over all data sets that may show a difference between equal methods."""

Separation = Literal["clear", "one run", "within the noise floor", "not shown", "within the margin"]
"""Whether two methods differ clearly, or why not. One run each never shows a difference."""


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """How far one method lies above another, with the interval of that difference.

    ``resampled``: "runs" (Student's t over ``runs`` paired repetitions), or "blocks" of scans of a single run each; the
    latter describes these two runs only. ``within``: the bootstrap over blocks of the same runs, None without draws.
    ``paired``: the test over runs, None for one run.
    """

    interval: Interval
    resampled: Literal["blocks", "runs"]
    within: Interval | None
    runs: int
    paired: PairedRuns | None = None

    @property
    def detectable(self) -> float | None:
        """The difference that so many runs detect with 80 % power; None for one run."""
        return None if self.paired is None else self.paired.detectable

    @property
    def misses_double(self) -> bool:
        """Whether these runs do not even detect a value twice as large as the reference's."""
        return self.paired is not None and self.paired.detectable > self.paired.scale

    @property
    def needed(self) -> int | None:
        """The runs that would show a difference of this size with 80 % power; None for one run or above 200."""
        return None if self.paired is None else self.paired.runs_needed()


def compute_difference(one: MethodScore, other: MethodScore) -> PairedDifference | None:
    """Compute ``one - other`` over the common repetitions; None for a single pair of runs without draws."""
    first, second = _pair_runs(one, other)
    if not first:
        return None
    within = _resample_blocks(one, other)
    found = paired_runs(first, second, one.perturbed)
    if found is not None:
        return PairedDifference(found.interval, "runs", within, len(first), found)
    return None if within is None else PairedDifference(within, "blocks", within, 1)


def separation(metric: Metric, one: MethodScore, other: MethodScore) -> Separation:
    """Return whether two scores with values differ clearly, compared run by run.

    Clear: the interval of the paired difference over at least two runs excludes zero, the difference is at least the
    margin, and the medians of both differ in the same direction. Perturbations of a recording need at least six runs.
    The same for both orders: the better score is always the reference of the difference.
    """
    if metric.sign * median(one.values) < metric.sign * median(other.values):
        one, other = other, one
    difference = paired_runs(*_pair_runs(one, other), one.perturbed)
    if difference is None:
        return "one run"
    size = abs(difference.interval.value)
    if size < noise_floor(metric, count_relations(one, other)):
        return "within the noise floor"
    medians = (median(one.values), median(other.values))
    if one.perturbed and difference.interval.support < FEW_RUNS:
        return "not shown"
    if not difference.interval.excludes(0.0) or difference.interval.value * (medians[0] - medians[1]) <= 0.0:
        return "not shown"
    return "within the margin" if size < margin(metric, medians[1]) else "clear"


def is_shown_among(one: MethodScore, other: MethodScore, data_sets: int) -> bool:
    """Return whether a clear difference is one where so many data sets may show one by chance (Bonferroni).

    Of ``data_sets`` with equal methods, one shows a difference by chance so many times as often as a single one.
    """
    difference = paired_runs(*_pair_runs(one, other), one.perturbed)
    return difference is not None and difference.p <= SHOWN_BY_CHANCE / data_sets


def is_tied(metric: Metric, apart: Separation, one: MethodScore, other: MethodScore) -> bool:
    """Return whether two scores with values and this ``separation`` are close enough to be called tied."""
    if apart != "not shown":
        return apart in ("within the noise floor", "within the margin")
    medians = (median(one.values), median(other.values))
    better = max(medians) if metric.better == "higher" else min(medians)
    return abs(medians[0] - medians[1]) <= max(NEAR_SHARE * abs(better), margin(metric, better))


def noise_floor(metric: Metric, relations: int = 0) -> float:
    """Return the difference (in the metric's unit) that errors of the ground truth can make; 0: none.

    Both methods are measured by the same relations. Independent errors of these give the difference of two means a
    standard error of about the accuracy of one relation, divided by the root of their number, at most. The floor is
    twice that, or the shared error if it is larger. ``relations``: 0 if their number is not known, then the latter.
    """
    accuracy = RELATION_ACCURACY.get(metric.unit, 0.0) if metric.group == "relations" else 0.0
    return accuracy * max(2.0 / math.sqrt(relations) if relations else 0.0, SHARED_ERROR)


def count_relations(one: MethodScore, other: MethodScore) -> int:
    """Return how many relations a run of either method has."""
    return min(one.support, other.support)


def is_position(metric: Metric) -> bool:
    """Return whether a metric compares positions in metres."""
    return metric.unit == "m" and metric.group in ("drift", "relations")


def is_share_in_map(metric: Metric) -> bool:
    """Return whether a metric is a share of positions or scans in a known map, in percent."""
    return metric.unit == "%" and metric.group == "localisation"


def margin(metric: Metric, better: float) -> float:
    """Return the smallest difference that matters: 5 % of the better value, one printed digit.

    Of a position 2 mm, of a share of positions or scans in a known map 1 percentage point.
    """
    least = MARGIN_M if is_position(metric) else MARGIN_POINTS if is_share_in_map(metric) else 0.0
    return max(MARGIN_SHARE * abs(better), 10.0**-metric.digits, least)


def is_clearly_worse(metric: Metric, one: MethodScore | None, other: MethodScore | None) -> bool:
    """Return whether one score is clearly worse than another; False if they cannot be compared."""
    if not metric.better or one is None or other is None or not one.values or not other.values:
        return False
    behind = metric.sign * (median(one.values) - median(other.values)) > 0.0
    return behind and separation(metric, one, other) == "clear"


def _pair_runs(one: MethodScore, other: MethodScore) -> tuple[list[float], list[float]]:
    """Return the values of both over their common repetitions."""
    own, values = (dict(zip(score.seeds, score.values, strict=True)) for score in (one, other))
    common = [seed for seed in own if seed in values]
    return [own[seed] for seed in common], [values[seed] for seed in common]


def _resample_blocks(one: MethodScore, other: MethodScore) -> Interval | None:
    """Return the bootstrap interval of the difference from the same blocks of the same runs; None without draws."""
    draws = dict(zip(other.seeds, other.draws, strict=False))
    pairs = [(a, draws[seed]) for seed, a in zip(one.seeds, one.draws, strict=False) if seed in draws]
    known = [(a, b) for a, b in pairs if a is not None and b is not None and len(a.values) == len(b.values)]
    if not known or len(known) < len(pairs):
        return None
    resampled = median_over_runs([a.values - b.values for a, b in known])
    blocks = sum(min(a.blocks, b.blocks) for a, b in known)
    middle = median(a - b for a, b in zip(*_pair_runs(one, other), strict=True))
    return expanded_percentile_interval(middle, resampled, len(known), blocks)
