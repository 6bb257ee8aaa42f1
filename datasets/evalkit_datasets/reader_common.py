"""What all recordings share: which scans are taken, the odometry at a scan, and the truth that belongs to them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.errors import BadData, DataMissing
from evalkit.core.ground_truth import Relations, Truth
from evalkit.core.measured_distances import Span
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.io.timestamps import format_stamp
from evalkit.io.tum import read_tum
from evalkit.plugins.parameters import Parameter
from evalkit_datasets import relations, spans

HOLD_NS = 50_000_000
"""So far before its first or after its last pose odometry still answers, with that pose: a robot moves millimetres."""

SLACK_NS = 100_000_000
"""Truth this near to the first or last scan still belongs to the recording: the relations' own matching limit."""

GAP_NS = 1_000_000_000
"""Odometry silent for longer than this between two poses is counted: what lies between is a straight line."""

SELECTION: tuple[Parameter, ...] = (
    Parameter("start", 0, "scans", "leave out so many scans at the beginning", low=0),
    Parameter("every", 1, "scans", "take every n-th scan", low=1),
    Parameter("limit", 0, "scans", "stop after so many scans taken; 0: all", low=0),
)

TRUTH: tuple[Parameter, ...] = (
    Parameter("relations", "", "", "path of Kuemmerle relations for this recording; empty: none"),
    Parameter("reference", "", "", "path of a reference trajectory in TUM format, same clock; empty: none"),
    Parameter("spans", "", "", "path of distances measured with a tape (TOML), times by the same clock; empty: none"),
)


def selection(start: int, every: int, limit: int) -> slice:
    """Which of the scans in order of time are taken."""
    return slice(start, start + every * limit if limit else None, every)


def counted(counts: Mapping[str, int]) -> dict[str, int]:
    """The counts that are not zero."""
    return {name: int(count) for name, count in counts.items() if count}


def odometry_at(odometry: Trajectory, stamps_ns: Stamps) -> Floats:
    """The poses (K, 3) interpolated at times (K,); nan where the odometry says nothing."""
    poses = np.full((len(stamps_ns), 3), np.nan)
    first, last = odometry.stamps_ns[0], odometry.stamps_ns[-1]
    for some in blocks(len(stamps_ns)):
        near = (stamps_ns[some] >= first - HOLD_NS) & (stamps_ns[some] <= last + HOLD_NS)
        poses[some][near] = odometry.at(np.clip(stamps_ns[some][near], first, last))
    return poses


def blocks(count: int, size: int = 4096) -> Iterator[slice]:
    """Slices that together are so many rows: what is computed for some at a time takes little memory on the way."""
    return (slice(begin, min(begin + size, count)) for begin in range(0, count, size))


def odometry_counts(odometry: Trajectory, stamps_ns: Stamps) -> dict[str, int]:
    """How many scans the odometry does not reach, and how many lie in a gap of it, by name."""
    first, last = odometry.stamps_ns[0], odometry.stamps_ns[-1]
    outside = (stamps_ns < first) | (stamps_ns > last)
    far = (stamps_ns < first - HOLD_NS) | (stamps_ns > last + HOLD_NS)
    return {
        "scans without odometry at their time": int(far.sum()),
        "scans up to 50 ms outside the odometry, given its nearest pose": int((outside & ~far).sum()),
        "scans in a gap of the odometry over 1 s": int(_in_gap(odometry, stamps_ns[~outside]).sum()),
    }


def pose_or_none(row: Floats) -> Pose | None:
    """The pose of a row (3,), None where it is nan."""
    return None if np.isnan(row).any() else Pose.of(row)


def sensor_pose(owner: str, text: str) -> Pose:
    """The pose in a parameter "x y theta" (m, m, rad)."""
    try:
        x, y, theta = (float(word) for word in text.replace(",", " ").split())
        return Pose(x, y, theta)
    except ValueError:
        raise BadData(
            owner, "base_from_sensor", f"'{text}'", "expected 'auto' or three numbers 'x y theta' in m, m, rad"
        ) from None


