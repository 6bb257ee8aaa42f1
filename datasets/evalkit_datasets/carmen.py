"""A CARMEN log as a Sequence: scans in order of time, odometry at each scan, and the truth that belongs to it."""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.errors import BadData
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.core.se2 import Floats, Stamps, between
from evalkit.core.trajectory import Trajectory
from evalkit.io.timestamps import order_stamps
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import DatasetSpec
from evalkit_datasets import carmen_parser, reader_common
from evalkit_datasets.buffers import sort_by_rank
from evalkit_datasets.carmen_parser import Log, Reading

CODES_M = (32.767,)
"""Ranges that mean no return wherever they occur, below every sensible ``range_max_m``."""

MILLIMETRE_CODES_M = (8.18, 8.183, 8.187, 8.19, 8.191)
"""What a SICK LMS in millimetre mode sends for no return; plain ranges in a log that holds longer ones."""

POSES_FROM = {
    "gmapping": "GMapping's poses as the log holds them (particle filter; about 6 cm against relations)",
    "graph": "graph-optimised poses as the log holds them (about 3 to 4 cm against relations)",
}


@dataclass(frozen=True, slots=True, eq=False)
class _Scans:
    """What is known of scans without their ranges: time, line, and the laser's and the robot's pose (N, 3) beside each.

    ``longest_m`` (N,): the longest range that is certainly one. ``invalid`` (N,): how many are zero, negative or nan.
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

    Ranges: ``range_max_m`` and beyond, 32.767 m, and 8.18 to 8.191 m where the log's longest, are no returns; zero,
    negative or nan are invalid. Odometry "auto": the ODOM lines, else the robot pose beside each scan, else none;
    a corrected log (GMapping's, or one with graph vertices) has none, its poses become the reference.
    """

    def __init__(
        self,
        path: str,
        relations: str = "",
        reference: str = "",
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
    ) -> None:
        self._path = reader_common.existing("carmen", path)
        self._range_max_m = range_max_m
        self._layout = start_deg, step_deg
        log = Log(self._layout)
        found = self._found(log)
        self._counts = {"damaged lines left out": log.damaged, "rear-laser lines left out": log.rear}
        whole = self._in_order(log, found)
        self._taken = whole[reader_common.selection(start, every, limit)]
        if not len(self._taken):
            raise BadData(str(path), "", f"start {start} lies beyond its {len(whole)} scans", "start earlier")
        self._base_from_sensor = (
            _mounting(log, found)
            if base_from_sensor == "auto"
            else reader_common.sensor_pose("carmen", base_from_sensor)
        )
        self._codes = _no_return_codes(whole)
        self._odometry = self._odometry_at_scans(log, found, odometry)
        self._truth = self._known(log, whole, relations, reference, spans, how)
        self._counts["invalid ranges"] = int(self._taken.invalid.sum())

    def __len__(self) -> int:
        return len(self._taken)

    def frames(self) -> Iterator[Frame]:
        """The scans in order of time, read from the log as they are asked for."""
        ranks = np.argsort(self._taken.lines)
        lines = carmen_parser.readings_at(self._path, self._layout, self._taken.lines[ranks])
        readings = sort_by_rank(zip(ranks.tolist(), lines, strict=True))
        for stamp, reading, row in zip(self._taken.stamps_ns, readings, self._odometry, strict=True):
            scan = Scan(int(stamp), self._clean(reading.ranges), reading.angles, 0.0, self._range_max_m)
            yield Frame(scan, self._base_from_sensor, reader_common.pose_or_none(row))

    def truth(self) -> Truth:
        """Relations and reference trajectory of the files given; the log's own poses where they are corrected ones."""
        return self._truth

    def notes(self) -> Mapping[str, int]:
        """Defects met and handled, counted by name."""
        return reader_common.counted(self._counts)

    def _found(self, log: Log) -> _Scans:
        """All scans in the order of the file; the other lines go into the log."""
        stamps, lines, invalid = array("q"), array("q"), array("q")
        laser, robot, longest = array("d"), array("d"), array("d")
        for number, reading in carmen_parser.readings(self._path, log):
            stamps.append(reading.stamp_ns)
            lines.append(number)
            laser.extend(reading.laser)
            robot.extend(reading.robot)
            longest.append(self._longest_m(reading))
            invalid.append(int(np.count_nonzero(~(reading.ranges > 0.0))))
        return _Scans(
            np.array(stamps, dtype=np.int64),
            np.array(lines, dtype=np.int64),
            np.array(laser, dtype=np.float64).reshape(-1, 3),
            np.array(robot, dtype=np.float64).reshape(-1, 3),
            np.array(longest, dtype=np.float64),
            np.array(invalid, dtype=np.int64),
        )

    def _longest_m(self, reading: Reading) -> float:
        plain = reading.ranges[(reading.ranges < self._range_max_m) & ~np.isin(reading.ranges, CODES_M)]
        return float(plain.max(initial=0.0))

    def _in_order(self, log: Log, found: _Scans) -> _Scans:
        """All scans sorted by time, the first of equal times kept."""
        if not len(found):
            raise self._no_scan(log)
        order = order_stamps(found.stamps_ns)
        if len(order.keep) < 0.5 * len(found):
            return self._by_order_of_lines(log, found, len(order.keep))
        self._counts |= {"scans out of order": order.backwards, "scans with a repeated stamp left out": order.repeated}
        return found[order.keep]

    def _by_order_of_lines(self, log: Log, found: _Scans, distinct: int) -> _Scans:
        """Scans one second apart, for corrected logs: they print six digits of their stamps, some nothing usable."""
        if not log.poses_from:
            raise BadData(
                str(self._path),
                "",
                f"{len(found)} scans share {distinct} stamps",
                "the ipc_timestamp (third word from the end) must tell the scans apart; take the original log",
            )
        self._counts["scans with unusable stamps, put one second apart in the order of the lines"] = len(found)
        return replace(found, stamps_ns=np.arange(len(found), dtype=np.int64) * 10**9)

    def _no_scan(self, log: Log) -> BadData:
        if log.damaged:
            line, what = log.damage
            more = f" (and {log.damaged - 1} more damaged lines)" if log.damaged > 1 else ""
            return BadData(str(self._path), f"line {line}", f"{what}{more}; no scan is left", "take another copy")
        return BadData(
            str(self._path),
            "",
            "no line begins with FLASER or ROBOTLASER1, so there is no scan in it",
            "give a CARMEN log (plain or gzip)",
        )

    def _clean(self, ranges: Floats) -> Floats:
        """The ranges with inf for no return and nan for invalid."""
        beyond = (ranges >= self._range_max_m) | np.isin(ranges, self._codes)
        return np.where(beyond, np.inf, np.where(ranges > 0.0, ranges, np.nan))

    def _odometry_at_scans(self, log: Log, found: _Scans, wanted: str) -> Floats:
        """The odometry's pose at each scan taken (N, 3), nan where there is none."""
        if log.poses_from and wanted not in {"auto", "none"}:
            raise BadData(
                str(self._path),
                f"odometry '{wanted}'",
                f"the poses in this log are no odometry: {POSES_FROM[log.poses_from]}",
                "use odometry 'none' (or 'auto')",
            )
        if wanted == "odom-lines" and not len(log.odometry):
            raise BadData(str(self._path), "odometry 'odom-lines'", "no ODOM line", "use 'scan-poses' or 'none'")
        source = _best_source(log, found) if wanted == "auto" else wanted
        if source == "odom-lines":
            return self._from_lines(log)
        if source == "scan-poses":
            return self._taken.robot
        return np.full((len(self), 3), np.nan)

    def _from_lines(self, log: Log) -> Floats:
        stamps = log.odometry.stamps_ns
        order = order_stamps(stamps)
        odometry = Trajectory(stamps[order.keep], log.odometry.poses[order.keep], "odom", "base")
        self._counts |= {
            "odometry out of order": order.backwards,
            "odometry with a repeated stamp left out": order.repeated,
            **reader_common.odometry_counts(odometry, self._taken.stamps_ns),
        }
        return reader_common.odometry_at(odometry, self._taken.stamps_ns)

    def _known(self, log: Log, whole: _Scans, relations: str, reference: str, spans: str, how: str) -> Truth:
        span = int(whole.stamps_ns[0]), int(whole.stamps_ns[-1])
        how = how or _how(relations, reference, spans, log.poses_from)
        truth, counts = reader_common.truth_from_files(self._taken.stamps_ns, span, relations, reference, how, spans)
        self._counts |= counts
        if truth.trajectory is not None or not log.poses_from:
            return truth
        poses = Trajectory(self._taken.stamps_ns, self._taken.robot)
        return Truth(how, poses, truth.relations, spans=truth.spans)


