"""Margins within which two answers are equal, and equivalence intervals of series of differences."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core import se2
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.stats.runs import mean_interval

FLOAT32_ROUNDOFF = 2.0**-24
"""Relative error of rounding once to single precision."""

TIE_ROUNDINGS = 8.0
"""Two distances are equal within this many single-precision roundings of the largest coordinate."""

CONTRACTION = 2.0 / 3.0
"""Factor by which one ICP step reduces the error of the one before (linear convergence), for the float32 margin."""

MIN_FOR_BOOTSTRAP = 30
RESAMPLES = 2000
LEVEL = 0.90
"""Confidence of the interval: within the margin, both one-sided tests at 5 % reject "too far" (Schuirmann 1987)."""


@dataclass(frozen=True)
class Margin:
    """The largest difference that counts as equal: metres, radians, log-odds; ``origin``: how it was determined."""

    metres: float = 1e-9
    radians: float = 1e-9
    log_odds: float = 1e-5
    origin: str = "as given"

    def __post_init__(self) -> None:
        for name in ("metres", "radians", "log_odds"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"margin {name}: expected a positive number, got {getattr(self, name)}")

    def holds(self, a: Pose, b: Pose) -> bool:
        """Whether two poses are equal within the margin."""
        turn = math.remainder(b.theta - a.theta, 2.0 * math.pi)
        return math.hypot(b.x - a.x, b.y - a.y) <= self.metres and abs(turn) <= self.radians


FLOAT32: Literal["float32"] = "float32"

MarginChoice = Margin | Literal["float32"]
"""A margin, or the effect of rounding to single precision at the scale of each question."""


@dataclass(frozen=True)
class GeometryScale:
    """The quantities that determine rounding: largest coordinate (m), most points, least rms radius of a source (m)."""

    reach_m: float
    points: int
    radius_m: float

    @classmethod
    def of(cls, target: Cloud, source: Cloud, guess: Pose) -> GeometryScale:
        """The scale of one question."""
        moved = guess.transform(source.points)
        coordinates = np.concatenate([target.points, source.points, moved]).ravel()
        return cls(float(np.abs(coordinates).max(initial=0.0)), len(source), radius_m(source.points))

    @classmethod
    def largest(cls, scales: Iterable[GeometryScale]) -> GeometryScale:
        """The scale with the largest rounding error."""
        known = list(scales)
        radius = min((one.radius_m for one in known), default=0.0)
        return cls(
            max((one.reach_m for one in known), default=0.0), max((one.points for one in known), default=0), radius
        )


def radius_m(points: Floats) -> float:
    """The root mean square distance (m) of points (N, 2) from their centroid; 0 without points."""
    arms = points - points.mean(axis=0) if len(points) else np.zeros((1, 2))
    return float(np.sqrt(np.mean(np.sum(arms**2, axis=1))))


def float32_margin(scale: GeometryScale) -> Margin:
    """The margin of an ICP answer for rounding to single precision.

    Each of N points is rounded about three times (stored, turned, shifted), each time by u = 2^-24 of the largest
    coordinate C. The error of a sequential sum of N terms is a random walk: u C sqrt(N / 3) on their mean
    (Higham and Mary 2019). The error of one step is therefore s = u C (3 + sqrt(N / 3)) metres; as a turn of points
    with rms radius r it is s / r radians, which moves a point at distance C by C s / r. A later step corrects all but
    a share of 2/3 (linear convergence), so the errors of all steps add up to at most three times that of one.
    """
    gain = 1.0 / (1.0 - CONTRACTION)
    step = FLOAT32_ROUNDOFF * scale.reach_m * (3.0 + math.sqrt(scale.points / 3.0))
    turn = step / max(scale.radius_m, 1e-3)
    origin = (
        f"float32: s = u C (3 + sqrt(N/3)) = {step:.2g} m, u = 2^-24, C = {scale.reach_m:.3g} m, N = {scale.points}; "
        f"{gain:.0f} (s + C s/r) and {gain:.0f} s/r with r = {scale.radius_m:.3g} m"
    )
    metres = max(gain * (step + scale.reach_m * turn), FLOAT32_ROUNDOFF)
    return Margin(metres, max(gain * turn, FLOAT32_ROUNDOFF), origin=origin)


def float64_margin(scale: GeometryScale, least: Margin) -> Margin:
    """A margin, or the effect of rounding to double precision at a scale where that is larger: 16 times the formula."""
    single = float32_margin(scale)
    share = 16.0 * 2.0**-29
    return replace(
        least, metres=max(least.metres, share * single.metres), radians=max(least.radians, share * single.radians)
    )


@dataclass(frozen=True)
class EquivalenceInterval:
    """The 90 % interval of the mean of one quantity, in ``unit``, with the margin and the worst single value."""

    quantity: str
    unit: str
    mean: float
    low: float
    high: float
    worst: float
    worst_scan: int
    margin: float
    n: int
    method: str

    @property
    def inside(self) -> bool:
        """Whether both one-sided tests pass."""
        return -self.margin < self.low and self.high < self.margin


def interval(quantity: str, unit: str, values: ArrayLike, scans: ArrayLike, margin: float) -> EquivalenceInterval:
    """The interval of the mean of values (N,), one per scan, in the order of time; infinite for fewer than two.

    From 30 values on by moving blocks of n^(1/3) scans (Kuensch 1989), which assumes that differences farther apart are
    independent; for fewer by Student's t, which assumes that all are independent.
    """
    series, at = np.asarray(values, dtype=np.float64), np.asarray(scans)
    n = len(series)
    if n < 2:
        low, high, method = -math.inf, math.inf, "fewer than two scans"
    elif n < MIN_FOR_BOOTSTRAP:
        found = mean_interval(series, LEVEL)
        low, high, method = found.low, found.high, "Student's t"
    else:
        low, high = _block_interval(series, np.random.default_rng(0))
        method = "moving blocks"
    row = int(np.argmax(np.abs(series))) if n else 0
    mean, worst, worst_scan = (float(series.mean()), float(series[row]), int(at[row])) if n else (math.inf, math.inf, 0)
    return EquivalenceInterval(quantity, unit, mean, low, high, worst, worst_scan, margin, n, method)


def pose_intervals(stage: str, a_from_b: Floats, scans: ArrayLike, margin: Margin) -> tuple[EquivalenceInterval, ...]:
    """Five intervals of differences (N, 3): signed x, y and theta, which show a bias, and the magnitudes.

    Signed differences can cancel over a sequence; magnitudes cannot.
    """
    shift = np.hypot(a_from_b[:, 0], a_from_b[:, 1])
    return (
        interval(f"{stage} x", "m", a_from_b[:, 0], scans, margin.metres),
        interval(f"{stage} y", "m", a_from_b[:, 1], scans, margin.metres),
        interval(f"{stage} theta", "rad", a_from_b[:, 2], scans, margin.radians),
        interval(f"{stage} |translation|", "m", shift, scans, margin.metres),
        interval(f"{stage} |rotation|", "rad", np.abs(a_from_b[:, 2]), scans, margin.radians),
    )


def difference(a: Pose, b: Pose) -> Floats:
    """The row (3,) ``a_from_b`` of two answers to one question."""
    return se2.between(a.row, b.row)


def describe_gap(a: Pose, b: Pose) -> str:
    """The distance and the turn between two poses in words."""
    away = a.inverse() @ b
    return f"{math.hypot(away.x, away.y):.2g} m and {abs(away.theta):.2g} rad"


def _block_interval(series: Floats, rng: np.random.Generator) -> tuple[float, float]:
    n = len(series)
    length = math.ceil(n ** (1.0 / 3.0))
    starts = rng.integers(0, n - length + 1, (RESAMPLES, math.ceil(n / length)))
    rows = (starts[:, :, None] + np.arange(length)).reshape(RESAMPLES, -1)[:, :n]
    low, high = np.quantile(series[rows].mean(axis=1), [0.5 - LEVEL / 2.0, 0.5 + LEVEL / 2.0])
    return float(low), float(high)
