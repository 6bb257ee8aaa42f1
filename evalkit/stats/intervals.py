"""Confidence intervals: the value type, and the interval of a share."""

from __future__ import annotations

from dataclasses import dataclass

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
    from scipy import stats

    if not 0 <= successes <= trials or trials == 0:
        raise ValueError(f"successes: expected 0 to {trials} of at least one trial, got {successes}")
    bounds = stats.binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    return Interval(successes / trials, float(bounds.low), float(bounds.high), trials, confidence)
