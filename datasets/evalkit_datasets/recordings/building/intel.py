"""Build the recording of the Intel Research Lab from three published subsets of its scans and its raw odometry.

flirtlib's graph and a JSON file of GMapping readings contain exact stamps; their poses are not odometry and not used.
MRPT's rawlog contains every fifth scan and the odometry between them, with wrong stamps: a scan gets the time of the
row of the raw odometry with its pose. Where the robot stands, many rows have this pose, and the stamps are spread
evenly between the scans before and after.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from decimal import Decimal
from pathlib import Path

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.errors import BadData
from evalkit.core.se2 import Floats, Stamps
from evalkit.io.input_files import read_text
from evalkit.io.text_lines import iter_rows, parse_numbers
from evalkit.io.timestamps import format_stamp, parse_stamp_ns
from evalkit.io.untrusted_io import parse_json
from evalkit_datasets.recordings.building.log_lines import SourceScan, centimetres, format_scan, iter_log, source_scan
from evalkit_datasets.recordings.building.mrpt_rawlog import read_rawlog

OdometryRow = tuple[int, tuple[Decimal, Decimal, Decimal]]
"""The stamp of a row (ns), and its pose (m, m, rad)."""

ODOMETRY_LAYOUT = "t 0 0 0 x y theta"
HALF_TURN = Decimal("3.141592653589793238")

SAME_POSE = 1e-4
"""Two odometry poses closer than this (m, rad) are the same row: the sums of the increments are exact to 0.04 mm."""

AFTER_ROW_NS = 250_000
"""A scan is stamped 0.25 ms after the odometry row with its pose (median over the scans with exact stamps)."""

PERIOD_NS = 987_000_000
"""Time between two scans of the rawlog, for those before the first and after the last known one."""


def build_log(graph: Path, readings: Path, rawlog: Path, odometry: Path) -> Iterator[str]:
    """Yield the lines of the log in order of time: all rows of odometry, and the scans of the three sources."""
    rows, exact = read_odometry(odometry), read_exact(graph, readings)
    scans = dict(exact)
    for scan in stamp_rawlog(rawlog, rows, {scan.key: scan.stamp_ns for scan in exact.values()}):
        stamp = scan.stamp_ns
        while stamp in scans:  # two estimates may coincide
            stamp += 1000
        scans[stamp] = SourceScan(stamp, scan.ranges_cm)
    yield "# derived: built by evalkit from flirtlib's graph, GMapping readings, MRPT's rawlog and the raw odometry\n"
    yield f"# {len(exact)} of {len(scans)} stamps are exact, the others matched by odometry; no poses of scans\n"
    yield from _merge_lines(rows, scans)


def build_exact_log(graph: Path, readings: Path, odometry: Path) -> Iterator[str]:
    """Yield the lines of the log in order of time with the scans alone whose stamps are exact."""
    exact = read_exact(graph, readings)
    yield "# derived: built by evalkit from flirtlib's graph, GMapping readings and the raw odometry\n"
    yield f"# all {len(exact)} stamps are exact; no poses of scans\n"
    yield from _merge_lines(read_odometry(odometry), exact)


def read_exact(graph: Path, readings: Path) -> dict[int, SourceScan]:
    """Return the scans with exact stamps by these, of flirtlib's graph and of the GMapping readings."""
    exact = {scan.stamp_ns: scan for scan in read_readings(readings)}
    return exact | {reading.stamp_ns: source_scan(reading) for reading in iter_log(graph)}


def _merge_lines(rows: list[OdometryRow], scans: Mapping[int, SourceScan]) -> Iterator[str]:
    lines = [(stamp, 0, _format_odometry(stamp, row)) for stamp, row in rows]
    lines += [(stamp, 1, format_scan(scan)) for stamp, scan in scans.items()]
    return (line for *_, line in sorted(lines))


def read_odometry(path: Path) -> list[OdometryRow]:
    """Return the stamp and the pose (m, m, rad) of each row; its heading is counted clockwise from y, as of a compass.

    Decimals: the text of the log is the same on every machine.
    """
    rows = []
    for line, words in iter_rows(path, ODOMETRY_LAYOUT, f"raw odometry ({ODOMETRY_LAYOUT})"):
        if not np.isfinite(parse_numbers(path, line, words, ODOMETRY_LAYOUT)).all():
            raise BadData(str(path), f"line {line}", "a value is not finite", "fetch the file again")
        x, y, compass = map(Decimal, words[4:])
        yaw = HALF_TURN / 2 - compass
        turns = (yaw / (2 * HALF_TURN)).to_integral_value()
        rows.append((parse_stamp_ns(words[0]), (x, y, yaw - turns * 2 * HALF_TURN)))
    return sorted(rows)


