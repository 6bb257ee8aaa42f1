"""Close the loops that are confirmed, and correct the keyframes by them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from evalkit.core import se2
from evalkit.core.loop_closure import LoopClosure
from evalkit_baselines.slam import pose_graph
from evalkit_baselines.slam.keyframes import DOUBTED_M, Edge, Keyframes
from evalkit_baselines.slam.loop_finder import Candidate, LoopFinder
from evalkit_baselines.slam.loop_reasons import describe_found_again, describe_unconfirmed, describe_withdrawn

DCS_PHI = 10.0
_CONFIRMED_WITHIN_M = 6.0
_AGREE_M, _AGREE_RAD = 0.2, math.radians(2.0)
_CORRECTED_M, _CORRECTED_RAD = 0.01, math.radians(0.5)
"""An earlier pose that moves by more was corrected, see ``OdometryEstimate.corrected``."""


@dataclass
class _Recorded:
    """A candidate as reported, and the loop edge it became; ``edge`` is None where it was rejected."""

    closure: LoopClosure
    edge: Edge | None = None


class LoopCloser:
    """Closes loops at the last keyframe: where two candidates agree, or one fits very well."""

    def __init__(self, keyframes: Keyframes, finder: LoopFinder, quick_gate: float) -> None:
        """``quick_gate``: a candidate of a small window with at most this chi-square needs no other one."""
        self._keyframes, self._finder, self._quick_gate = keyframes, finder, quick_gate
        self._recorded: list[_Recorded] = []
        self._waiting: list[Candidate] = []
        self.has_corrected = False
        """Whether the last loop moved poses before the last keyframe by more than a little."""

    def closures(self) -> tuple[LoopClosure, ...]:
        """Return all candidates so far."""
        return tuple(recorded.closure for recorded in self._recorded)

    def forget_unconfirmed(self) -> None:
        """Let no candidate so far be confirmed: the track was lost."""
        self._waiting = []

    def close(self, measured: bool) -> bool:
        """Look for a loop; return whether one was closed. ``measured``: the last keyframe has wheel odometry."""
        candidate = self._finder.find(self._keyframes, self._expected(), measured)
        return candidate is not None and self.consider(candidate)

    def consider(self, candidate: Candidate) -> bool:
        """Record a candidate of the last keyframe; return whether it closed a loop, which corrects the keyframes."""
        passed = candidate.passed
        quick = candidate.is_local and candidate.chi_square <= self._quick_gate
        agreeing = [other for other in self._waiting if passed and self._agree(other, candidate)]
        if not passed or not (quick or agreeing):
            reason = candidate.reason if not passed else describe_unconfirmed(candidate.reason)
            self._record(candidate.edge, False, reason)
            if passed:
                self._waiting = [*self._waiting[-3:], candidate]
            return False
        self._waiting = []
        edge, reason = candidate.edge, candidate.reason
        found_again = bool(self._keyframes.apart_m[edge.first] >= DOUBTED_M)
        if found_again:
            self._keyframes.join(edge, contradicts=not candidate.known)
            reason = describe_found_again(reason, self._keyframes.sections[edge.second])
        self._record(edge, True, reason, found_again)
        self.has_corrected = self._optimise() or found_again
        return True

    def _expected(self) -> Candidate | None:
        """Return the last unconfirmed candidate, where another one may still confirm it."""
        path_m, last = self._keyframes.path_m, self._waiting[-1] if self._waiting else None
        return last if last is not None and path_m[-1] - path_m[last.edge.second] <= _CONFIRMED_WITHIN_M else None

    def _agree(self, earlier: Candidate, later: Candidate) -> bool:
        keyframes, first, second = self._keyframes, earlier.edge, later.edge
        if keyframes.path_m[second.second] - keyframes.path_m[first.second] > _CONFIRMED_WITHIN_M:
            return False
        driven = keyframes.pose(first.second).inverse() @ keyframes.pose(second.second)
        one = keyframes.pose(first.first) @ first.first_from_second @ driven
        two = keyframes.pose(second.first) @ second.first_from_second
        gap = one.inverse() @ two
        return math.hypot(gap.x, gap.y) <= _AGREE_M and abs(gap.theta) <= _AGREE_RAD

    def _record(self, edge: Edge, accepted: bool, reason: str, found_again: bool = False) -> None:
        later, earlier = (self._keyframes.stamps_ns[index] for index in (edge.second, edge.first))
        closure = LoopClosure(later, earlier, edge.first_from_second, accepted, reason, found_again=found_again)
        self._recorded.append(_Recorded(closure, edge if accepted else None))
        if accepted:
            self._keyframes.loops.append(edge)

    def _optimise(self) -> bool:
        """Optimise all keyframes; return whether earlier poses moved. Loops that contradict others are withdrawn."""
        keyframes = self._keyframes
        graph, trusted = keyframes.graph(), keyframes.trusted()
        kernel = pose_graph.dcs_kernel(DCS_PHI, trusted)
        solution = pose_graph.optimise(graph, kernel=kernel, max_iterations=10, tolerance=1e-6)
        kept = keyframes.loops
        if (solution.graph.chi_squares()[~trusted] > pose_graph.SLOW_GATE).any():
            solution = pose_graph.optimise_truncated(graph, trusted)
            weights = solution.weights[~trusted]
            kept = [loop for loop, weight in zip(keyframes.loops, weights, strict=True) if weight > 0.5]
            self._withdraw(kept)
        moved = np.abs(se2.between(keyframes.poses[:-1], solution.graph.poses[:-1]))  # the last one is of this scan
        keyframes.correct(solution.graph.poses, kept)
        return bool(((np.hypot(moved[:, 0], moved[:, 1]) > _CORRECTED_M) | (moved[:, 2] > _CORRECTED_RAD)).any())

    def _withdraw(self, kept: list[Edge]) -> None:
        for recorded in self._recorded:
            if recorded.edge is not None and not any(recorded.edge is edge for edge in kept):
                reason = describe_withdrawn(recorded.closure.reason)
                recorded.closure = replace(recorded.closure, accepted=False, reason=reason)
                recorded.edge = None
