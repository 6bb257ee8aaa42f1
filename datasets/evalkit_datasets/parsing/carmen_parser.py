"""Parse a CARMEN log (plain or gzip) line by line into scans, odometry poses and parameters.

Supported lines: FLASER, ROBOTLASER1, ODOM and PARAM of CARMEN, LASER_READING of GMapping's .gfs. RAWLASER1 lines, which
contain no pose, are read where no other line has a scan: CARMEN repeats them with poses as one of the others. Where
these are missing too, the lines of one lidar are read in what CARMEN calls an old format: LASER3, else LASER4, else
LASER5. LASER without a number is no message of CARMEN: its fields and units are not known. NEFF and VERTEX lines only
show where the poses in the file come from. Lines that cannot be parsed are counted and skipped, never guessed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import islice
from pathlib import Path

import numpy as np

from evalkit.core.errors import BadData, DataMissing
from evalkit.core.se2 import Floats
from evalkit.io.text_lines import iter_lines, parse_columns
from evalkit.io.timestamps import parse_stamp_ns
from evalkit_datasets.parsing.buffers import PoseBuffer

STEP_DEG = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}
"""Degrees between beams by number of beams, for a SICK LMS: FLASER lines do not contain it."""

MAX_LINES_BEFORE = 2000
"""Lines of a log among which the first scan or pose is looked for: parameters and comments come before."""

PoseRow = tuple[float, float, float]

NO_POSE: PoseRow = (0.0, 0.0, 0.0)

Layout = tuple[float, float]
"""Angle of the first beam of a FLASER line and step between beams, in deg; step 0: by the number of beams."""

DEFAULT_LAYOUT: Layout = -90.0, 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """One laser line: ranges (B,) as written, angles (B,) in rad, poses of the laser and of the robot."""

    stamp_ns: int
    ranges: Floats
    angles: Floats
    laser: PoseRow
    robot: PoseRow


@dataclass(eq=False)
class Log:
    """Content of a log other than its scans; complete after the last line has been read.

    ``poses_from``: "gmapping" or "graph" if the poses in the log are corrected ones, "" if they are wheel odometry.
    ``raw``: the kind of lines with its scans if these lines have no poses, else "".
    ``damaged``: number of lines skipped; ``damage``: line number of the first one and the reason.
    """

    layout: Layout = DEFAULT_LAYOUT
    odometry: PoseBuffer = field(default_factory=PoseBuffer)
    parameters: dict[str, str] = field(default_factory=dict)
    damaged: int = 0
    damage: tuple[int, str] = (0, "")
    rear: int = 0
    poses_from: str = ""
    raw: str = ""


def iter_readings(path: Path, log: Log) -> Iterator[tuple[int, Reading]]:
    """Yield line number and scan of every laser line in file order; the other lines are added to ``log``."""
    markers: set[bytes] = set()
    raw = _find_raw_lines(path)
    log.raw = raw.decode()
    lasers = {raw: _RAW_LASERS[raw]} if raw else _LASERS
    for number, line in enumerate(iter_log_lines(path), start=1):
        words = line.split()
        if not words:
            continue
        if words[0] in _MARKERS:
            markers.add(words[0])
        try:
            if words[0] in lasers:
                yield number, lasers[words[0]](log.layout, words)
            elif words[0] in _LINES:
                _LINES[words[0]](log, words)
        except (ValueError, IndexError) as error:
            log.damage = log.damage if log.damaged else (number, str(error)[:160] or "too short")
            log.damaged += 1
        if words[0] == b"FLASER":
            markers |= {b"FLASER", *words[-2:-1]} & _FLASER_MARKERS
    log.poses_from = _find_pose_source(markers)


def iter_readings_at(path: Path, layout: Layout, numbers: Iterable[int]) -> Iterator[Reading]:
    """Yield the scans of laser lines with given, increasing line numbers; raises BadData if the log has changed."""
    wanted = iter(numbers)
    number = next(wanted, None)
    for at, line in enumerate(iter_log_lines(path), start=1):
        if number is None:
            return
        if at == number:
            words = line.split()
            try:
                yield _ALL_LASERS[words[0]](layout, words)
            except (ValueError, IndexError, KeyError):
                raise _changed_error(path) from None
            number = next(wanted, None)
    if number is not None:
        raise _changed_error(path)


def is_carmen(path: Path) -> bool:
    """Return whether one of the first lines of a file, plain or gzip, is a scan or an odometry pose of a CARMEN log."""
    try:
        return any(line.split(maxsplit=1)[:1] and line.split(maxsplit=1)[0] in _KNOWN_LINES
                   for line in islice(iter_log_lines(path), MAX_LINES_BEFORE))  # fmt: skip
    except (BadData, DataMissing):
        return False


def _find_raw_lines(path: Path) -> bytes:
    """Return the kind of lines without poses that are read, b"" where a line with a scan has poses."""
    found: set[bytes] = set()
    for line in iter_log_lines(path):
        kind = line.split(maxsplit=1)[:1]
        if kind and kind[0] in _LASERS:
            return b""
        found.update(_RAW_LASERS.keys() & kind)
    return next((kind for kind in _RAW_LASERS if kind in found), b"RAWLASER1")


def iter_log_lines(path: Path) -> Iterator[bytes]:
    """Yield the lines of a log."""
    return iter_lines(path, "a CARMEN log")


def _changed_error(path: Path) -> BadData:
    return BadData(str(path), "", "the log has changed since it was first read", "do not modify it during a run")


def _find_pose_source(markers: set[bytes]) -> str:
    """Return the program that computed the poses. GMapping's gfs2log writes host "pippo" and a NEFF line per scan."""
    if markers & {b"VERTEX2", b"VERTEX_SE2"}:
        return "graph"
    return "gmapping" if b"FLASER" in markers and markers & {b"NEFF", b"pippo"} else ""


