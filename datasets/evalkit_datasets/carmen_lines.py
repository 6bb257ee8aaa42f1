"""The lines of a CARMEN log (plain or gzip, told by content) as scans, odometry poses and parameters.

FLASER, ROBOTLASER1, ODOM and PARAM of CARMEN; LASER_READING of GMapping's .gfs; NEFF and VERTEX only as signs of where
the poses in the file come from. Lines that cannot be read are set aside with a reason, never guessed at.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from evalkit.content import bytes_of
from evalkit.errors import BadData
from evalkit.se2 import Floats
from evalkit_datasets.stamps import stamp_ns

STEP_DEG = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}
"""Degrees between beams by how many there are: a SICK LMS starting at -90 deg. A FLASER line does not say."""

Row = tuple[float, float, float]


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
    """A log in the order of its lines. ``poses_from``: "gmapping" or "graph" where the poses in it are
    corrected ones, "" where they are the wheels'. ``layout``: start and step of FLASER angles (deg).

    ``damaged``: line number and reason of each line set aside.
    """

    layout: tuple[float, float]
    readings: list[Reading] = field(default_factory=list)
    odometry: list[tuple[int, Row]] = field(default_factory=list)
    parameters: dict[str, str] = field(default_factory=dict)
    damaged: list[tuple[int, str]] = field(default_factory=list)
    rear: int = 0
    poses_from: str = ""


def read(path: Path, start_deg: float = -90.0, step_deg: float = 0.0) -> Log:
    """The log; ``start_deg`` and ``step_deg`` (0: by the number of beams) are the angles of FLASER lines."""
    log = Log((start_deg, step_deg))
    signs: set[bytes] = set()
    for number, line in enumerate(content_of(path).split(b"\n"), start=1):
        words = line.split()
        if not words:
            continue
        if words[0] in _SIGNS:
            signs.add(words[0])
        if (reader := _LINES.get(words[0])) is None:
            continue
        try:
            reader(log, words)
        except (ValueError, IndexError) as error:
            log.damaged.append((number, str(error) or "too short"))
        if words[0] == b"FLASER":
            signs |= {b"FLASER", *words[-2:-1]}
    log.poses_from = _origin(signs)
    return log


def content_of(path: Path) -> bytes:
    """The bytes of the log, unpacked where they are gzip."""
    content = bytes_of(path, "a CARMEN log")
    if not content.startswith(b"\x1f\x8b"):
        return content
    plain = b""
    while content.startswith(b"\x1f\x8b"):  # gzip files may be joined end to end
        unpacker = zlib.decompressobj(wbits=31)
        try:
            plain += unpacker.decompress(content)
        except zlib.error as error:
            raise BadData(str(path), "", f"damaged gzip ({error})", "fetch or copy the file again") from None
        if not unpacker.eof:
            raise BadData(str(path), "", "the gzip file is cut short", "fetch or copy the file again")
        content = unpacker.unused_data
    return plain


def _origin(signs: set[bytes]) -> str:
    """Who made the poses. GMapping's gfs2log signs its logs "pippo" and adds a NEFF line per scan."""
    if signs & {b"VERTEX2", b"VERTEX_SE2"}:
        return "graph"
    return "gmapping" if b"FLASER" in signs and signs & {b"NEFF", b"pippo"} else ""


def _flaser(log: Log, words: list[bytes]) -> None:
    """``FLASER n r1..rn x y theta odom_x odom_y odom_theta ipc_t host logger_t``."""
    beams = _beams(words, 1, 11)
    tail = words[2 + beams :]
    angles = _angles(beams, *_by_beams(beams, log.layout))
    log.readings.append(
        Reading(_stamp(tail[6]), _floats(words[2 : 2 + beams]), angles, _row(tail[0:3]), _row(tail[3:6]))
    )


def _robotlaser(log: Log, words: list[bytes]) -> None:
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
    log.readings.append(
        Reading(_stamp(words[-3]), _floats(words[9 : 9 + beams]), angles, _row(words[-14:-11]), _row(words[-11:-8]))
    )


def _laser_reading(log: Log, words: list[bytes]) -> None:
    """``LASER_READING n r1..rn x y theta t`` of a .gfs file: its pose is raw odometry at the scan."""
    beams = _beams(words, 1, 6)
    angles = _angles(beams, *_by_beams(beams, log.layout))
    pose = _row(words[-4:-1])
    log.readings.append(Reading(_stamp(words[-1]), _floats(words[2 : 2 + beams]), angles, pose, pose))


def _odom(log: Log, words: list[bytes]) -> None:
    """``ODOM x y theta tv rv accel ipc_t host logger_t``.

    The five-word ODOM line of a .gfs file is passed over: it carries the pose of the previous reading.
    """
    if len(words) == 5:
        return
    if len(words) != 10:
        raise ValueError(f"{len(words)} words, an ODOM line has 10")
    log.odometry.append((_stamp(words[7]), _row(words[1:4])))


def _param(log: Log, words: list[bytes]) -> None:
    if len(words) >= 3:
        log.parameters[words[1].decode("latin-1")] = words[2].decode("latin-1")


def _rear(log: Log, _words: list[bytes]) -> None:
    log.rear += 1


_SIGNS = frozenset({b"NEFF", b"VERTEX2", b"VERTEX_SE2"})

_LINES: dict[bytes, Callable[[Log, list[bytes]], None]] = {
    b"FLASER": _flaser,
    b"ROBOTLASER1": _robotlaser,
    b"LASER_READING": _laser_reading,
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


def _by_beams(beams: int, layout: tuple[float, float]) -> tuple[float, float]:
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
    return stamp_ns(word.decode("latin-1"))