def truth_from_files(
    taken_ns: Stamps,
    span_ns: tuple[int, int],
    relations_path: str,
    reference_path: str,
    how: str,
    spans_path: str = "",
) -> tuple[Truth, dict[str, int]]:
    """The truth of the files, cut to the time of the scans taken, and what was cut off, counted by name.

    ``span_ns``: first and last scan of the whole recording. BadData where a file and the recording share no time at
    all: then it belongs to another recording.
    """
    counts: dict[str, int] = {}
    known, trajectory = None, None
    if relations_path:
        everything = relations.read(Path(relations_path))
        times = np.stack([everything.first_ns, everything.second_ns])
        _same_recording(Path(relations_path), "relations", times, span_ns)
        inside = np.asarray(_within(times, taken_ns).all(axis=0))
        counts["relations outside the scans"] = int((~inside).sum())
        known = _some_relations(everything, inside)
    if reference_path:
        file = read_tum(Path(reference_path))
        poses = file.trajectory
        _same_recording(Path(reference_path), "reference trajectory", poses.stamps_ns[None], span_ns)
        inside = _within(poses.stamps_ns, taken_ns)
        counts |= {f"reference: {name}": count for name, count in file.notes.items()}
        counts["reference poses outside the scans"] = int((~inside).sum())
        trajectory = Trajectory(poses.stamps_ns[inside], poses.poses[inside]) if inside.any() else None
    taped: tuple[Span, ...] = ()
    if spans_path:
        taped, counts["distances by tape outside the scans"] = _taped(Path(spans_path), taken_ns, span_ns)
    return Truth(how, trajectory, known, spans=taped), counted(counts)


def missing_files(owner: str, paths: Iterable[tuple[str, str]]) -> str:
    """The first file that is not there and what to do, "" where all are; (parameter, path) pairs, empty paths count."""
    for parameter, path in paths:
        if not path:
            return f"{owner}: parameter '{parameter}' is empty; give a path"
        if not Path(path).exists():
            return f"{owner}: parameter '{parameter}': no file {path}; check the path"
    return ""


def truth_files(given: Mapping[str, object]) -> list[tuple[str, str]]:
    """Name and path of the files of truth among a reader's parameters."""
    return [(each.name, str(given[each.name])) for each in TRUTH if given.get(each.name)]


def existing(owner: str, path: str) -> Path:
    """The path, or DataMissing."""
    if reason := missing_files(owner, [("path", path)]):
        raise DataMissing(owner, *reason.removeprefix(f"{owner}: ").split("; ", 1))
    return Path(path)


def _in_gap(odometry: Trajectory, stamps_ns: Stamps) -> Bools:
    """Which times (K,) lie strictly between two odometry poses more than a second apart."""
    right = np.searchsorted(odometry.stamps_ns, stamps_ns)
    exact = odometry.stamps_ns[np.minimum(right, len(odometry) - 1)] == stamps_ns
    gap = np.diff(odometry.stamps_ns, prepend=odometry.stamps_ns[0], append=odometry.stamps_ns[-1]) > GAP_NS
    moved = np.zeros(len(gap), dtype=bool)
    ends = np.flatnonzero(gap[1:-1]) + 1
    steps = se2.between(odometry.poses[ends - 1], odometry.poses[ends])
    moved[ends] = np.abs(steps).max(axis=1, initial=0.0) > 1e-6
    return np.asarray(gap[right] & moved[right] & ~exact)


def _within(times_ns: Stamps, scans_ns: Stamps) -> Bools:
    return np.asarray((times_ns >= scans_ns[0] - SLACK_NS) & (times_ns <= scans_ns[-1] + SLACK_NS))


def _same_recording(path: Path, what: str, times_ns: Stamps, span_ns: tuple[int, int]) -> None:
    """Refuses truth of which not one entry lies in the time of the recording."""
    if _within(times_ns, np.array(span_ns)).all(axis=0).any():
        return
    begins, ends = (format_stamp(int(times_ns.min())), format_stamp(int(times_ns.max())))
    scans = f"the scans are from {format_stamp(span_ns[0])} to {format_stamp(span_ns[1])} s"
    raise BadData(
        str(path),
        "",
        f"its times, {begins} to {ends} s, have nothing in common with the recording: {scans}",
        f"is it the {what} of another data set? give the one of this recording or none",
    )


def _taped(path: Path, taken_ns: Stamps, span_ns: tuple[int, int]) -> tuple[tuple[Span, ...], int]:
    """The distances whose times lie within the scans taken, and how many do not."""
    everything = spans.read(path)
    times = [[end.stamp_ns for end in (span.first, span.second) if end.stamp_ns is not None] for span in everything]
    if known := [time for each in times for time in each]:
        _same_recording(path, "distances by tape", np.array([known]), span_ns)
    inside = [bool(_within(np.array(each, dtype=np.int64), taken_ns).all()) for each in times]
    return tuple(span for span, kept in zip(everything, inside, strict=True) if kept), inside.count(False)


def _some_relations(everything: Relations, chosen: Bools) -> Relations | None:
    if not chosen.any():
        return None
    return Relations(everything.first_ns[chosen], everything.second_ns[chosen], everything.first_from_second[chosen])