def _parse_flaser(layout: Layout, words: list[bytes]) -> Reading:
    """``FLASER n r1..rn x y theta odom_x odom_y odom_theta ipc_t host logger_t``."""
    beams = _parse_beams(words, 11)
    tail = words[2 + beams :]
    angles = _make_angles(beams, *_layout_by_beams(beams, layout))
    return Reading(
        _parse_stamp(tail[6]), parse_columns(words, 2, 2 + beams), angles, _parse_row(tail[0:3]), _parse_row(tail[3:6])
    )


def _parse_robotlaser(_layout: Layout, words: list[bytes]) -> Reading:
    """``ROBOTLASER1 type start fov res max acc mode n r.. m [rem..] laser(3) robot(3) tv rv .. ipc_t host log_t``."""
    ranges, angles = _parse_stated_scan(words, 14)
    return Reading(_parse_stamp(words[-3]), ranges, angles, _parse_row(words[-14:-11]), _parse_row(words[-11:-8]))


def _parse_rawlaser(_layout: Layout, words: list[bytes]) -> Reading:
    """``RAWLASER1 type start fov res max acc mode n r.. m [rem..] ipc_t host log_t``."""
    return Reading(_parse_stamp(words[-3]), *_parse_stated_scan(words, 3), NO_POSE, NO_POSE)


def _parse_old_laser(layout: Layout, words: list[bytes]) -> Reading:
    """``LASER3 n r1..rn ipc_t host logger_t``, by the parser of CARMEN (readlog.c)."""
    beams = _parse_beams(words, 5)
    angles = _make_angles(beams, *_layout_by_beams(beams, layout))
    return Reading(_parse_stamp(words[-3]), parse_columns(words, 2, 2 + beams), angles, NO_POSE, NO_POSE)


def _parse_stated_scan(words: list[bytes], others: int) -> tuple[Floats, Floats]:
    """Return ranges and angles of a line that states its angles, with so many words behind the remissions."""
    if len(words) < 10:
        raise ValueError(f"{len(words)} words; too few for a {words[0].decode('latin-1')} line")
    beams = int(words[8])
    remissions = int(words[9 + beams]) if 1 < beams < len(words) - 9 else -1
    if remissions < 0 or len(words) != 9 + beams + 1 + remissions + others:
        raise ValueError(f"{beams} beams and {remissions} remissions declared, but {len(words)} words in the line")
    start, fov, step = (float(word) for word in words[2:5])
    step = step if step > 0.0 else fov / (beams - 1)
    if not (math.isfinite(start) and math.isfinite(step) and 0.0 < step * (beams - 1) < 2.0 * math.pi + 0.1):
        raise ValueError(f"start {start} and resolution {step} rad: not the angles of a scan")
    return parse_columns(words, 9, 9 + beams), _make_angles(beams, start, step)


