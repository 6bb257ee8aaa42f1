"""Read what a method has at the end of a sequence, and check it: remarks, corrected poses, loop closures."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from evalkit.core.errors import plain
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.pose import MAX_COORDINATE_M, TOO_FAR
from evalkit.core.se2 import Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.plugins.protocols import Odometry, Remarking, Slam

MAX_CLOSURES = 100_000
"""Most loop closures, candidates included, that a run may report."""

MAX_REMARKS = 10
"""Most remarks of a method on a run."""


@dataclass(frozen=True, eq=False)
class Corrections:
    """What a SLAM has at the end. ``cpu_ns``: CPU time of asking for it."""

    trajectory: Trajectory
    closures: tuple[LoopClosure, ...]
    cpu_ns: int


def read_corrections(odometry: Odometry, stamps_ns: Stamps) -> Corrections:
    """Ask a SLAM for its corrected poses and its loop closures; raises as ``read_trajectory`` and the next function."""
    slam = cast("Slam", odometry)
    begun_ns = time.process_time_ns()
    trajectory, closures = read_trajectory(slam, stamps_ns), read_loop_closures(slam, stamps_ns)
    return Corrections(trajectory, closures, time.process_time_ns() - begun_ns)


def read_trajectory(slam: Slam, stamps_ns: Stamps) -> Trajectory:
    """Return the corrected trajectory at the stamps (N,) of all answered frames.

    Raises TypeError or ValueError where ``trajectory`` returns something else, other stamps, or a pose that is not
    finite or too far away, and whatever it raises.
    """
    found: object = slam.trajectory()
    if not isinstance(found, Trajectory):
        raise TypeError(f"trajectory() returned a {type(found).__name__}, expected an evalkit.Trajectory")
    if len(found) != len(stamps_ns):
        raise ValueError(f"trajectory() returned {len(found)} poses for {len(stamps_ns)} answered frames")
    if (other := np.flatnonzero(found.stamps_ns != stamps_ns)).size:
        index = int(other[0])
        what = f"{found.stamps_ns[index]} ns at index {index}, expected {stamps_ns[index]} ns, the stamp of the frame"
        raise ValueError(f"trajectory() returned the stamp {what}")
    if found.poses.shape != (len(found), 3) or not np.isfinite(found.poses).all():  # a subclass may skip the check
        raise ValueError("trajectory() returned a pose that is not finite")
    if (far := np.flatnonzero((np.abs(found.poses[:, :2]) > MAX_COORDINATE_M).any(axis=1))).size:
        raise ValueError(f"trajectory() returned a pose {TOO_FAR} at stamp {stamps_ns[far[0]]} ns")
    return Trajectory(found.stamps_ns, found.poses, "start", "base")


def read_loop_closures(slam: Slam, stamps_ns: Stamps) -> tuple[LoopClosure, ...]:
    """Return the loop closures between answered frames with stamps (N,), in the order given.

    Raises TypeError or ValueError where ``loop_closures`` returns something else, more than ``MAX_CLOSURES``, or one
    between frames that were not answered, and whatever it raises.
    """
    found: object = slam.loop_closures()
    if not isinstance(found, Sequence):
        raise TypeError(f"loop_closures() returned a {type(found).__name__}, expected a tuple of evalkit.LoopClosure")
    if len(found) > MAX_CLOSURES:
        raise ValueError(f"loop_closures() returned {len(found)} candidates, at most {MAX_CLOSURES} are stored")
    closures: list[LoopClosure] = []
    for index, one in enumerate(found):
        if not isinstance(one, LoopClosure):
            what = f"loop_closures() returned a {type(one).__name__} at index {index}"
            raise TypeError(f"{what}, expected an evalkit.LoopClosure")
        closures.append(one)
    if unknown := find_unknown_stamp(closures, stamps_ns.tolist()):
        index, _, stamp = unknown
        raise ValueError(f"loop_closures() refers at index {index} to {stamp} ns, where no frame was answered")
    return tuple(closures)


def find_unknown_stamp(closures: Sequence[LoopClosure], stamps_ns: Iterable[int]) -> tuple[int, str, int] | None:
    """Find the first stamp of a loop closure at which no frame was answered: index, name and stamp; None without."""
    known = set(stamps_ns)
    for index, one in enumerate(closures):
        for name, stamp in (("stamp_ns", one.stamp_ns), ("other_stamp_ns", one.other_stamp_ns)):
            if stamp not in known:
                return index, name, stamp
    return None


def read_remarks(odometry: Odometry) -> tuple[str, ...]:
    """Return the remarks of an odometry on its answers, each as one printable line; () of one without ``remarks``.

    Raises TypeError or ValueError where it returns something else or more than ``MAX_REMARKS``, and whatever it raises.
    """
    found: object = odometry.remarks() if isinstance(odometry, Remarking) else ()
    if not isinstance(found, tuple) or not all(isinstance(one, str) and one for one in found):
        raise TypeError(f"remarks() returned {found!r}, expected a tuple of texts")
    if len(found) > MAX_REMARKS:
        raise ValueError(f"remarks() returned {len(found)} texts, at most {MAX_REMARKS} are stored")
    return tuple(plain(one) for one in found)