def _no_return_codes(scans: _Scans) -> Floats:
    """The ranges that mean no return in this log, below ``range_max_m``."""
    longest = float(scans.longest_m.max(initial=0.0))
    return np.array([*CODES_M, *(MILLIMETRE_CODES_M if longest in MILLIMETRE_CODES_M else ())])


def _best_source(log: Log, found: _Scans) -> str:
    """Where odometry comes from if nobody says."""
    if log.poses_from:
        return "none"
    if len(log.odometry):
        return "odom-lines"
    return "scan-poses" if (found.robot != found.robot[0]).any() else "none"


def _mounting(log: Log, found: _Scans) -> Pose:
    """Where the laser sits on the robot: by the two poses of each scan, else by PARAM robot_frontlaser_offset."""
    mounting = np.median(between(found.robot, found.laser), axis=0)
    if np.abs(mounting).max() > 1e-4:
        return Pose.of(mounting.round(5))  # six decimals in the log, turned by the heading
    try:
        return Pose(float(log.parameters.get("robot_frontlaser_offset", "0")))
    except ValueError:
        return Pose()


def _how(relations: str, reference: str, spans: str, poses_from: str) -> str:
    """What the truth is made of, in words."""
    parts = []
    if relations:
        parts.append("relations between pairs of scans (Kuemmerle et al. 2009)")
    if reference:
        parts.append(f"reference trajectory {Path(reference).name}")
    elif poses_from:
        parts.append(POSES_FROM[poses_from])
    if spans:
        parts.append("distances measured with a tape")
    return "; ".join(parts) or "none"


