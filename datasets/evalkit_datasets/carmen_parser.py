"""The lines of a CARMEN log (plain or gzip) as scans, odometry poses and parameters, one at a time.

FLASER, ROBOTLASER1, ODOM and PARAM of CARMEN; LASER_READING of GMapping's .gfs; NEFF and VERTEX only as signs of where
the poses in the file come from. Lines that cannot be read are set aside with a reason, never guessed at.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from evalkit.core.errors import BadData
from evalkit.core.se2 import Floats
from evalkit.io.text_lines import iter_lines
from evalkit.io.timestamps import parse_stamp_ns
from evalkit_datasets.buffers import PoseBuffer

STEP_DEG = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}
"""Degrees between beams by how many there are: a SICK LMS starting at -90 deg. A FLASER line does not say."""

Row = tuple[float, float, float]

Layout = tuple[float, float]
"""Start of FLASER angles and step between them (deg; 0: by the number of beams)."""


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """One laser line: ranges (B,) as written, angles (B,), the laser's and the robot's pose beside them."""

    stamp_ns: int
    ranges: Floats
    angles: Floats
    laser: Row
    robot: Row


@dataclass(eq=False)
class Log:
    """What a log holds beside its scans. ``poses_from``: "gmapping" or "graph" where the poses in it are
    corrected ones, "" where they are the wheels'; known when the last line is read.

    ``damaged``: how many lines were set aside; ``damage``: number of the first one and the reason.
    """

    layout: Layout = (-90.0, 0.0)
    odometry: PoseBuffer = field(default_factory=PoseBuffer)
    parameters: dict[str, str] = field(default_factory=dict)
    damaged: int = 0
    damage: tuple[int, str] = (0, "")
    rear: int = 0
    poses_from: str = ""


def readings(path: Path, log: Log) -> Iterator[tuple[int, Reading]]:
    """Number and scan of every laser line in the order of the file; all other lines go into the log meanwhile."""
    signs: set[bytes] = set()
    for number, line in enumerate(lines_of(path), start=1):
        words = line.split()
        if not words:
            continue
        if words[0] in _SIGNS:
            signs.add(words[0])
        try:
            if words[0] in _LASERS:
                yield number, _LASERS[words[0]](log.layout, words)
            elif words[0] in _LINES:
                _LINES[words[0]](log, words)
        except (ValueError, IndexError) as error:
            log.damage = log.damage if log.damaged else (number, str(error) or "too short")
            log.damaged += 1
        if words[0] == b"FLASER":
            signs |= {b"FLASER", *words[-2:-1]} & _SIGNED
    log.poses_from = _origin(signs)


def read(path: Path, layout: Layout = (-90.0, 0.0)) -> tuple[Log, list[Reading]]:
    """The log and all its scans at once."""
    log = Log(layout)
    return log, [reading for _, reading in readings(path, log)]


def readings_at(path: Path, layout: Layout, numbers: Iterable[int]) -> Iterator[Reading]:
    """The scans of lines that are known to hold one, by their numbers, which must rise."""
    wanted = iter(numbers)
    number = next(wanted, None)
    for at, line in enumerate(lines_of(path), start=1):
        if number is None:
            return
        if at == number:
            words = line.split()
            try:
                yield _LASERS[words[0]](layout, words)
            except (ValueError, IndexError, KeyError):
                raise _changed(path) from None
            number = next(wanted, None)
    if number is not None:
        raise _changed(path)


def lines_of(path: Path) -> Iterator[bytes]:
    """The lines of a log."""
    return iter_lines(path, "a CARMEN log")


def _changed(path: Path) -> BadData:
    return BadData(str(path), "", "the log has changed since it was first read", "leave it alone while it is in use")


def _origin(signs: set[bytes]) -> str:
    """Who made the poses. GMapping's gfs2log signs its logs "pippo" and adds a NEFF line per scan."""
    if signs & {b"VERTEX2", b"VERTEX_SE2"}:
        return "graph"
    return "gmapping" if b"FLASER" in signs and signs & {b"NEFF", b"pippo"} else ""


def _flaser(layout: Layout, words: list[bytes]) -> Reading:
    """``FLASER n r1..rn x y theta odom_x odom_y odom_theta ipc_t host logger_t``."""
    beams = _beams(words, 1, 11)
    tail = words[2 + beams :]
    angles = _angles(beams, *_by_beams(beams, layout))
    return Reading(_stamp(tail[6]), _floats(words[2 : 2 + beams]), angles, _row(tail[0:3]), _row(tail[3:6]))


