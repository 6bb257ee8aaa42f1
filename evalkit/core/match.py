"""Match: the answer of one registration."""

from __future__ import annotations

import math
from dataclasses import dataclass

from evalkit.core.arrays import Ints
from evalkit.core.pose import Pose
from evalkit.core.timing import NO_COST, Cost


@dataclass(frozen=True, slots=True, eq=False)
class Iteration:
    """One step of an iterative registration: error (m) and number of pairs before the step, pose after it.

    ``pairs`` (K, 2): indices into source and target, None where they are not traced.
    """

    error: float
    inliers: int
    target_from_source: Pose
    pairs: Ints | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Answer of a registration. A registration that does not converge returns an answer too and raises no error.

    ``error``: final error in metres as the back end defines it (nan where it has none). ``inliers``: number of pairs
    behind the answer. ``history``: one entry per iteration, empty where the back end has no trace. ``cost``: what only
    the back end itself can measure.
    """

    target_from_source: Pose
    converged: bool
    iterations: int
    error: float
    inliers: int
    history: tuple[Iteration, ...] = ()
    cost: Cost = NO_COST

    @classmethod
    def not_converged(cls, guess: Pose, inliers: int = 0, cost: Cost = NO_COST) -> Match:
        """Return the answer of a registration without a result: the guess, with error nan."""
        return cls(guess, converged=False, iterations=0, error=math.nan, inliers=inliers, cost=cost)
