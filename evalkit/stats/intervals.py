"""Confidence intervals: the value type, and the interval of a share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Interval:
    """A value with its confidence interval.

    ``low``, ``high``: bounds that contain the true value with probability ``confidence``. ``support``: number of
    observations. Raises ValueError if ``low`` exceeds ``high`` or ``confidence`` is not between 0 and 1.
    """

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


def wilson_interval(successes: int, trials: int, confidence: float = CONFIDENCE) -> Interval:
    """Return the share of successes with Wilson's score interval (Wilson, JASA 22, 1927).

    Raises ValueError without a trial, or if ``successes`` is not between 0 and ``trials``.
    """
    from scipy.special import ndtri

    if not 0 <= successes <= trials or trials == 0:
        raise ValueError(f"successes: expected 0 to {trials} of at least one trial, got {successes}")
    share, z = successes / trials, float(ndtri(0.5 + confidence / 2.0))
    centre = (share + z**2 / (2.0 * trials)) / (1.0 + z**2 / trials)
    half = z / (1.0 + z**2 / trials) * math.sqrt(share * (1.0 - share) / trials + (z / (2.0 * trials)) ** 2)
    low = 0.0 if successes == 0 else centre - half
    high = 1.0 if successes == trials else centre + half
    return Interval(share, low, high, trials, confidence)


@cache
def student_quantile(freedom: int, confidence: float = CONFIDENCE) -> float:
    """Return the half width of a two-sided interval of Student's t in standard errors; ``freedom``: its degrees."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.5 + confidence / 2.0))
