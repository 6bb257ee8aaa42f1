"""What the readers of recordings share: which scans to take, odometry at the scans, checks of paths."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.errors import BadData, DataMissing
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.specs import Choice
from evalkit_datasets.parsing import truth_files

WITHOUT_ODOMETRY = "scans without odometry at their time"
DAMAGED_LINES = "damaged lines dropped"
REPEATED_STAMPS = "scans with a repeated stamp dropped"
"""Names of defects in the notes of a reader."""

HOLD_NS = 50_000_000
"""Up to this long outside the odometry a scan gets its nearest pose: a robot moves millimetres in that time."""

GAP_NS = 1_000_000_000
"""Scans between odometry poses further apart than this are counted: their odometry is a straight line."""

BLOCK_ROWS = 4096
"""Rows that are computed at once."""

JUMP, JUMP_SPEED = (1.0, math.radians(60.0)), (5.0, 2.0 * math.pi)
"""A step of the odometry that is longer (m, rad) and faster (m/s, rad/s) is no motion of an indoor vehicle."""

SELECTION: tuple[Parameter, ...] = (
    Parameter("start", 0, "scans", "number of scans to skip at the beginning", low=0),
    Parameter("every", 1, "scans", "take every n-th scan", low=1),
    Parameter("limit", 0, "scans", "number of scans to take; 0: all", low=0),
)


def choose_parameters(reader: str, given: Mapping[str, Value]) -> Iterable[Choice]:
    """Return what an inspection of the recording ``given["path"]`` by a reader finds in it and beside it."""
    # by name: a change of the inspection is no change of the reader, on which the identity of a run depends
    inspection = import_module("evalkit_datasets.commands.inspect.suggested_config")
    found: tuple[Choice, ...] = inspection.choose_parameters(reader, given)
    return found


def select_scans(start: int, every: int, limit: int) -> slice:
    """Return the slice of the scans to take, in order of time."""
    return slice(start, start + every * limit if limit else None, every)


def drop_zeros(counts: Mapping[str, int]) -> dict[str, int]:
    """Return the counts that are not zero."""
    return {name: int(count) for name, count in counts.items() if count}


def odometry_at(odometry: Trajectory, stamps_ns: Stamps) -> Floats:
    """Return the poses (K, 3) interpolated at times (K,); nan more than ``HOLD_NS`` outside the odometry."""
    poses = np.full((len(stamps_ns), 3), np.nan)
    first, last = odometry.stamps_ns[0], odometry.stamps_ns[-1]
    for rows in split_rows(len(stamps_ns)):
        near = (stamps_ns[rows] >= first - HOLD_NS) & (stamps_ns[rows] <= last + HOLD_NS)
        poses[rows][near] = odometry.at(np.clip(stamps_ns[rows][near], first, last))
    return poses


def split_rows(count: int) -> Iterator[slice]:
    """Yield slices of ``BLOCK_ROWS`` rows that together cover ``count`` rows: bounds the memory of temporaries."""
    return (slice(begin, min(begin + BLOCK_ROWS, count)) for begin in range(0, count, BLOCK_ROWS))


def are_jumps(moved: Floats, seconds: Floats, least: tuple[float, float], speed: tuple[float, float]) -> Bools:
    """Return which steps (N,) are jumps: longer, or turned further, than ``least`` and than ``speed`` allows.

    ``moved`` (N, 2): lengths and turns of the steps (m, rad), ``seconds`` (N,): their times; ``speed`` in m/s, rad/s.
    """
    return np.asarray(((moved > least) & (moved > np.outer(seconds, speed))).any(axis=1))


def are_large_jumps(moved: Floats, seconds: Floats) -> Bools:
    """Return which steps (N,) ``join_jumps`` takes out; arguments as in ``are_jumps``."""
    return are_jumps(moved, seconds, JUMP, JUMP_SPEED)


def join_jumps(stamps_ns: Stamps, poses: Floats) -> tuple[Floats, dict[str, int]]:
    """Return odometry poses (N, 3) whose jumps are taken out, and their number by name of the defect.

    The poses after a jump, such as that of a driver that begins again at the origin, go on from the pose before it, as
    if the base had stood meanwhile. The same array where nothing jumps; a pose may be nan.
    """
    steps = se2.between(poses[:-1], poses[1:])
    moved = np.stack([np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])], axis=1)
    jumps = np.flatnonzero(are_large_jumps(moved, 1e-9 * np.diff(stamps_ns))) + 1
    joined = poses.copy() if len(jumps) else poses
    for begin, end in pairwise([*jumps, len(poses)]):
        correction = se2.compose(joined[begin - 1], se2.inverse(poses[begin]))
        joined[begin:end] = se2.compose(correction, poses[begin:end])
    return joined, {"jumps of the odometry over 1 m and 5 m/s or 60 deg and 360 deg/s, taken out": len(jumps)}


def count_odometry_gaps(odometry: Trajectory, stamps_ns: Stamps) -> dict[str, int]:
    """Return how many scans lie outside the odometry or in a gap of it, by name of the defect."""
    first, last = odometry.stamps_ns[0], odometry.stamps_ns[-1]
    outside = (stamps_ns < first) | (stamps_ns > last)
    far = (stamps_ns < first - HOLD_NS) | (stamps_ns > last + HOLD_NS)
    return {
        WITHOUT_ODOMETRY: int(far.sum()),
        "scans up to 50 ms outside the odometry, given its nearest pose": int((outside & ~far).sum()),
        "scans in a gap of the odometry over 1 s": int(_is_in_gap(odometry, stamps_ns[~outside]).sum()),
    }


def pose_or_none(row: Floats) -> Pose | None:
    """Return the pose of a row (3,), or None if the row is nan."""
    return None if np.isnan(row).any() else Pose.of(row)


def parse_sensor_pose(owner: str, text: str) -> Pose:
    """Return the pose in a parameter "x y theta" (m, m, rad); raises BadData if it is not one."""
    try:
        x, y, theta = (float(word) for word in text.replace(",", " ").split())
        return Pose(x, y, theta)
    except ValueError:
        raise BadData(
            owner, "base_from_sensor", f"'{text}'", "expected 'auto' or three numbers 'x y theta' in m, m, rad"
        ) from None


def describe_missing_files(owner: str, **given: object) -> str:
    """Return which file among a reader's parameters is missing and what to do, "" if all exist."""
    paths = [("path", str(given.get("path", "")))]
    paths += [(each.name, str(given[each.name])) for each in truth_files.PARAMETERS if given.get(each.name)]
    return _describe_first_missing(owner, paths)


