"""How sure a number is: intervals, paired differences and tests, pure functions with seeded randomness."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize, stats

from evalkit.core.arrays import Ints
from evalkit.core.se2 import Floats

CONFIDENCE = 0.95
DRAWS = 2000

BLOCK_S = 10.0
MIN_BLOCKS = 5
"""A run is cut into stretches of 10 s, shorter ones where it would have fewer than five."""

MIN_SEQUENCES = 8
"""Below this the chi-square of Friedman's test and the critical difference promise more than they hold."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A value with the bounds between which the true one lies with ``confidence``; ``support``: what it stands on."""

    value: float
    low: float
    high: float
    support: int
    confidence: float = CONFIDENCE

    def __post_init__(self) -> None:
        if not self.low <= self.high:
            raise ValueError(f"interval: low {self.low} is not at most high {self.high}")
        if not 0.0 < self.confidence < 1.0:
            raise ValueError(f"confidence: expected a number between 0 and 1, got {self.confidence}")

    def excludes(self, value: float = 0.0) -> bool:
        """Whether a value lies outside the bounds."""
        return not self.low <= value <= self.high


@dataclass(frozen=True, slots=True)
class PairTest:
    """Wilcoxon's signed-rank test of one pair: ``pairs`` that differ, p alone, and p by Holm over all pairs tested."""

    pairs: int
    p: float
    p_holm: float


@dataclass(frozen=True, slots=True)
class Friedman:
    """Mean ranks (1: best), Friedman's statistic and p, and the difference of mean ranks that tells two apart."""

    ranks: tuple[float, ...]
    statistic: float
    p: float
    critical_difference: float
    sequences: int


def wilson(successes: int, trials: int, confidence: float = CONFIDENCE) -> Interval:
    """The share of successes with Wilson's score interval (Wilson, JASA 22, 1927)."""
    if not 0 <= successes <= trials or trials == 0:
        raise ValueError(f"successes: expected 0 to {trials} of at least one trial, got {successes}")
    z = float(stats.norm.ppf(0.5 + confidence / 2.0))
    share, weight = successes / trials, z * z / trials
    middle = share + weight / 2.0
    half = z * math.sqrt(share * (1.0 - share) / trials + weight / (4.0 * trials))
    low = 0.0 if successes == 0 else (middle - half) / (1.0 + weight)
    high = 1.0 if successes == trials else (middle + half) / (1.0 + weight)
    return Interval(share, low, high, trials, confidence)


