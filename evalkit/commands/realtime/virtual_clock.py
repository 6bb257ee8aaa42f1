"""A virtual clock: the scans that a device slower by a factor answers, and when.

No function here reads a clock: costs come from a profile measured once (``realtime.simulation``), so the
same profile drops the same scans every time.
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

Cost = Callable[[int, int], int]
"""Nanoseconds of a scan by its index and its gap: so many scans after the last one answered (1: none between)."""


@dataclass(frozen=True, eq=False)
class Schedule:
    """The scans answered, in order: their indices ``answered`` (K,), begun and done (K,) on the virtual clock.

    ``arrivals_ns`` (N,): when each scan of the sequence is complete. ``deadlines_ns`` (N,): when the next one is.
    """

    arrivals_ns: Stamps
    deadlines_ns: Stamps
    answered: Ints
    begun_ns: Stamps
    done_ns: Stamps

    @property
    def dropped_share(self) -> float:
        """Scans never answered, of all."""
        return 1.0 - len(self.answered) / len(self.arrivals_ns)

    @property
    def late(self) -> Bools:
        """Whether each answer (K,) was complete only after the next scan."""
        return np.asarray(self.done_ns > self.deadlines_ns[self.answered])

    @property
    def age_ns(self) -> Stamps:
        """Time (K,) from a scan being complete to its answer."""
        return np.asarray(self.done_ns - self.arrivals_ns[self.answered])


def schedule(arrivals_ns: ArrayLike, cost: Cost, policy: Policy = "queue-of-one") -> Schedule:
    """The scans that are answered if each is processed to its end, one at a time.

    A scan that arrives at the moment an answer is complete finds the robot free. Raises ValueError for arrivals (N,),
    N > 1, that do not increase, an unknown policy, and a negative cost.
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
        next_one = int(np.searchsorted(arrivals, free, side))  # drop: the first to come; else behind the newest here
        index = max(next_one if policy == "drop" else next_one - 1, index + 1)
    answered, begun_ns, done_ns = np.array(rows, dtype=np.int64).T
    period = int(np.median(np.diff(arrivals)))
    return Schedule(arrivals, np.append(arrivals[1:], arrivals[-1] + period), answered, begun_ns, done_ns)


def at_hand(stamps_ns: ArrayLike, made: Schedule, answers: Floats, odometry: Floats | None) -> Floats:
    """The poses (N, 3) the robot goes by when each scan begins: the newest answer done by then, carried on to then.

    ``answers`` (K, 3): ``start_from_base`` of the scans answered. ``odometry`` (N, 3): ``odom_from_base`` at the stamps
    (N,), which carries an answer on as REP-105's map-from-odom does; None: as fast as between the last two answers, for
    twice that time at most. Before the first answer the robot goes by the odometry alone, or stands still.
    """
    stamps = np.asarray(stamps_ns, dtype=np.int64)
    newest = np.searchsorted(made.done_ns, stamps, "right") - 1
    known = np.concatenate([np.zeros((1, 3)), answers])[newest + 1]
    scan = np.where(newest < 0, 0, made.answered[newest])
    if odometry is not None:
        return se2.compose(known, se2.between(odometry[scan], odometry))
    if len(answers) < 2:
        return known
    step = se2.between(answers[:-1], answers[1:])
    took = np.diff(stamps[made.answered])
    last = np.maximum(newest - 1, 0)
    share = np.where(newest > 0, np.minimum((stamps - stamps[scan]) / took[last], 2.0), 0.0)
    onward = [
        se2.fraction(step[row], np.array([part]))[0] for row, part in zip(last.tolist(), share.tolist(), strict=True)
    ]
    return se2.compose(known, np.array(onward))


@dataclass(frozen=True, eq=False)
class CostProfile:
    """What each scan costs a back end here: ``scans_ns`` (N,) with every scan answered, and ``growth`` with gaps.

    Where scans are dropped the next one has moved further and costs more: ``growth[k]`` is the mean cost with only
    every ``gaps[k]``-th scan answered, in units of that of the same scans with all answered (so ``gaps[0]`` and
    ``growth[0]`` are 1). Between the gaps measured it is interpolated over their logarithm, beyond them it stays.
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

    def slowed(self, factor: float) -> Cost:
        """The cost on a device that takes ``factor`` times as long, as ``schedule`` asks for it."""
        return lambda index, gap: round(factor * self.ns(index, gap))


@dataclass(frozen=True, slots=True)
class LinearCost:
    """Cost = ``base_ns`` + ``step_ns`` times the work, where the work of a scan is its iterations times its points.

    ``residual``: median of the relative differences, predicted to measured, without sign, where it was fitted;
    ``held_out``: the same on runs with gaps, which had no part in the fit.
    """

    base_ns: float
    step_ns: float
    residual: float
    held_out: float

    def ns(self, work: ArrayLike) -> Floats:
        """The cost predicted for work of any shape."""
        return np.asarray(self.base_ns + self.step_ns * np.asarray(work, dtype=np.float64))


def linear_cost(
    work: ArrayLike, cost_ns: ArrayLike, held_out_work: ArrayLike = (), held_out_ns: ArrayLike = ()
) -> LinearCost | None:
    """The line of least squares through work and cost (N,); None if the work does not vary."""
    x, y = np.asarray(work, dtype=np.float64), np.asarray(cost_ns, dtype=np.float64)
    if len(x) < 3 or np.ptp(x) == 0.0:
        return None
    step, base = np.polyfit(x, y, 1)
    apart = _apart(base + step * x, y)
    unseen = np.asarray(held_out_work, dtype=np.float64)
    return LinearCost(float(base), float(step), apart, _apart(base + step * unseen, np.asarray(held_out_ns)))


def _apart(predicted: Floats, measured: Floats) -> float:
    return float(np.median(np.abs(predicted / measured - 1.0))) if len(predicted) else 0.0


@dataclass(frozen=True, slots=True)
class Rule:
    """When a slowed run counts as broken: an ATE over ``times`` that without drops *and* over ``floor_m``, or lost."""

    times: float = 2.0
    floor_m: float = 0.05

    def broken(self, ate_m: float | None, undropped_m: float) -> bool:
        """Whether a run with this ATE is broken; None: it was lost."""
        return ate_m is None or (ate_m > self.times * undropped_m and ate_m > self.floor_m)

    def __str__(self) -> str:
        return (
            f"the ATE is over {self.times:g} times the one without dropped scans and over {100.0 * self.floor_m:g} cm, "
            "or the back end has lost track (fewer than two answers, or it failed)"
        )


def headroom(arrivals_ns: ArrayLike, profile: CostProfile) -> float:
    """The largest device factor at which every scan is answered before the next one is complete."""
    periods = np.diff(np.asarray(arrivals_ns, dtype=np.int64))
    return float((np.append(periods, np.median(periods)) / profile.scans_ns).min())


def first_broken(factors: Sequence[float], broken: Sequence[bool]) -> float | None:
    """The smallest factor that is broken; None if all hold."""
    return next((factor for factor, is_broken in sorted(zip(factors, broken, strict=True)) if is_broken), None)
