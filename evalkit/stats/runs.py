"""Intervals and tests whose unit is the run: Student's t over repetitions, on logarithms where values are positive."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.se2 import Floats
from evalkit.stats.intervals import CONFIDENCE, Interval, student_quantile
from evalkit.stats.paired_tests import POWER, compute_power, detectable_standard_errors

MIN_RUNS = 3
"""Fewer runs have no interval of their median: that of two runs is 25 times as wide as their difference."""

FEW_RUNS, FEW_CONFIDENCE, PAIRED_CONFIDENCE = 6, 0.99, 0.97
"""Confidence of a difference over fewer than six pairs of runs, and over more.

Where labels are exchanged in each run, differences have two modes; few of them often have one sign by chance and hardly
any spread. These levels keep verdicts on equal methods at 5 % there too, as measured by ``commands.calibration``.

Perturbations of a recording may hardly change a run: fewer than six differences all have one sign in more than 5 % of
cases. They are compared with ``FEW_CONFIDENCE``, and give no verdict over fewer than ``FEW_RUNS`` pairs.
"""

MAX_RUNS = 200
"""A larger number of runs is not searched for."""


@dataclass(frozen=True, slots=True)
class PairedRuns:
    """The difference ``one - other`` of two methods over runs paired by repetition, in the unit of the values.

    From the ratios of the pairs where all values are positive: ``interval`` is then ``scale``, the median of ``other``,
    times the ratio's excess over one; else ``scale`` is nan. ``error``: standard error, ``mean``: estimate, both on the
    scale of the t test.
    ``perturbed``: the runs are perturbations of a recording.
    """

    interval: Interval
    mean: float
    error: float
    scale: float
    perturbed: bool = False

    @property
    def detectable(self) -> float:
        """The difference, in the direction of the estimate, that so many runs detect with 80 % power.

        At the confidence of the interval.
        """
        alpha = 1.0 - self.interval.confidence
        size = self.error * detectable_standard_errors(self.interval.support - 1, alpha=alpha)
        if math.isnan(self.scale):
            return size
        return self.scale * abs(math.expm1(math.copysign(min(size, 50.0), self.mean)))

    @property
    def p(self) -> float:
        """The probability of an estimate at least as far from zero where there is no difference: of the t test."""
        from scipy.special import stdtr

        if self.error == 0.0:
            return float(self.mean == 0.0)
        return 2.0 * float(stdtr(self.interval.support - 1, -abs(self.mean) / self.error))

    def runs_needed(self) -> int | None:
        """Return how many runs of each method show a difference of this size with 80 % power; None above 200."""
        sd = self.error * math.sqrt(self.interval.support)
        if sd == 0.0 or self.mean == 0.0:
            return self.interval.support if self.mean else None

        def detects(runs: int) -> bool:
            alpha = 1.0 - paired_confidence(runs, self.perturbed)
            return compute_power(abs(self.mean) / sd * math.sqrt(runs), runs - 1, alpha) >= POWER

        least = FEW_RUNS if self.perturbed else 2
        found = bisect_left(range(least, MAX_RUNS + 1), True, key=detects) + least
        return found if found <= MAX_RUNS else None


def runs_interval(values: ArrayLike) -> Interval | None:
    """Return the median of runs (N,) with the interval of Student's t over them; None for fewer than three runs.

    On logarithms where all values are positive: run-to-run differences of errors are factors. The interval is that of
    the median over all possible runs; another single run may lie outside.
    """
    series = np.asarray(values, dtype=np.float64)
    if len(series) < MIN_RUNS:
        return None
    positive = bool((series > 0.0).all())
    mean, error = _mean_and_error(np.log(series) if positive else series)
    half = student_quantile(len(series) - 1, CONFIDENCE) * error
    low, high = (math.exp(bound) if positive else bound for bound in (mean - half, mean + half))
    middle = float(np.median(series))
    return Interval(middle, min(low, middle), max(high, middle), len(series), CONFIDENCE)


def mean_interval(values: ArrayLike, confidence: float = CONFIDENCE) -> Interval:
    """Return the mean of two or more independent values (N,) with its interval of Student's t."""
    series = np.asarray(values, dtype=np.float64)
    mean = float(series.mean())
    half = student_quantile(len(series) - 1, confidence) * float(series.std(ddof=1)) / math.sqrt(len(series))
    return Interval(mean, mean - half, mean + half, len(series), confidence)


def paired_confidence(runs: int, perturbed: bool) -> float:
    """Return the confidence at which so many pairs of runs are compared."""
    return FEW_CONFIDENCE if perturbed or runs < FEW_RUNS else PAIRED_CONFIDENCE


def paired_runs(one: ArrayLike, other: ArrayLike, perturbed: bool = False) -> PairedRuns | None:
    """Compare two methods over the same repetitions (N,) by the paired t test; None for fewer than two.

    ``perturbed``: the repetitions are perturbations of a recording.
    """
    first, second = np.asarray(one, dtype=np.float64), np.asarray(other, dtype=np.float64)
    count = len(first)
    if count < 2:
        return None
    confidence = paired_confidence(count, perturbed)
    positive = bool((first > 0.0).all() and (second > 0.0).all())
    mean, error = _mean_and_error(np.log(first) - np.log(second) if positive else first - second)
    half = student_quantile(count - 1, confidence) * error
    scale = float(np.median(second)) if positive else math.nan
    value, low, high = (
        scale * math.expm1(min(bound, 50.0)) if positive else bound for bound in (mean, mean - half, mean + half)
    )
    return PairedRuns(Interval(value, low, high, count, confidence), mean, error, scale, perturbed)


def _mean_and_error(series: Floats) -> tuple[float, float]:
    centred = np.round(series, 12)  # equal runs have no spread, not one of rounding errors
    return float(centred.mean()), float(centred.std(ddof=1)) / math.sqrt(len(centred))