def check_exists(owner: str, path: str) -> Path:
    """Return the path; raises DataMissing if it is empty or does not exist."""
    if reason := _describe_first_missing(owner, [("path", path)]):
        raise DataMissing(owner, *reason.removeprefix(f"{owner}: ").split("; ", 1))
    return Path(path)


def _describe_first_missing(owner: str, paths: Iterable[tuple[str, str]]) -> str:
    for parameter, path in paths:
        if not path:
            return f"{owner}: parameter '{parameter}' is empty; give a path"
        if not Path(path).exists():
            begin = "" if Path(path).is_absolute() else ", which begins at the working folder"
            return f"{owner}: parameter '{parameter}': no file {path}; check the path{begin}"
    return ""


def _is_in_gap(odometry: Trajectory, stamps_ns: Stamps) -> Bools:
    """Return which times (K,) lie strictly between two different odometry poses more than ``GAP_NS`` apart."""
    right = np.searchsorted(odometry.stamps_ns, stamps_ns)
    exact = odometry.stamps_ns[np.minimum(right, len(odometry) - 1)] == stamps_ns
    gap = np.diff(odometry.stamps_ns, prepend=odometry.stamps_ns[0], append=odometry.stamps_ns[-1]) > GAP_NS
    moved = np.zeros(len(gap), dtype=bool)
    ends = np.flatnonzero(gap[1:-1]) + 1
    steps = se2.between(odometry.poses[ends - 1], odometry.poses[ends])
    moved[ends] = np.abs(steps).max(axis=1, initial=0.0) > 1e-6
    return np.asarray(gap[right] & moved[right] & ~exact)
