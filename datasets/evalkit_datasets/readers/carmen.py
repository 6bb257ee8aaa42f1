"""Read a CARMEN log as a Sequence: scans in order of time, odometry at each scan, ground truth."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from evalkit.core.arrays import Bools, Ints
from evalkit.core.errors import BadData
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.core.se2 import Floats, Stamps, between
from evalkit.core.trajectory import Trajectory
from evalkit.io.timestamps import order_stamps
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import DatasetSpec
from evalkit_datasets.parsing import carmen_parser, truth_files
from evalkit_datasets.parsing.buffers import sort_by_rank
from evalkit_datasets.parsing.carmen_parser import Log, Reading
from evalkit_datasets.parsing.range_minimum import RANGE_MIN, raise_range_min_m
from evalkit_datasets.parsing.truth_files import TruthPaths
from evalkit_datasets.readers import reader_common

CODES_M = (32.767,)
"""Ranges below every plausible ``range_max_m`` that always mean no return."""

MILLIMETRE_CODES_M = (8.18, 8.183, 8.187, 8.19, 8.191)
"""No-return values of a SICK LMS in millimetre mode; ordinary ranges in a log with longer ones."""

UNUSABLE_STAMPS = "scans with unusable stamps, placed one second apart in line order"

POSES_FROM = {
    "gmapping": "GMapping's poses from the log (particle filter; about 6 cm against relations)",
    "graph": "graph-optimised poses from the log (about 3 to 4 cm against relations)",
}


@dataclass(frozen=True, slots=True, eq=False)
class _Scans:
    """Scans without their ranges: times, line numbers, poses (N, 3) of the laser and of the robot.

    ``longest_m`` (N,): longest range of a scan that is not a no-return. ``invalid`` (N,): number of ranges that are
    zero, negative, nan or below the minimum.
    """

    stamps_ns: Stamps
    lines: Ints
    laser: Floats
    robot: Floats
    longest_m: Floats
    invalid: Ints

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __getitem__(self, which: slice | Ints) -> _Scans:
        return _Scans(*(getattr(self, name)[which] for name in self.__slots__))


class Carmen:
    """The Sequence of a CARMEN log. The stamp is ipc_timestamp, exact in ns; all beams of a scan share it.

    No returns are ranges of ``range_max_m`` or more, 32.767 m, and 8.18 to 8.191 m if no range of the log is longer.
    Zero, negative and nan ranges are invalid, and those below ``range_min_m``. Odometry "auto" is the ODOM lines, else
    the robot pose of each scan, else none. A corrected log (by GMapping, or with graph vertices) has no odometry: its
    poses are the ground truth.
    """

    def __init__(
        self,
        path: str,
        relations: str = "",
        ground_truth: str = "",
        odometry: str = "auto",
        range_max_m: float = 50.0,
        base_from_sensor: str = "auto",
        start_deg: float = -90.0,
        step_deg: float = 0.0,
        start: int = 0,
        every: int = 1,
        limit: int = 0,
        how: str = "",
        spans: str = "",
        range_min_m: float = 0.0,
    ) -> None:
        self._path = reader_common.check_exists("carmen", path)
        self._range_max_m = range_max_m
        self._range_min_m = raise_range_min_m("carmen", 0.0, range_min_m, range_max_m)
        self._layout = start_deg, step_deg
        log = Log(self._layout)
        scans = self._read_scans(log)
        self._counts = {reader_common.DAMAGED_LINES: log.damaged, "rear-laser lines ignored": log.rear}
        whole = self._order(log, scans)
        self._taken = whole[reader_common.select_scans(start, every, limit)]
        if not len(self._taken):
            raise BadData(str(path), "", f"start {start} lies beyond its {len(whole)} scans", "start earlier")
        self._base_from_sensor = (
            _find_mounting(log, scans)
            if base_from_sensor == "auto"
            else reader_common.parse_sensor_pose("carmen", base_from_sensor)
        )
        self._codes = _select_no_return_codes(whole)
        self._odometry = self._find_odometry(log, scans, odometry)
        self._truth = self._load_truth(log, whole, TruthPaths(relations, ground_truth, spans, how))
        self._counts["invalid ranges"] = int(self._taken.invalid.sum())

    def __len__(self) -> int:
        return len(self._taken)

    def frames(self) -> Iterator[Frame]:
        """Yield the scans in order of time, read from the log one by one."""
        return self.frames_from(0)

    def frames_from(self, first: int) -> Iterator[Frame]:
        """Yield the scans from number ``first`` on."""
        taken = self._taken[slice(first, None)]
        ranks = np.argsort(taken.lines)
        lines = carmen_parser.iter_readings_at(self._path, self._layout, taken.lines[ranks])
        limits = self._range_min_m, self._range_max_m
        readings = sort_by_rank(zip(ranks.tolist(), lines, strict=True))
        for stamp, reading, row in zip(taken.stamps_ns, readings, self._odometry[first:], strict=True):
            scan = Scan(int(stamp), self._mark_ranges(reading.ranges), reading.angles, *limits)
            yield Frame(scan, self._base_from_sensor, reader_common.pose_or_none(row))

    def truth(self) -> Truth:
        """Return the ground truth of the given files; without them the poses of a corrected log."""
        return self._truth

    def notes(self) -> Mapping[str, int]:
        """Return the number of defects handled, by name."""
        return reader_common.drop_zeros(self._counts)

    def _read_scans(self, log: Log) -> _Scans:
        """Return all scans in file order; the other lines are added to ``log``."""
        stamps, lines, invalid = array("q"), array("q"), array("q")
        laser, robot, longest = array("d"), array("d"), array("d")
        for number, reading in carmen_parser.iter_readings(self._path, log):
            stamps.append(reading.stamp_ns)
            lines.append(number)
            laser.extend(reading.laser)
            robot.extend(reading.robot)
            longest.append(self._find_longest_m(reading))
            invalid.append(int(np.count_nonzero(~self._is_valid(reading.ranges))))
        return _Scans(
            np.array(stamps, dtype=np.int64),
            np.array(lines, dtype=np.int64),
            np.array(laser, dtype=np.float64).reshape(-1, 3),
            np.array(robot, dtype=np.float64).reshape(-1, 3),
            np.array(longest, dtype=np.float64),
            np.array(invalid, dtype=np.int64),
        )

    def _find_longest_m(self, reading: Reading) -> float:
        plain = reading.ranges[(reading.ranges < self._range_max_m) & ~np.isin(reading.ranges, CODES_M)]
        return float(plain.max(initial=0.0))

    def _order(self, log: Log, scans: _Scans) -> _Scans:
        """Return the scans sorted by time; of scans with equal stamps the first is kept."""
        if not len(scans):
            raise self._no_scan_error(log)
        order = order_stamps(scans.stamps_ns)
        if len(order.keep) < 0.5 * len(scans):
            return self._order_by_lines(scans)
        self._counts |= {"scans out of order": order.backwards, reader_common.REPEATED_STAMPS: order.repeated}
        return scans[order.keep]

    def _order_by_lines(self, scans: _Scans) -> _Scans:
        """Return the scans one second apart in line order, for logs whose stamps are absent or have too few digits."""
        self._counts[UNUSABLE_STAMPS] = len(scans)
        return replace(scans, stamps_ns=np.arange(len(scans), dtype=np.int64) * 10**9)

    def _no_scan_error(self, log: Log) -> BadData:
        if log.damaged:
            line, what = log.damage
            more = f" (and {log.damaged - 1} more damaged lines)" if log.damaged > 1 else ""
            return BadData(str(self._path), f"line {line}", f"{what}{more}; no valid scan", "use another copy")
        return BadData(
            str(self._path),
            "",
            "no scan: no line begins with FLASER, ROBOTLASER1, RAWLASER1 or LASER3 to LASER5",
            "give a CARMEN log (plain or gzip)",
        )

    def _mark_ranges(self, ranges: Floats) -> Floats:
        """Return the ranges with inf for no return and nan for invalid ones."""
        beyond = (ranges >= self._range_max_m) | np.isin(ranges, self._codes)
        return np.where(beyond, np.inf, np.where(self._is_valid(ranges), ranges, np.nan))

    def _is_valid(self, ranges: Floats) -> Bools:
        return np.asarray((ranges > 0.0) & (ranges >= self._range_min_m))

    def _find_odometry(self, log: Log, scans: _Scans, wanted: str) -> Floats:
        """Return the odometry pose (N, 3) at each scan taken, nan where there is none."""
        if log.poses_from and wanted not in {"auto", "none"}:
            raise BadData(
                str(self._path),
                f"odometry '{wanted}'",
                f"the poses in this log are not odometry: {POSES_FROM[log.poses_from]}",
                "use odometry 'none' (or 'auto')",
            )
        timed = UNUSABLE_STAMPS not in self._counts
        if wanted == "odom-lines" and not (timed and len(log.odometry)):
            what = "no usable stamps" if len(log.odometry) else "no ODOM line"
            raise BadData(str(self._path), "odometry 'odom-lines'", what, "use 'scan-poses' or 'none'")
        source = _select_odometry(log, scans, timed) if wanted == "auto" else wanted
        if source == "odom-lines":
            return self._interpolate_lines(log)
        if source == "scan-poses":
            if not timed:
                return self._taken.robot
            poses, jumps = reader_common.join_jumps(self._taken.stamps_ns, self._taken.robot)
            self._counts |= jumps
            return poses
        return np.full((len(self), 3), np.nan)

    def _interpolate_lines(self, log: Log) -> Floats:
        stamps = log.odometry.stamps_ns
        order = order_stamps(stamps)
        poses, jumps = reader_common.join_jumps(stamps[order.keep], log.odometry.poses[order.keep])
        odometry = Trajectory(stamps[order.keep], poses, "odom", "base")
        self._counts |= {
            "odometry out of order": order.backwards,
            "odometry with a repeated stamp ignored": order.repeated,
            **jumps,
            **reader_common.count_odometry_gaps(odometry, self._taken.stamps_ns),
        }
        return reader_common.odometry_at(odometry, self._taken.stamps_ns)

    def _load_truth(self, log: Log, whole: _Scans, paths: TruthPaths) -> Truth:
        span = int(whole.stamps_ns[0]), int(whole.stamps_ns[-1])
        how = paths.how or _describe_truth(paths, log.poses_from)
        truth, counts = truth_files.load_truth(replace(paths, how=how), self._taken.stamps_ns, span)
        self._counts |= counts
        if truth.trajectory is not None or not log.poses_from:
            return truth
        return replace(truth, trajectory=Trajectory(self._taken.stamps_ns, self._taken.robot))


def _select_no_return_codes(scans: _Scans) -> Floats:
    """Return the ranges below ``range_max_m`` that mean no return in this log."""
    longest = float(scans.longest_m.max(initial=0.0))
    return np.array([*CODES_M, *(MILLIMETRE_CODES_M if longest in MILLIMETRE_CODES_M else ())])


def _select_odometry(log: Log, scans: _Scans, timed: bool) -> str:
    """Return the source of odometry for "auto"; ``timed``: whether the stamps of the scans are usable."""
    if log.poses_from:
        return "none"
    if timed and len(log.odometry):
        return "odom-lines"
    return "scan-poses" if (scans.robot != scans.robot[0]).any() else "none"


def _find_mounting(log: Log, scans: _Scans) -> Pose:
    """Return the laser's pose on the robot: from the two poses of each scan, else PARAM robot_frontlaser_offset."""
    mounting = np.median(between(scans.robot, scans.laser), axis=0)
    if np.abs(mounting).max() > 1e-4:
        return Pose.of(mounting.round(5))  # the log has six decimals, rotated by the heading
    try:
        return Pose(float(log.parameters.get("robot_frontlaser_offset", "0")))
    except ValueError:
        return Pose()


