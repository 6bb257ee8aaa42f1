"""Schedule of a slower device on a virtual clock: which scans it answers, and when.

No function here reads a clock. The costs come from a measured profile (``realtime.simulation``), so the same profile
always drops the same scans.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints
from evalkit.core.se2 import Floats, Stamps

Policy = Literal["drop", "queue-of-one"]
"""The treatment of a scan that arrives while the robot is busy.

"drop": it is lost. "queue-of-one": it waits until a newer one replaces it; the robot processes it next.
"""

POLICIES: tuple[Policy, ...] = get_args(Policy)

ScanCost = Callable[[int, int], int]
"""Cost (ns) of a scan by its index and its gap, the number of scans since the last answered one (1: no drop)."""


@dataclass(frozen=True, eq=False)
class Schedule:
    """The answered scans, in order: indices ``answered`` (K,), start and end of processing (K,) on the virtual clock.

    ``arrivals_ns`` (N,): the time at which each scan is complete. ``deadlines_ns`` (N,): that of the next scan.
    """

    arrivals_ns: Stamps
    deadlines_ns: Stamps
    answered: Ints
    begun_ns: Stamps
    done_ns: Stamps

    @property
    def dropped_share(self) -> float:
        """The share of scans without an answer."""
        return 1.0 - len(self.answered) / len(self.arrivals_ns)

    @property
    def late(self) -> Bools:
        """Whether each answer (K,) is complete only after the next scan."""
        return np.asarray(self.done_ns > self.deadlines_ns[self.answered])

    @property
    def age_ns(self) -> Stamps:
        """The time (K,) from the end of a scan to its answer."""
        return np.asarray(self.done_ns - self.arrivals_ns[self.answered])


def compute_schedule(arrivals_ns: ArrayLike, cost: ScanCost, policy: Policy = "queue-of-one") -> Schedule:
    """Compute which scans are answered if they are processed one at a time, each to its end.

    A scan that arrives at the moment an answer is complete is processed at once. Raises ValueError if ``arrivals_ns``
    (N,) has fewer than two times or does not increase, for an unknown policy, and for a negative cost.
    """
    arrivals = np.asarray(arrivals_ns, dtype=np.int64)
    if arrivals.ndim != 1 or len(arrivals) < 2 or (np.diff(arrivals) <= 0).any():
        raise ValueError("arrivals_ns: expected two or more increasing times")
    if policy not in POLICIES:
        raise ValueError(f"policy: found {policy!r}, expected one of: {', '.join(POLICIES)}")
    rows: list[tuple[int, int, int]] = []
    index, free = 0, int(arrivals[0])
    while index < len(arrivals):
        gap = index - rows[-1][0] if rows else 1
        begun = max(free, int(arrivals[index]))
        if (spent := cost(index, gap)) < 0:
            raise ValueError(f"cost: negative at scan {index}: {spent} ns")
        free = begun + spent
        rows.append((index, begun, free))
        side: Literal["left", "right"] = "left" if policy == "drop" else "right"
        next_one = int(np.searchsorted(arrivals, free, side))  # drop: the next to arrive; else the newest that waits
        index = max(next_one if policy == "drop" else next_one - 1, index + 1)
    answered, begun_ns, done_ns = np.array(rows, dtype=np.int64).T
    period = int(np.median(np.diff(arrivals)))
    return Schedule(arrivals, np.append(arrivals[1:], arrivals[-1] + period), answered, begun_ns, done_ns)


def compute_live_poses(stamps_ns: ArrayLike, schedule: Schedule, answers: Floats, odometry: Floats | None) -> Floats:
    """Compute the newest known pose (N, 3) at the start of each scan, extrapolated to that time.

    ``answers`` (K, 3): ``start_from_base`` of the answered scans. ``odometry`` (N, 3): ``odom_from_base`` at the stamps
    (N,); it extrapolates an answer as the map-from-odom transform of REP-105 does. If None, the motion between the last
    two answers continues at the same speed, for at most twice their time. Before the first answer the pose is that of
    the odometry alone, or the origin.
    """
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    newest = np.searchsorted(schedule.done_ns, stamps, "right") - 1
    known = np.concatenate([np.zeros((1, 3)), answers])[newest + 1]
    scan = np.where(newest < 0, 0, schedule.answered[newest])
    if odometry is not None:
        return se2.compose(known, se2.between(odometry[scan], odometry))
    if len(answers) < 2:
        return known
    step = se2.between(answers[:-1], answers[1:])
    durations = np.diff(stamps[schedule.answered])
    last = np.maximum(newest - 1, 0)
    share = np.where(newest > 0, np.minimum((stamps - stamps[scan]) / durations[last], 2.0), 0.0)
    onward = [
        se2.fraction(step[row], np.array([part]))[0] for row, part in zip(last.tolist(), share.tolist(), strict=True)
    ]
    return se2.compose(known, np.array(onward))


@dataclass(frozen=True, eq=False)
class CostProfile:
    """The cost (ns) of each scan on this machine: ``scans_ns`` (N,) without drops, and its ``growth`` with gaps.

    After dropped scans the robot has moved further, and the next scan costs more. ``growth[k]`` is the mean cost if
    only every ``gaps[k]``-th scan is processed, divided by the cost of the same scans if all are (``gaps[0]`` and
    ``growth[0]`` are 1). It is interpolated over the logarithm of the gap, and constant beyond the largest gap.
    """

    scans_ns: Stamps
    gaps: Ints
    growth: Floats

    def __post_init__(self) -> None:
        if len(self.scans_ns) < 2 or not (np.asarray(self.scans_ns) > 0).all():
            raise ValueError("scans_ns: expected two or more positive costs")
        if len(self.gaps) != len(self.growth) or self.gaps[0] != 1 or (np.diff(self.gaps) <= 0).any():
            raise ValueError("gaps: expected 1 and increasing whole numbers, one for each growth")

    def ns(self, index: int, gap: int) -> float:
        """The cost of a scan on this machine."""
        return float(self.scans_ns[index] * np.interp(np.log(gap), np.log(self.gaps), self.growth))

    def slow_down(self, factor: float) -> ScanCost:
        """The cost on a device that takes ``factor`` times as long, for ``compute_schedule``."""
        return lambda index, gap: round(factor * self.ns(index, gap))


@dataclass(frozen=True, slots=True)
class LinearCost:
    """Cost = ``base_ns`` + ``step_ns`` times the work, where the work of a scan is its iterations times its points.

    ``residual``: median absolute relative difference of predicted and measured cost on the fitted scans; ``held_out``:
    the same on runs with gaps, which are not part of the fit.
    """

    base_ns: float
    step_ns: float
    residual: float
    held_out: float

    def ns(self, work: ArrayLike) -> Floats:
        """The predicted cost for work of any shape."""
        return np.asarray(self.base_ns + self.step_ns * np.asarray(work, dtype=np.float64))


def fit_linear_cost(
    work: ArrayLike, cost_ns: ArrayLike, held_out_work: ArrayLike = (), held_out_ns: ArrayLike = ()
) -> LinearCost | None:
    """Fit the least-squares line through work and cost (N,); None for fewer than three scans or constant work."""
    x, y = np.asarray(work, dtype=np.float64), np.asarray(cost_ns, dtype=np.float64)
    if len(x) < 3 or np.ptp(x) == 0.0:
        return None
    step, base = np.polyfit(x, y, 1)
    unseen = base + step * np.asarray(held_out_work, dtype=np.float64)
    residual, held_out = _median_difference(base + step * x, y), _median_difference(unseen, np.asarray(held_out_ns))
    return LinearCost(float(base), float(step), residual, held_out)


def _median_difference(predicted: Floats, measured: Floats) -> float:
    return float(np.median(np.abs(predicted / measured - 1.0))) if len(predicted) else 0.0


@dataclass(frozen=True, slots=True)
class BreakingRule:
    """A run is broken if it is lost, or its ATE exceeds ``floor_m`` and ``times`` the ATE without drops."""

    times: float = 2.0
    floor_m: float = 0.05

    def is_broken(self, ate_m: float | None, undropped_m: float) -> bool:
        """Whether a run with this ATE is broken; None: the run is lost."""
        return ate_m is None or (ate_m > self.times * undropped_m and ate_m > self.floor_m)

    def __str__(self) -> str:
        return (
            f"the ATE is over {self.times:g} times the one without dropped scans and over {100.0 * self.floor_m:g} cm, "
            "or the back end has lost track (fewer than two answers, or it failed)"
        )


def compute_headroom(arrivals_ns: ArrayLike, profile: CostProfile) -> tuple[float, int, float]:
    """Compute the largest device factor at which every scan is answered before the next one is complete.

    Returns it with the index of the scan that limits it and the time in ns until the next one is complete.
    """
    periods = np.diff(np.asarray(arrivals_ns, dtype=np.int64))
    periods = np.append(periods, np.median(periods))
    slowest = int(np.argmin(periods / profile.scans_ns))
    return float(periods[slowest] / profile.scans_ns[slowest]), slowest, float(periods[slowest])


def find_breaking_factor(factors: Sequence[float], broken: Sequence[bool]) -> float | None:
    """Find the smallest factor whose run is broken; None if there is none."""
    return next((factor for factor, is_broken in sorted(zip(factors, broken, strict=True)) if is_broken), None)
