"""Mistakes in reading a frame, or in returning a trajectory: what the reference answers with them names a cause."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from evalkit.core.arrays import Bools, Ints
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats

FrameChange = Callable[[Frame], Frame]

DISTANCES_M = (3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
GRIDS_M = (0.001, 0.005, 0.01, 0.02, 0.05, 0.1)


def mistaken_frames() -> Iterator[tuple[str, FrameChange]]:
    """Mistakes in reading frames: what is wrong, and the frame as it is read."""
    yield "the wheel odometry is not used", lambda one: replace(one, odom_from_base=None, start_from_end=None)
    yield "the motion within a scan is not used: it is not deskewed", lambda one: replace(one, start_from_end=None)
    yield "the motion within a scan is inverted", lambda one: replace(one, start_from_end=_inverse(one.start_from_end))
    yield "the turn within a scan has the wrong sign", _turned_back
    yield "the mounting of the lidar is not used", lambda one: replace(one, base_from_sensor=Pose())
    yield (
        "the mounting of the lidar is inverted",
        lambda one: replace(one, base_from_sensor=one.base_from_sensor.inverse()),
    )
    yield from _of_angles()
    yield from _of_ranges()


def mistaken_trajectories(rows: Floats) -> Iterator[tuple[str, Floats]]:
    """Mistakes in returning the right poses (N, 3)."""
    yield "answers are one scan late", np.concatenate([rows[:1], rows[:-1]])


def skipped_scans(count: int) -> Iterator[tuple[str, Ints]]:
    """Scans that may be skipped: what is wrong, and the last one (N,) that is processed, at each of ``count`` scans."""
    for every in range(2, 11):
        scans = np.arange(count, dtype=np.int64)
        yield f"one scan of {every} is skipped: it has the answer before", scans - ((scans + 1) % every == 0)


def _of_angles() -> Iterator[tuple[str, FrameChange]]:
    yield "the angles of the beams are in the reverse order", lambda one: _with_angles(one, one.scan.angles[::-1])
    yield "the angles of the beams are clockwise", lambda one: _with_angles(one, -one.scan.angles)
    yield "the angles of the beams are in degrees", lambda one: _with_angles(one, np.degrees(one.scan.angles))
    for start in (0.0, -math.pi):
        yield f"the angles of the beams are not read: they are even from {start:.3g} rad", _even_from(start)


def _of_ranges() -> Iterator[tuple[str, FrameChange]]:
    for chosen, name in ((np.isinf, "no return"), (np.isnan, "an invalid range")):
        for share in (0.001, 0.01, 0.1, 0.95, 0.99, 0.999):
            what = f"{name} is a point at {share:g} of the way from the smallest range to the largest"
            yield what, _at_share(chosen, share)
    for limit_m in DISTANCES_M:
        yield f"ranges beyond {limit_m:g} m are not used", _nearer_than(limit_m)
    for step_m in GRIDS_M:
        yield f"ranges are rounded to {step_m:g} m", _on_grid(step_m, np.round)
        yield f"ranges are cut to {step_m:g} m", _on_grid(step_m, np.floor)
    for count in (64, 100, 128, 180, 200, 240, 256, 300, 359):
        yield f"only the first {count} beams are used", _of_beams(slice(count, None))
    yield "only every second beam is used", _of_beams(slice(1, None, 2))


def _at_share(chosen: Callable[[Floats], Bools], share: float) -> FrameChange:
    def read(frame: Frame) -> Frame:
        least, most = frame.scan.range_min_m, frame.scan.range_max_m
        return _fill_ranges(frame, chosen, least + share * (most - least))

    return read


def _even_from(start: float) -> FrameChange:
    def read(frame: Frame) -> Frame:
        count = len(frame.scan.angles)
        return _with_angles(frame, start + np.arange(count, dtype=np.float64) * (2.0 * math.pi / max(count, 1)))

    return read


def _nearer_than(limit_m: float) -> FrameChange:
    return lambda one: _fill_ranges(one, lambda ranges: np.asarray(ranges > limit_m), math.nan)


def _on_grid(step_m: float, rounding: Callable[[Floats], Floats]) -> FrameChange:
    return lambda one: _with_ranges(one, rounding(one.scan.ranges / step_m) * step_m)


def _of_beams(dropped: slice) -> FrameChange:
    def read(frame: Frame) -> Frame:
        ranges = frame.scan.ranges.copy()
        ranges[dropped] = math.nan
        return _with_ranges(frame, ranges)

    return read


def _with_angles(frame: Frame, angles: Floats) -> Frame:
    return replace(frame, scan=replace(frame.scan, angles=np.ascontiguousarray(angles)))


def _with_ranges(frame: Frame, ranges: Floats) -> Frame:
    return replace(frame, scan=replace(frame.scan, ranges=ranges))


def _fill_ranges(frame: Frame, chosen: Callable[[Floats], Bools], value: float) -> Frame:
    return _with_ranges(frame, np.where(chosen(frame.scan.ranges), value, frame.scan.ranges))


def _inverse(pose: Pose | None) -> Pose | None:
    return None if pose is None else pose.inverse()


def _turned_back(frame: Frame) -> Frame:
    within = frame.start_from_end
    return frame if within is None else replace(frame, start_from_end=Pose(within.x, within.y, -within.theta))
