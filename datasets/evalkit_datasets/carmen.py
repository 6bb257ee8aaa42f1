"""A CARMEN log as a Sequence: scans in order of time, odometry at each scan, and the truth that belongs to it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from evalkit.errors import BadData
from evalkit.protocols import DatasetSpec, Parameter
from evalkit.se2 import Floats, Stamps, between
from evalkit.types import Frame, Pose, Scan, Trajectory, Truth
from evalkit_datasets import carmen_lines, recording
from evalkit_datasets.carmen_lines import Log, Reading
from evalkit_datasets.stamps import ordered

CODES_M = (32.767,)
"""Ranges that mean no return wherever they occur, below every sensible ``range_max_m``."""

MILLIMETRE_CODES_M = (8.18, 8.183, 8.187, 8.19, 8.191)
"""What a SICK LMS in millimetre mode sends for no return; plain ranges in a log that holds longer ones."""

POSES_FROM = {
    "gmapping": "GMapping's poses as the log holds them (particle filter; about 6 cm against relations)",
    "graph": "graph-optimised poses as the log holds them (about 3 to 4 cm against relations)",
}


@dataclass(frozen=True, slots=True, eq=False)
class _Taken:
    """The scans taken, in order of time, with their stamps (N,)."""

    stamps_ns: Stamps
    readings: list[Reading]


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
        self._path = recording.existing("carmen", path)
        self._range_max_m = range_max_m
        log = carmen_lines.read(self._path, start_deg, step_deg)
        self._counts = {"damaged lines left out": len(log.damaged), "rear-laser lines left out": log.rear}
        whole = self._in_order(log)
        chosen = recording.selection(start, every, limit)
        self._taken = _Taken(whole.stamps_ns[chosen], whole.readings[chosen])
        if not self._taken.readings:
            raise BadData(str(path), "", f"start {start} lies beyond its {len(whole.readings)} scans", "start earlier")
        self._base_from_sensor = (
            _mounting(log) if base_from_sensor == "auto" else recording.sensor_pose("carmen", base_from_sensor)
        )
        self._codes = self._no_return_codes(whole)
        self._odometry = self._odometry_at_scans(log, odometry)
        self._truth = self._known(log, whole, relations, reference, spans, how)
        self._count_ranges()

    def __len__(self) -> int:
        return len(self._taken.readings)

    def frames(self) -> Iterator[Frame]:
        """The scans in order of time."""
        for stamp, reading, row in zip(self._taken.stamps_ns, self._taken.readings, self._odometry, strict=True):
            scan = Scan(int(stamp), self._clean(reading.ranges), reading.angles, 0.0, self._range_max_m)
            yield Frame(scan, self._base_from_sensor, recording.pose_or_none(row))

    def truth(self) -> Truth:
        """Relations and reference trajectory of the files given; the log's own poses where they are corrected ones."""
        return self._truth

    def notes(self) -> Mapping[str, int]:
        """Defects met and handled, counted by name."""
        return recording.counted(self._counts)

    def _in_order(self, log: Log) -> _Taken:
        """All scans sorted by time, the first of equal times kept."""
        if not log.readings:
            raise self._no_scan(log)
        stamps = np.array([reading.stamp_ns for reading in log.readings], dtype=np.int64)
        keep, backwards, repeated = ordered(stamps)
        if len(keep) < 0.5 * len(stamps):
            return self._by_order_of_lines(log, len(keep))
        self._counts |= {"scans out of order": backwards, "scans with a repeated stamp left out": repeated}
        return _Taken(stamps[keep], [log.readings[index] for index in keep])

    def _by_order_of_lines(self, log: Log, distinct: int) -> _Taken:
        """Scans one second apart, for corrected logs: they print six digits of their stamps, some nothing usable."""
        if not log.poses_from:
            raise BadData(
                str(self._path),
                "",
                f"{len(log.readings)} scans share {distinct} stamps",
                "the ipc_timestamp (third word from the end) must tell the scans apart; take the original log",
            )
        self._counts["scans with unusable stamps, put one second apart in the order of the lines"] = len(log.readings)
        return _Taken(np.arange(len(log.readings), dtype=np.int64) * 10**9, log.readings)

    def _no_scan(self, log: Log) -> BadData:
        if log.damaged:
            line, what = log.damaged[0]
            more = f" (and {len(log.damaged) - 1} more damaged lines)" if len(log.damaged) > 1 else ""
            return BadData(str(self._path), f"line {line}", f"{what}{more}; no scan is left", "take another copy")
        return BadData(
            str(self._path),
            "",
            "no line begins with FLASER or ROBOTLASER1, so there is no scan in it",
            "give a CARMEN log (plain or gzip)",
        )

    def _no_return_codes(self, whole: _Taken) -> Floats:
        """The ranges that mean no return in this log, below ``range_max_m``."""
        longest = 0.0
        for reading in whole.readings:
            plain = reading.ranges[(reading.ranges < self._range_max_m) & ~np.isin(reading.ranges, CODES_M)]
            longest = max(longest, float(plain.max(initial=0.0)))
        return np.array([*CODES_M, *(MILLIMETRE_CODES_M if longest in MILLIMETRE_CODES_M else ())])

    def _clean(self, ranges: Floats) -> Floats:
        """The ranges with inf for no return and nan for invalid."""
        beyond = (ranges >= self._range_max_m) | np.isin(ranges, self._codes)
        return np.where(beyond, np.inf, np.where(ranges > 0.0, ranges, np.nan))

    def _count_ranges(self) -> None:
        ranges = [reading.ranges for reading in self._taken.readings]
        self._counts["invalid ranges"] = sum(int(np.count_nonzero(~(row > 0.0))) for row in ranges)

    def _odometry_at_scans(self, log: Log, wanted: str) -> Floats:
        """The odometry's pose at each scan taken (N, 3), nan where there is none."""
        if log.poses_from and wanted not in {"auto", "none"}:
            raise BadData(
                str(self._path),
                f"odometry '{wanted}'",
                f"the poses in this log are no odometry: {POSES_FROM[log.poses_from]}",
                "use odometry 'none' (or 'auto')",
            )
        if wanted == "odom-lines" and not log.odometry:
            raise BadData(str(self._path), "odometry 'odom-lines'", "no ODOM line", "use 'scan-poses' or 'none'")
        source = _best_source(log) if wanted == "auto" else wanted
        if source == "odom-lines":
            return self._from_lines(log)
        if source == "scan-poses":
            return np.array([reading.robot for reading in self._taken.readings])
        return np.full((len(self), 3), np.nan)

    def _from_lines(self, log: Log) -> Floats:
        stamps = np.array([stamp for stamp, _ in log.odometry], dtype=np.int64)
        keep, backwards, repeated = ordered(stamps)
        rows = np.array([row for _, row in log.odometry])[keep]
        odometry = Trajectory(stamps[keep], rows, "odom", "base")
        self._counts |= {
            "odometry out of order": backwards,
            "odometry with a repeated stamp left out": repeated,
            **recording.odometry_counts(odometry, self._taken.stamps_ns),
        }
        return recording.odometry_at(odometry, self._taken.stamps_ns)

    def _known(self, log: Log, whole: _Taken, relations: str, reference: str, spans: str, how: str) -> Truth:
        span = int(whole.stamps_ns[0]), int(whole.stamps_ns[-1])
        how = how or _how(relations, reference, spans, log.poses_from)
        truth, counts = recording.truth_from_files(self._taken.stamps_ns, span, relations, reference, how, spans)
        self._counts |= counts
        if truth.trajectory is not None or not log.poses_from:
            return truth
        poses = np.array([reading.robot for reading in self._taken.readings])
        return Truth(how, Trajectory(self._taken.stamps_ns, poses), truth.relations, spans=truth.spans)