def _parse_laser_reading(layout: Layout, words: list[bytes]) -> Reading:
    """``LASER_READING n r1..rn x y theta t`` of a .gfs file: its pose is raw odometry."""
    beams = _parse_beams(words, 6)
    angles = _make_angles(beams, *_layout_by_beams(beams, layout))
    pose = _parse_row(words[-4:-1])
    return Reading(_parse_stamp(words[-1]), parse_columns(words, 2, 2 + beams), angles, pose, pose)


def _add_odom(log: Log, words: list[bytes]) -> None:
    """``ODOM x y theta tv rv accel ipc_t host logger_t``.

    The five-word ODOM line of a .gfs file is ignored: it contains the pose of the previous reading.
    """
    if len(words) == 5:
        return
    if len(words) != 10:
        raise ValueError(f"{len(words)} words; an ODOM line has 10")
    log.odometry.append(_parse_stamp(words[7]), _parse_row(words[1:4]))


def _add_param(log: Log, words: list[bytes]) -> None:
    if len(words) >= 3:
        log.parameters[words[1].decode("latin-1")] = words[2].decode("latin-1")


def _count_rear(log: Log, _words: list[bytes]) -> None:
    log.rear += 1


_MARKERS = frozenset({b"NEFF", b"VERTEX2", b"VERTEX_SE2"})
_FLASER_MARKERS = frozenset({b"FLASER", b"pippo"})  # a type of line, and the host that GMapping writes

_LASERS: dict[bytes, Callable[[Layout, list[bytes]], Reading]] = {
    b"FLASER": _parse_flaser,
    b"ROBOTLASER1": _parse_robotlaser,
    b"LASER_READING": _parse_laser_reading,
}

_RAW_LASERS: dict[bytes, Callable[[Layout, list[bytes]], Reading]] = {
    b"RAWLASER1": _parse_rawlaser,
    b"LASER3": _parse_old_laser,
    b"LASER4": _parse_old_laser,
    b"LASER5": _parse_old_laser,
}
"""The first kind that a log has is read: others are of other lidars."""

_ALL_LASERS = _LASERS | _RAW_LASERS

_LINES: dict[bytes, Callable[[Log, list[bytes]], None]] = {
    b"ODOM": _add_odom,
    b"PARAM": _add_param,
    b"RLASER": _count_rear,
}


_KNOWN_LINES = frozenset({*_ALL_LASERS, b"ODOM"})


def _parse_beams(words: list[bytes], others: int) -> int:
    """Return the number of beams of a line, checked against its number of words."""
    beams = int(words[1])
    if beams < 2 or len(words) != beams + others:
        raise ValueError(f"{beams} beams declared, but {len(words)} words in the line ({beams + others} expected)")
    return beams


def _layout_by_beams(beams: int, layout: Layout) -> tuple[float, float]:
    """Return first angle and step (rad) of a line that does not contain them."""
    start_deg, step_deg = layout
    step = step_deg or STEP_DEG.get(beams, 0.0)
    if step <= 0.0:
        raise ValueError(f"{beams} beams: unknown angle between beams; set parameter 'step_deg'")
    return math.radians(start_deg), math.radians(step)


@lru_cache(maxsize=64)
def _make_angles(beams: int, start: float, step: float) -> Floats:
    angles = np.asarray(start + step * np.arange(beams), dtype=np.float64)
    angles.flags.writeable = False
    return angles


def _parse_row(words: list[bytes]) -> PoseRow:
    x, y, theta = (float(word) for word in words)
    if not math.isfinite(x + y + theta):
        raise ValueError("the pose is not finite")
    return x, y, theta


def _parse_stamp(word: bytes) -> int:
    return parse_stamp_ns(word.decode("latin-1"))