def _missing(path: str = "", **given: object) -> str:
    return reader_common.missing_files("carmen", [("path", path), *reader_common.truth_files(given)])


SPEC = DatasetSpec(
    make=Carmen,
    summary="A CARMEN log (.log, .clf, also gzip) with FLASER or ROBOTLASER1 scans",
    sensor="as recorded; FLASER lines: 180 or 181 beams 1 deg apart, 360 or 361 beams 0.5 deg apart, from -90 deg",
    truth="relations and a reference trajectory where files are given; the log's own poses where they are corrected",
    citation="CARMEN, the Carnegie Mellon Robot Navigation Toolkit (Montemerlo, Roy, Thrun, IROS 2003)",
    licence="as the recording's",
    suffixes=(".log", ".clf", ".log.gz", ".clf.gz", ".gfs"),
    parameters=(
        Parameter("path", "", "", "the log"),
        *reader_common.TRUTH,
        Parameter("odometry", "auto", "", "what serves as wheel odometry",
                  choices=("auto", "odom-lines", "scan-poses", "none")),
        Parameter("range_max_m", 50.0, "m", "this range and longer means no return", low=0.1),
        Parameter("base_from_sensor", "auto", "", "where the laser sits: 'auto' or 'x y theta' in m, m, rad"),
        Parameter("start_deg", -90.0, "deg", "angle of the first beam of a FLASER line", low=-360.0, high=360.0),
        Parameter("step_deg", 0.0, "deg", "angle between its beams; 0: by their number", low=0.0, high=10.0),
        *reader_common.SELECTION,
    ),
    missing=_missing,
    thinned_by="every",
)  # fmt: skip