def _best_source(log: Log) -> str:
    """Where odometry comes from if nobody says."""
    if log.poses_from:
        return "none"
    if log.odometry:
        return "odom-lines"
    return "scan-poses" if len({reading.robot for reading in log.readings}) > 1 else "none"


def _mounting(log: Log) -> Pose:
    """Where the laser sits on the robot: by the two poses of each scan, else by PARAM robot_frontlaser_offset."""
    robot = np.array([reading.robot for reading in log.readings])
    laser = np.array([reading.laser for reading in log.readings])
    mounting = np.median(between(robot, laser), axis=0)
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
    return recording.missing_files("carmen", [("path", path), *recording.truth_files(given)])


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
        *recording.TRUTH,
        Parameter("odometry", "auto", "", "what serves as wheel odometry",
                  choices=("auto", "odom-lines", "scan-poses", "none")),
        Parameter("range_max_m", 50.0, "m", "this range and longer means no return", low=0.1),
        Parameter("base_from_sensor", "auto", "", "where the laser sits: 'auto' or 'x y theta' in m, m, rad"),
        Parameter("start_deg", -90.0, "deg", "angle of the first beam of a FLASER line", low=-360.0, high=360.0),
        Parameter("step_deg", 0.0, "deg", "angle between its beams; 0: by their number", low=0.0, high=10.0),
        *recording.SELECTION,
    ),
    missing=_missing,
    thinned_by="every",
)  # fmt: skip
