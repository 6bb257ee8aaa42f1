"""What a point is worth: lost runs first, then the geometric mean of the errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evalkit.commands.study.evaluate import RunScores
from evalkit.commands.study.plan import Response
from evalkit.commands.study.result import bounded, why_lost
from evalkit.commands.tune.plan import COST
from evalkit.commands.tune.space import Candidate
from evalkit.core.se2 import Floats
from evalkit.stats.bootstrap import bootstrap_interval
from evalkit.stats.intervals import Interval

MIN_GAIN = 0.05
"""Nobody is better by less than this share of the error, as in the report."""


@dataclass(frozen=True, eq=False)
class Tried:
    """A point with its runs: the errors (R,) with lost runs at the bound, why they are lost, and what they cost.

    One number decides between points that lose equally many runs: the geometric mean of the errors. In logarithms a run
    of 2 cm halved counts as much as one of 20 cm halved, so that no single long sequence decides, and the same ratios
    are tested as in the report. Lost runs come first, because millimetres elsewhere do not make good a robot that is
    lost; within the mean they stand at the bound, the worst that counts.
    """

    candidate: Candidate
    errors: Floats
    lost: tuple[str, ...]
    cpu_ms: float
    cpu_s: float
    failed: bool

    @property
    def error(self) -> float:
        """The geometric mean of the errors, in the objective's unit."""
        return float(np.exp(np.mean(np.log(self.errors))))

    @property
    def losses(self) -> int:
        """How many runs are lost."""
        return sum(map(bool, self.lost))

    @property
    def order(self) -> tuple[int, float]:
        """Less is better; to nine digits, so that rounding decides nothing."""
        return self.losses, round(math.log(self.error), 9)


def judged(candidate: Candidate, results: Sequence[RunScores], objective: Response) -> Tried:
    """A point with the results of its runs; a back end has ``failed`` it where no run was completed."""
    errors = np.array([max(bounded(result, objective), 1e-12) for result in results])
    known = [cost for result in results if (cost := result["scores"][COST]) is not None]
    return Tried(
        candidate,
        errors,
        tuple(why_lost(result, (objective,)) for result in results),
        float(np.median(known)) if known else math.nan,
        float(sum(result["cpu_s"] for result in results)),
        all(result["status"] != "complete" for result in results),
    )


def best(tried: Sequence[Tried]) -> Tried:
    """The best of points; of equal ones the earliest, and so the default before all."""
    return min(tried, key=lambda one: one.order)


def ratio(ours: Tried, theirs: Tried, seed: int) -> Interval:
    """The mean ratio of errors over the same runs with its 95 % bootstrap interval over runs: below 1 is better."""
    logs = np.log(ours.errors) - np.log(theirs.errors)
    found = bootstrap_interval(logs, np.mean, np.random.default_rng(seed), block=1)
    return Interval(math.exp(found.value), math.exp(found.low), math.exp(found.high), found.support)


def better(ours: Tried, theirs: Tried, found: Interval) -> bool:
    """Whether one is better than another by more than noise: no more runs lost, all of the interval and 5 % below 1."""
    return ours.losses <= theirs.losses and found.high < 1.0 and found.value <= 1.0 - MIN_GAIN
