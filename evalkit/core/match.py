"""The answer of one registration."""

from __future__ import annotations

from dataclasses import dataclass

from evalkit.core.arrays import Ints
from evalkit.core.pose import Pose


@dataclass(frozen=True, slots=True, eq=False)
class Iteration:
    """One step of an iterative registration: the error (m) and pairs before it, the pose after it, the pairs if traced.

    ``pairs`` (K, 2): indices into source and target, or None.
    """

    error: float
    inliers: int
    target_from_source: Pose
    pairs: Ints | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """A registration's answer. Not converging is an answer, not an error.

    ``error``: the back end's own final error in metres (nan where it has none). ``inliers``: pairs it stands on.
    ``history``: one entry per iteration where the back end can tell.
    """

    target_from_source: Pose
    converged: bool
    iterations: int
    error: float
    inliers: int
    history: tuple[Iteration, ...] = ()