def block_length(scans: int, period_s: float | None = None) -> int:
    """Scans in a block: 10 s of them, at most a fifth of all; without a period the cube root of how many there are."""
    if scans < 1:
        raise ValueError(f"scans: expected at least one, got {scans}")
    wanted = math.ceil(scans ** (1.0 / 3.0) - 1e-9) if period_s is None else round(BLOCK_S / period_s)
    return max(1, min(wanted, scans // MIN_BLOCKS))


def block_bootstrap(
    values: ArrayLike,
    of: Callable[[Floats], float | np.floating],
    rng: np.random.Generator,
    block: int | None = None,
    draws: int = DRAWS,
    confidence: float = CONFIDENCE,
) -> Interval:
    """A statistic of a series (N,) or of rows (N, K) with its interval by moving blocks (Kuensch 1989).

    ``of`` makes one number of a series. ``block``: values in a row that are drawn together, so that their dependence is
    kept; without it the cube root of N. The interval is the expanded percentile (``percentile``).
    """
    series = np.asarray(values, dtype=np.float64)
    block = block_length(len(series)) if block is None else block
    rows = block_rows(len(series), block, rng, draws)
    drawn = np.array([of(series[row]) for row in rows], dtype=np.float64)
    return percentile(float(of(series)), drawn, len(series), len(series) / block, confidence)


def paired_difference(
    a: ArrayLike,
    b: ArrayLike,
    rng: np.random.Generator,
    block: int | None = None,
    of: Callable[[Floats], float | np.floating] = np.mean,
    confidence: float = CONFIDENCE,
) -> Interval:
    """``of(a) - of(b)`` for two series over the same scans (N,), with its interval: both lose the same scans."""
    pairs = np.stack([np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)], axis=-1)
    return block_bootstrap(pairs, lambda rows: of(rows[:, 0]) - of(rows[:, 1]), rng, block, DRAWS, confidence)


def block_rows(scans: int, block: int, rng: np.random.Generator, draws: int = DRAWS) -> Ints:
    """Indices (draws, N) of resampled series of N values, made of whole blocks of consecutive ones."""
    starts = _starts(scans, block, rng, draws)
    return np.asarray((starts[:, :, None] + np.arange(block)).reshape(draws, -1)[:, :scans])


def block_means(values: ArrayLike, block: int, rng: np.random.Generator, draws: int = DRAWS) -> Floats:
    """Means (draws,) of resampled series (N,) of whole blocks: as ``block_rows``, a hundred times as fast."""
    series = np.asarray(values, dtype=np.float64)
    sums = np.concatenate([[0.0], np.cumsum(series - series.mean())])  # centred: no digits are lost in long sums
    starts = _starts(len(series), block, rng, draws)
    lengths = np.full(starts.shape[1], block)
    lengths[-1] = len(series) - block * (starts.shape[1] - 1)
    return np.asarray(series.mean() + (sums[starts + lengths] - sums[starts]).sum(axis=1) / len(series))


def percentile(value: float, drawn: Floats, support: int, blocks: float, confidence: float = CONFIDENCE) -> Interval:
    """The expanded percentile interval of bootstrap draws from so many blocks (Hesterberg, Am. Stat. 69, 2015).

    The plain percentile is too narrow for few blocks: by the missing n / (n - 1), and by normal for Student's t.
    """
    spare = max(blocks - 1.0, 1.0)
    tail = stats.norm.cdf(math.sqrt((spare + 1.0) / spare) * stats.t.ppf(0.5 - confidence / 2.0, spare))
    low, high = np.quantile(drawn, [tail, 1.0 - tail])
    return Interval(value, float(low), float(high), support, confidence)


def holm(p: Sequence[float]) -> tuple[float, ...]:
    """The p values adjusted for how many there are (Holm, Scand. J. Stat. 6, 1979), in the order given."""
    order = np.argsort(np.asarray(p, dtype=np.float64), kind="stable")
    scaled = np.asarray(p, dtype=np.float64)[order] * np.arange(len(p), 0, -1)
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return tuple(adjusted.tolist())


def wilcoxon_holm(pairs: Mapping[str, tuple[ArrayLike, ArrayLike]]) -> dict[str, PairTest]:
    """Wilcoxon's two-sided signed-rank test of every named pair of series (N,) of equal units, adjusted by Holm.

    An infinite value is a failure: farther off than any number, and equal to another failure.
    """
    alone = {name: _signed_rank(_apart(a, b)) for name, (a, b) in pairs.items()}
    adjusted = holm([p for _, p in alone.values()])
    return {name: PairTest(n, p, by) for (name, (n, p)), by in zip(alone.items(), adjusted, strict=True)}


def vargha_delaney(a: ArrayLike, b: ArrayLike) -> float:
    """The probability that a value of a is larger than one of b, ties half (A12; Vargha and Delaney 2000)."""
    ours, theirs = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if not (ours.size and theirs.size):
        raise ValueError("vargha_delaney: both series need a value")
    larger = ours[:, None] > theirs[None, :]
    return float(np.mean(larger + 0.5 * (ours[:, None] == theirs[None, :])))


def smallest_detectable_difference(differences: ArrayLike, power: float = 0.8, alpha: float = 0.05) -> float:
    """The mean difference that a paired design with these runs would have shown with 80 % power at 5 %.

    By the two-sided paired t-test, for the standard deviation and the number of these differences. Infinite for fewer
    than two.
    """
    series = np.asarray(differences, dtype=np.float64)
    if len(series) < 2 or not np.isfinite(series).all():
        return math.inf
    error = float(series.std(ddof=1)) / math.sqrt(len(series))
    return error * detectable_errors(len(series) - 1, power, alpha)


@cache
def detectable_errors(spare: float, power: float = 0.8, alpha: float = 0.05) -> float:
    """How many standard errors, known with so many degrees of freedom, a difference must be to be shown so often."""
    critical = float(stats.t.ppf(1.0 - alpha / 2.0, spare))
    even = (np.arange(4000) + 0.5) / 4000.0
    known = critical * np.sqrt(stats.chi2.ppf(even, spare) / spare)  # the bar, for every standard error one may get

    def lacking(shift: float) -> float:
        return float(np.mean(stats.norm.sf(known - shift) + stats.norm.cdf(-known - shift))) - power

    return float(optimize.brentq(lacking, 0.0, 2.0 * (critical + 4.0)))


def friedman(errors: ArrayLike, alpha: float = 0.05) -> Friedman | str:
    """Mean ranks of K methods over N sequences (N, K), lower is better, or why there are none.

    Friedman's test and Nemenyi's critical difference q sqrt(K (K + 1) / 6 N) (Demsar, JMLR 7, 2006). An infinite error
    is a failure and shares the last rank.
    """
    table = np.asarray(errors, dtype=np.float64)
    sequences, methods = table.shape
    if sequences < MIN_SEQUENCES:
        are = "sequence is" if sequences == 1 else "sequences are"
        return f"{sequences} {are} too few for ranks with a critical difference: it takes {MIN_SEQUENCES}"
    if methods < 3:
        return f"{methods} methods are too few for a test of ranks: it takes 3"
    ranks = stats.rankdata(table, axis=1)
    statistic, p = (0.0, 1.0) if (ranks == ranks[:, :1]).all() else stats.friedmanchisquare(*ranks.T)
    q = stats.studentized_range.ppf(1.0 - alpha, methods, np.inf) / math.sqrt(2.0)
    critical = float(q) * math.sqrt(methods * (methods + 1) / (6.0 * sequences))
    return Friedman(tuple(ranks.mean(axis=0).tolist()), float(statistic), float(p), critical, sequences)


def success_curve(errors: ArrayLike, thresholds: ArrayLike) -> Floats:
    """The share (K,) of all trials with an error of at most each threshold; a failed trial's error is infinite."""
    return np.asarray(np.mean(np.asarray(errors)[None, :] <= np.asarray(thresholds)[:, None], axis=1))


def success_quantiles(errors: ArrayLike, shares: Sequence[float] = (0.5, 0.75, 0.95)) -> tuple[float, ...]:
    """The errors that so many of all trials stay within: A50, A75 and A95 (Pomerleau et al., Auton. Robots 34, 2013).

    The smallest error reached by at least that share; infinite where too many trials failed.
    """
    ordered = np.sort(np.asarray(errors, dtype=np.float64))
    if not ordered.size:
        raise ValueError("success_quantiles: there is no trial")
    return tuple(float(ordered[max(math.ceil(share * len(ordered) - 1e-9), 1) - 1]) for share in shares)


def _starts(scans: int, block: int, rng: np.random.Generator, draws: int) -> Ints:
    if not 1 <= block <= scans:
        raise ValueError(f"block: expected 1 to {scans} values, got {block}")
    return np.asarray(rng.integers(0, scans - block + 1, (draws, math.ceil(scans / block))))


def _apart(a: ArrayLike, b: ArrayLike) -> Floats:
    ours, theirs = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    same = ours == theirs
    return np.asarray(np.subtract(ours, theirs, out=np.zeros_like(ours), where=~same))


def _signed_rank(apart: Floats) -> tuple[int, float]:
    differing = apart[apart != 0.0]
    if not differing.size:
        return 0, 1.0
    signed = np.sign(differing) * stats.rankdata(np.abs(differing))  # ranks: the test sees no size, infinite ones none
    return len(differing), float(stats.wilcoxon(signed).pvalue)