def _describe_truth(paths: TruthPaths, poses_from: str) -> str:
    """Return the origin of the truth in words."""
    parts = []
    if paths.relations:
        parts.append("relations between pairs of scans (Kuemmerle et al. 2009)")
    if paths.ground_truth:
        parts.append(f"true trajectory {Path(paths.ground_truth).name}")
    elif poses_from:
        parts.append(POSES_FROM[poses_from])
    if paths.spans:
        parts.append("distances measured with a tape")
    return "; ".join(parts) or "none"


SPEC = DatasetSpec(
    make=Carmen,
    summary="A CARMEN log (.log, .clf, also gzip) with FLASER, ROBOTLASER1, RAWLASER1 or LASER3 to LASER5 scans",
    sensor="as recorded; FLASER, LASER3: 180 or 181 beams 1 deg apart, 360 or 361 beams 0.5 deg apart, from -90 deg",
    truth="files given as parameters; the poses of a corrected log",
    citation="CARMEN, the Carnegie Mellon Robot Navigation Toolkit (Montemerlo, Roy, Thrun, IROS 2003)",
    licence="that of the recording",
    suffixes=(".log", ".clf", ".log.gz", ".clf.gz", ".gfs"),
    recognises=carmen_parser.is_carmen,
    parameters=(
        Parameter("path", "", "", "the log"),
        *truth_files.PARAMETERS,
        Parameter("odometry", "auto", "", "source of the wheel odometry",
                  choices=("auto", "odom-lines", "scan-poses", "none")),
        Parameter("range_max_m", 50.0, "m", "ranges of this length or more mean no return", low=0.1),
        RANGE_MIN,
        Parameter("base_from_sensor", "auto", "", "pose of the laser on the base: 'auto' or 'x y theta' in m, m, rad"),
        Parameter("start_deg", -90.0, "deg", "angle of the first beam of a FLASER line", low=-360.0, high=360.0),
        Parameter("step_deg", 0.0, "deg", "angle between its beams; 0: by their number", low=0.0, high=10.0),
        *reader_common.SELECTION,
    ),
    missing=partial(reader_common.describe_missing_files, "carmen"),
    choose=partial(reader_common.choose_parameters, "carmen"),
    thinned_by="every",
)  # fmt: skip