def _robotlaser(_layout: Layout, words: list[bytes]) -> Reading:
    """``ROBOTLASER1 type start fov res max acc mode n r.. m [rem..] laser(3) robot(3) tv rv .. ipc_t host log_t``."""
    if len(words) < 10:
        raise ValueError(f"{len(words)} words, too few for a ROBOTLASER1 line")
    beams = int(words[8])
    remissions = int(words[9 + beams]) if 1 < beams < len(words) - 9 else -1
    if remissions < 0 or len(words) != 9 + beams + 1 + remissions + 14:
        raise ValueError(f"{beams} beams and {remissions} remissions announced, but {len(words)} words in the line")
    start, fov, step = (float(word) for word in words[2:5])
    step = step if step > 0.0 else fov / (beams - 1)
    if not (math.isfinite(start) and math.isfinite(step) and 0.0 < step * (beams - 1) < 2.0 * math.pi + 0.1):
        raise ValueError(f"start {start} and resolution {step} rad are no angles of a scan")
    angles = _angles(beams, start, step)
    poses = _row(words[-14:-11]), _row(words[-11:-8])
    return Reading(_stamp(words[-3]), _floats(words[9 : 9 + beams]), angles, *poses)


def _laser_reading(layout: Layout, words: list[bytes]) -> Reading:
    """``LASER_READING n r1..rn x y theta t`` of a .gfs file: its pose is raw odometry at the scan."""
    beams = _beams(words, 1, 6)
    angles = _angles(beams, *_by_beams(beams, layout))
    pose = _row(words[-4:-1])
    return Reading(_stamp(words[-1]), _floats(words[2 : 2 + beams]), angles, pose, pose)


def _odom(log: Log, words: list[bytes]) -> None:
    """``ODOM x y theta tv rv accel ipc_t host logger_t``.

    The five-word ODOM line of a .gfs file is passed over: it carries the pose of the previous reading.
    """
    if len(words) == 5:
        return
    if len(words) != 10:
        raise ValueError(f"{len(words)} words, an ODOM line has 10")
    log.odometry.append(_stamp(words[7]), _row(words[1:4]))


def _param(log: Log, words: list[bytes]) -> None:
    if len(words) >= 3:
        log.parameters[words[1].decode("latin-1")] = words[2].decode("latin-1")


def _rear(log: Log, _words: list[bytes]) -> None:
    log.rear += 1


_SIGNS = frozenset({b"NEFF", b"VERTEX2", b"VERTEX_SE2"})
_SIGNED = frozenset({b"FLASER", b"pippo"})  # a kind of line, and the host that GMapping writes into it

_LASERS: dict[bytes, Callable[[Layout, list[bytes]], Reading]] = {
    b"FLASER": _flaser,
    b"ROBOTLASER1": _robotlaser,
    b"LASER_READING": _laser_reading,
}

_LINES: dict[bytes, Callable[[Log, list[bytes]], None]] = {
    b"ODOM": _odom,
    b"PARAM": _param,
    b"RLASER": _rear,
}


def _beams(words: list[bytes], at: int, others: int) -> int:
    """The number of beams a line announces, checked against the words it has."""
    beams = int(words[at])
    if beams < 2 or len(words) != beams + others:
        raise ValueError(f"{beams} beams announced, but {len(words)} words in the line ({beams + others} expected)")
    return beams


def _by_beams(beams: int, layout: Layout) -> tuple[float, float]:
    """First angle and step (rad) of a line that does not say."""
    start_deg, step_deg = layout
    step = step_deg or STEP_DEG.get(beams, 0.0)
    if step <= 0.0:
        raise ValueError(f"{beams} beams: the angle between them is not known; give it as parameter 'step_deg'")
    return math.radians(start_deg), math.radians(step)


@lru_cache(maxsize=64)
def _angles(beams: int, start: float, step: float) -> Floats:
    angles = np.asarray(start + step * np.arange(beams), dtype=np.float64)
    angles.flags.writeable = False
    return angles


def _floats(words: list[bytes]) -> Floats:
    return np.array([float(word) for word in words])


def _row(words: list[bytes]) -> Row:
    x, y, theta = (float(word) for word in words)
    if not math.isfinite(x + y + theta):
        raise ValueError("a pose that is not finite")
    return x, y, theta


def _stamp(word: bytes) -> int:
    return parse_stamp_ns(word.decode("latin-1"))