def read_readings(path: Path) -> list[SourceScan]:
    """Return the scans of a JSON file ``{"map": {seconds: {"range": [m, ...], ...}}}``."""
    try:
        table = parse_json(read_text(path, "scans in JSON"))["map"]
        return [SourceScan(parse_stamp_ns(stamp), centimetres(one["range"])) for stamp, one in table.items()]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        what = f"not a table of scans ({type(error).__name__}: {str(error)[:80]})"
        raise BadData(str(path), "", what, "fetch the file again") from None


def stamp_rawlog(path: Path, rows: list[OdometryRow], exact_ns: Mapping[bytes, int]) -> list[SourceScan]:
    """Return the scans of a rawlog that are not among those with exact stamps (by their ranges), with their stamps."""
    ranges_m, motions = read_rawlog(path)
    scans = [centimetres(row) for row in ranges_m]
    poses = [np.array(rows[0][1], dtype=np.float64)]
    for motion in motions[:-1]:
        poses.append(se2.compose(poses[-1], motion))
    known = {k: exact_ns[scan.tobytes()] for k, scan in enumerate(scans) if scan.tobytes() in exact_ns}
    first, last = _find_rows(path, np.array(poses), np.array([pose for _, pose in rows], dtype=np.float64))
    times = np.array([stamp for stamp, _ in rows], dtype=np.int64) + AFTER_ROW_NS
    stamps = spread_stamps(times[first], times[last], known)
    return [SourceScan(int(stamps[k]), scan) for k, scan in enumerate(scans) if k not in known]


def spread_stamps(first_ns: Stamps, last_ns: Stamps, known_ns: Mapping[int, int]) -> Stamps:
    """Return a stamp (N,) for every scan between its first and last possible time (N,).

    A scan with a known stamp keeps it; one with a single possible time gets that; the others are spread evenly by
    their index between those before and after, and kept within their limits.
    """
    stamps = np.asarray(first_ns, dtype=np.int64).copy()
    for index, stamp in known_ns.items():
        stamps[index] = stamp
    is_fixed = first_ns == last_ns
    is_fixed[list(known_ns)] = True
    fixed = np.flatnonzero(is_fixed)
    for index in np.flatnonzero(~is_fixed).tolist():
        right = int(np.searchsorted(fixed, index))
        if 0 < right < len(fixed):
            before, after = int(fixed[right - 1]), int(fixed[right])
            guess = int(stamps[before]) + int(stamps[after] - stamps[before]) * (index - before) // (after - before)
        elif len(fixed):
            nearest = int(fixed[0] if right == 0 else fixed[-1])
            guess = int(stamps[nearest]) + (index - nearest) * PERIOD_NS
        else:
            guess = int(first_ns[0]) + index * PERIOD_NS
        stamps[index] = min(max(guess, int(first_ns[index])), int(last_ns[index]))
    return stamps


def _find_rows(path: Path, poses: Floats, rows: Floats) -> tuple[Ints, Ints]:
    """Return the first and the last row of the odometry with each pose (N,)."""
    from scipy.spatial import KDTree  # noqa: PLC0415 - heavy, and used for building only

    def flat(of: Floats) -> Floats:
        return np.column_stack([of[:, :2], np.cos(of[:, 2]), np.sin(of[:, 2])])

    found: Iterable[list[int]] = KDTree(flat(rows)).query_ball_point(flat(poses), SAME_POSE)  # type: ignore[assignment]
    found = list(found)
    for record, candidates in enumerate(found, start=1):
        if not candidates:
            what = "its pose is not in the raw odometry"
            raise BadData(str(path), f"record {record}", what, "give the rawlog and the odometry of the same recording")
    limits = np.array([(min(each), max(each)) for each in found], dtype=np.int64)
    return limits[:, 0], limits[:, 1]


def _format_odometry(stamp_ns: int, row: tuple[Decimal, Decimal, Decimal]) -> str:
    x, y, yaw = row
    stamp = format_stamp(stamp_ns)[:-3]
    return f"ODOM {x:.6f} {y:.6f} {yaw:.6f} 0 0 0 {stamp} built {stamp}\n"
