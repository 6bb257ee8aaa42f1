"""Moving-block bootstrap of a statistic of a time series (Kuensch, Ann. Stat. 17, 1989), with seeded randomness."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.arrays import Ints
from evalkit.core.se2 import Floats
from evalkit.stats.intervals import CONFIDENCE, Interval

DRAWS = 2000

BLOCK_S = 10.0
MIN_BLOCKS = 5
"""A series is cut into blocks of 10 s, or shorter blocks if it would have fewer than five."""

MIN_VALUES = 20
"""Shorter series are not resampled."""

MAX_RELATIVE_DIFFERENCE = 0.1
"""A series is rejected if its statistic differs from the score by more than this share."""

MAX_FOR_MEDIAN = 250
"""A median is computed from at most about this many values, evenly thinned: sorting dominates the run time."""

Statistic = Literal["mean", "rms", "median", "inverse"]


@dataclass(frozen=True, eq=False)
class Series:
    """The values that a score summarizes, in the order of time.

    ``keys`` (N,): an identifier of each value, equal for all methods (a stamp, a segment, a relation). ``values`` (N,).
    ``statistic``: how the score follows from the values; "inverse" is one over the mean, up to a factor.
    ``period_s``: time between two values, None if the values are not evenly spaced in time.
    """

    keys: Ints
    values: Floats
    statistic: Statistic
    period_s: float | None


@dataclass(frozen=True, eq=False)
class BootstrapDraws:
    """Bootstrap draws (D,) of one score.

    ``blocks``: number of blocks in the series.
    """

    values: Floats
    blocks: float


def block_length(count: int, period_s: float | None = None) -> int:
    """Return the number of values in a block: 10 s of them, at most a fifth of all.

    Without a period: the cube root of ``count``. Raises ValueError if ``count`` is less than one.
    """
    if count < 1:
        raise ValueError(f"scans: expected at least one, got {count}")
    length = math.ceil(count ** (1.0 / 3.0) - 1e-9) if period_s is None else round(BLOCK_S / period_s)
    return max(1, min(length, count // MIN_BLOCKS))


def bootstrap_interval(
    values: ArrayLike,
    statistic: Callable[[Floats], float | np.floating],
    rng: np.random.Generator,
    block: int | None = None,
    draws: int = DRAWS,
    confidence: float = CONFIDENCE,
) -> Interval:
    """Return a statistic of a series (N,) or of rows (N, K) with its moving-block bootstrap interval.

    ``block``: number of consecutive values drawn together, which preserves their dependence; default: the cube root of
    N. The interval is the expanded percentile interval.
    """
    series = np.asarray(values, dtype=np.float64)
    block = block_length(len(series)) if block is None else block
    rows = draw_block_rows(len(series), block, rng, draws)
    drawn = np.array([statistic(series[row]) for row in rows], dtype=np.float64)
    return expanded_percentile_interval(float(statistic(series)), drawn, len(series), len(series) / block, confidence)


def paired_difference_interval(
    a: ArrayLike,
    b: ArrayLike,
    rng: np.random.Generator,
    block: int | None = None,
    statistic: Callable[[Floats], float | np.floating] = np.mean,
    confidence: float = CONFIDENCE,
) -> Interval:
    """Return ``statistic(a) - statistic(b)`` of two series over the same scans (N,) with its interval.

    Each draw takes the same blocks from both series.
    """
    pairs = np.stack([np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)], axis=-1)

    def difference(rows: Floats) -> float | np.floating:
        return statistic(rows[:, 0]) - statistic(rows[:, 1])

    return bootstrap_interval(pairs, difference, rng, block, DRAWS, confidence)


def draw_block_rows(count: int, block: int, rng: np.random.Generator, draws: int = DRAWS) -> Ints:
    """Return indices (draws, N) of resampled series of N = ``count`` values, made of blocks of consecutive values."""
    starts = _draw_starts(count, block, rng, draws)
    return np.asarray((starts[:, :, None] + np.arange(block)).reshape(draws, -1)[:, :count])


def draw_block_means(values: ArrayLike, block: int, rng: np.random.Generator, draws: int = DRAWS) -> Floats:
    """Return the means (draws,) of resampled series (N,): as ``draw_block_rows``, about 100 times as fast."""
    series = np.asarray(values, dtype=np.float64)
    sums = np.concatenate([[0.0], np.cumsum(series - series.mean())])  # centred: no digits are lost in long sums
    starts = _draw_starts(len(series), block, rng, draws)
    lengths = np.full(starts.shape[1], block)
    lengths[-1] = len(series) - block * (starts.shape[1] - 1)
    return np.asarray(series.mean() + (sums[starts + lengths] - sums[starts]).sum(axis=1) / len(series))


def expanded_percentile_interval(
    value: float, drawn: Floats, support: int, blocks: float, confidence: float = CONFIDENCE
) -> Interval:
    """Return the expanded percentile interval of bootstrap draws (Hesterberg, Am. Stat. 69, 2015).

    The plain percentile interval is too narrow for few blocks n: by the factor sqrt(n / (n - 1)), and because it uses
    the normal instead of Student's t distribution.
    """
    from scipy.special import ndtr, stdtrit

    freedom = max(blocks - 1.0, 1.0)
    tail = ndtr(math.sqrt((freedom + 1.0) / freedom) * stdtrit(freedom, 0.5 - confidence / 2.0))
    low, high = np.quantile(drawn, [tail, 1.0 - tail])
    return Interval(value, float(low), float(high), support, confidence)


def bootstrap_score(series: Series, score: float, rng: np.random.Generator) -> BootstrapDraws | None:
    """Return moving-block bootstrap draws of a score, or None if its series is too short or does not yield the score.

    A small difference between the score and the statistic of the series (interpolated truth, the factor of a unit) is
    applied to the draws as a factor.
    """
    if len(series.values) < MIN_VALUES:
        return None
    value = compute_statistic(series)
    if value == 0.0 or (series.statistic != "inverse" and abs(score / value - 1.0) > MAX_RELATIVE_DIFFERENCE):
        return None
    values, factor = series.values, score / value
    thin = -(-len(values) // MAX_FOR_MEDIAN) if series.statistic == "median" else 1
    values = values[::thin]
    block = block_length(len(values), None if series.period_s is None else thin * series.period_s)
    draws = factor * _draw_statistic(values, series.statistic, block, rng)
    return BootstrapDraws(draws, len(values) / block)


def compute_statistic(series: Series) -> float:
    """Return the statistic of a series; an "inverse" of mean 0 is 0."""
    if series.statistic == "median":
        return float(np.median(series.values))
    if series.statistic == "rms":
        return float(np.sqrt(np.mean(series.values**2)))
    mean = float(np.mean(series.values))
    return mean if series.statistic == "mean" else (1.0 / mean if mean else 0.0)


def _draw_statistic(values: Floats, statistic: Statistic, block: int, rng: np.random.Generator) -> Floats:
    if statistic == "median":
        return np.asarray(np.median(values[draw_block_rows(len(values), block, rng)], axis=1))
    if statistic == "rms":
        return np.sqrt(np.maximum(draw_block_means(values**2, block, rng), 0.0))
    means = draw_block_means(values, block, rng)
    if statistic == "mean":
        return means
    zero = 1e-12 * np.abs(values).max()  # the rounding of a mean of zeros
    return np.divide(1.0, means, out=np.zeros_like(means), where=np.abs(means) > zero)  # as the statistic itself


def _draw_starts(count: int, block: int, rng: np.random.Generator, draws: int) -> Ints:
    if not 1 <= block <= count:
        raise ValueError(f"block: expected 1 to {count} values, got {block}")
    return np.asarray(rng.integers(0, count - block + 1, (draws, math.ceil(count / block))))
