"""Disturb drives of worlds with ground truth and count lost tracks: ``python tests/baselines/slam/lost_tracks.py 4``.

``carried``: at 60 % of the drive the robot is put back to where it was at 20 %, and drives on from there; the wheels do
not notice. ``gap``: 10 s without scans in the middle. ``blind gap``: the same without odometry. ``covered``: three
times, for 1.5 s, all beams end 0.3 to 1 m away, as if people stood around the robot. ``dirty``: 60 % of the beams have
no return, 5 % a random range, and 10 % of the scans are missing. ``followed``: somebody walks 1.2 m behind. ``body``:
30 deg of the view end 0.25 m behind the lidar. ``batches``: of every two scans the first one is stamped 2 ms before the
second, and there is no odometry; nor is there in ``no odometry``, which tells how much of it is due to the stamps.

A row for each world and disturbance: drives; drives with a lost track; those of them in which the last part of the
drive was found again; lost tracks in all; ATE RMSE of the corrected poses, median and worst (cm).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from false_loops import ate

from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.plugins import registry

WORLDS = ("loop", "office", "doors", "wings", "symmetric-office", "long-loop")
GAP_NS, COVERED_NS = 10_000_000_000, 1_500_000_000
BEHIND_M, HALF_WIDTH_M = 1.2, 0.25
BODY_M, BODY_RAD = 0.25, np.radians(30.0)
BATCH_NS = 2_000_000


class Taken(NamedTuple):
    """A frame, and when it was taken in the drive without a disturbance: for the true pose."""

    frame: Frame
    stamp_ns: int


def main() -> int:
    """Drive and print."""
    parser = argparse.ArgumentParser(description="Count lost tracks that are found again.")
    parser.add_argument("drives", type=int, nargs="?", default=2, help="of each world")
    parser.add_argument("--method", default="embedded-slam", choices=("paper-slam", "embedded-slam"))
    parser.add_argument("--first-seed", type=int, default=2000)
    parser.add_argument("--worlds", nargs="*", default=list(WORLDS), choices=WORLDS)
    parser.add_argument("--work", type=int, help="operations a scan of embedded-slam")
    arguments = parser.parse_args()
    heads = ("world", "disturbance", "drives", "with a lost track", "found again", "lost tracks", "ATE cm", "worst")
    sys.stdout.write(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}\n")
    changed = {} if arguments.work is None else {"work": arguments.work}
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.drives)
    for world in arguments.worlds:
        drives = [registry.dataset(world).make(seed=seed) for seed in seeds]
        frames = [[Taken(frame, frame.scan.stamp_ns) for frame in drive.frames()] for drive in drives]
        for name, disturb in DISTURBANCES.items():
            results = [
                run(disturb(taken, np.random.default_rng(seed)), drive.truth().trajectory, arguments.method, changed)
                for seed, taken, drive in zip(seeds, frames, drives, strict=True)
            ]
            lost, found, errors = (np.array(column) for column in zip(*results, strict=True))
            counts = (len(results), (lost > 0).sum(), found.sum(), lost.sum())
            cells = (world, name, *map(str, counts), f"{100.0 * np.median(errors):.1f}", f"{100.0 * errors.max():.1f}")
            sys.stdout.write(f"| {' | '.join(cells)} |\n")
            sys.stdout.flush()
    return 0


def run(drive: Sequence[Taken], true: Trajectory, method: str, changed: dict[str, int]) -> tuple[int, bool, float]:
    """Return the lost tracks, whether the robot was found again after the last one, and the ATE RMSE (m)."""
    spec = registry.backend(method)
    slam = spec.make(**{each.name: each.default for each in spec.parameters} | changed)
    answers = [(one.frame.scan.stamp_ns, slam.update(one.frame)) for one in drive]
    # a scan that was not matched, because the robot turned unevenly within it, is not lost
    lost_ns = [stamp_ns for stamp_ns, answer in answers if answer.accepted is False and answer.stages]
    again = [loop.stamp_ns for loop in slam.loop_closures() if loop.accepted and loop.found_again]
    found = bool(lost_ns) and max(again, default=0) > lost_ns[-1]
    return len(lost_ns), found, ate(slam.trajectory().poses, true.at([one.stamp_ns for one in drive]))


def carry(drive: Sequence[Taken], rng: np.random.Generator) -> list[Taken]:
    """Carry the robot back."""
    del rng
    at, to = int(0.6 * len(drive)), int(0.2 * len(drive))
    before, after = drive[at - 1].frame, drive[to].frame
    later_ns = before.scan.stamp_ns - drive[to - 1].frame.scan.stamp_ns
    stands = (before.odom_from_base or Pose()) @ (after.odom_from_base or Pose()).inverse()
    return [*drive[:at], *(_changed(one, later_ns, stands) for one in drive[to:])]


def _changed(taken: Taken, later_ns: int, new_from_odom: Pose) -> Taken:
    scan = replace(taken.frame.scan, stamp_ns=taken.frame.scan.stamp_ns + later_ns)
    odom = taken.frame.odom_from_base
    return Taken(replace(taken.frame, scan=scan, odom_from_base=odom and new_from_odom @ odom), taken.stamp_ns)


def leave_gap(drive: Sequence[Taken], rng: np.random.Generator) -> list[Taken]:
    """Leave out 10 s."""
    del rng
    middle = drive[len(drive) // 2].stamp_ns
    return [one for one in drive if not middle <= one.stamp_ns < middle + GAP_NS]


def leave_blind_gap(drive: Sequence[Taken], rng: np.random.Generator) -> list[Taken]:
    """Leave out 10 s, and all odometry."""
    return leave_odometry(leave_gap(drive, rng), rng)


def leave_odometry(drive: Sequence[Taken], rng: np.random.Generator) -> list[Taken]:
    """Leave out all odometry."""
    del rng
    return [Taken(replace(one.frame, odom_from_base=None, start_from_end=None), one.stamp_ns) for one in drive]


def stamp_batches(drive: Sequence[Taken], rng: np.random.Generator) -> list[Taken]:
    """Stamp two scans at a time, and leave out all odometry."""

    def stamped(at: int, one: Taken) -> Taken:
        second = drive[min(at + 1, len(drive) - 1)]
        stamp_ns = one.stamp_ns if at % 2 or second is one else second.stamp_ns - BATCH_NS
        return Taken(replace(one.frame, scan=replace(one.frame.scan, stamp_ns=stamp_ns)), one.stamp_ns)

    return leave_odometry([stamped(at, one) for at, one in enumerate(drive)], rng)


def follow(drive: Sequence[Taken], rng: np.random.Generator) -> list[Taken]:
    """Let a person walk behind, whose back is flat."""

    def away_m(angles: Floats) -> Floats:
        behind = np.abs(np.tan(angles)) <= HALF_WIDTH_M / BEHIND_M
        return np.where(behind & (np.cos(angles) < 0.0), BEHIND_M / np.abs(np.cos(angles)), np.inf)

    return [_cover_by(one, away_m, rng) for one in drive]


def show_body(drive: Sequence[Taken], rng: np.random.Generator) -> list[Taken]:
    """Let the lidar see the robot behind it."""
    return [
        _cover_by(one, lambda angles: np.where(np.cos(angles) <= -np.cos(0.5 * BODY_RAD), BODY_M, np.inf), rng)
        for one in drive
    ]


def _cover_by(taken: Taken, away_m: Callable[[Floats], Floats], rng: np.random.Generator) -> Taken:
    """Cover the beams (angles in the base's directions, rad) that end on something so far away, with noise of 1 cm."""
    scan = taken.frame.scan
    away = away_m(scan.angles + taken.frame.base_from_sensor.theta)
    seen = away + 0.01 * rng.standard_normal(len(away))
    return _with_ranges(taken, np.where(np.isfinite(away), np.fmin(scan.ranges, seen), scan.ranges))


def cover(drive: Sequence[Taken], rng: np.random.Generator) -> list[Taken]:
    """Cover the lidar three times."""
    begins = [drive[int(share * len(drive))].stamp_ns for share in (0.3, 0.5, 0.7)]

    def covered(one: Taken) -> Taken:
        if not any(begin <= one.stamp_ns < begin + COVERED_NS for begin in begins):
            return one
        return _with_ranges(one, rng.uniform(0.3, 1.0, len(one.frame.scan.ranges)))

    return [covered(one) for one in drive]


def make_dirty(drive: Sequence[Taken], rng: np.random.Generator) -> list[Taken]:
    """Drop beams and scans, and give some beams a random range."""

    def dirty(one: Taken) -> Taken:
        share = rng.random(len(one.frame.scan.ranges))
        ranges = np.where(share < 0.6, np.inf, one.frame.scan.ranges)
        return _with_ranges(one, np.where(share >= 0.95, rng.uniform(0.3, 8.0, len(share)), ranges))

    return [dirty(one) for one in drive if rng.random() >= 0.1]


def _with_ranges(taken: Taken, ranges: np.ndarray) -> Taken:
    return Taken(replace(taken.frame, scan=replace(taken.frame.scan, ranges=ranges)), taken.stamp_ns)


DISTURBANCES: dict[str, Callable[[Sequence[Taken], np.random.Generator], list[Taken]]] = {
    "none": lambda drive, _: list(drive),
    "carried": carry,
    "gap": leave_gap,
    "blind gap": leave_blind_gap,
    "covered": cover,
    "dirty": make_dirty,
    "followed": follow,
    "body": show_body,
    "no odometry": leave_odometry,
    "batches": stamp_batches,
}

if __name__ == "__main__":
    sys.exit(main())
