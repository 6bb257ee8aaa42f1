"""The reader of logs in columns, from the bytes of a log to the last frame, and the TOML that describes it."""

from __future__ import annotations

from pathlib import Path

from bounds import check_file_reader

from evalkit_datasets.readers.columns import Columns

LAYOUT = {
    "time": {"column": 3, "unit": "ms", "wraps_at": 65536},
    "scan": {"first": 4, "unit": "mm", "step_deg": 1.0, "clockwise": True, "no_return": [0], "range_max_m": 6.0},
    "ticks": {
        "left": 1,
        "right": 2,
        "ticks_per_turn": 333.0,
        "wheel_diameter_m": 0.06,
        "track_m": 0.2,
        "wraps_at": 65536,
    },
}
DESCRIBED = (
    b'header_lines = 1\ncomment = "%"\n[time]\ncolumn = 1\n[scan]\nfirst = 2\nbeams = 2\nstep_deg = 1\n'
    b'[pose]\nx = 4\ny = 5\nheading = 6\nheading_unit = "deg"\n'
)
LOG = b"t r0 r1 x y heading\n1.5 1.0 2.0 0 0 0\n2.5 1.0 nan 0 0 90\n"


def seeds() -> list[bytes]:
    """Return logs with a fixed layout, and layouts (which begin with an L) of a fixed log."""
    return [b"0 0 100 " + b"1000 " * 8 + b"\n5 5 300 " + b"0 " * 8 + b"\n", b"1,2;3\t4,5\n" * 3, b"L" + DESCRIBED]


def swollen() -> list[bytes]:
    """Return inputs of 100 kB and more whose cost could grow faster than their size."""
    return [b"0 0 1 " + b"1 " * 100_000, b"0 0 1 1 1\n" * 20_000, b"L" + b"time = {" + b"a.b." * 50_000, b"9" * 200_000]


def read_input(data: bytes) -> None:
    """Read a log and all of its frames, or a layout and a log with it."""
    check_file_reader(_read_described if data.startswith(b"L") else _read, data[data.startswith(b"L") :], "fuzz.txt")


def _read(path: Path) -> None:
    _read_all(Columns(str(path), LAYOUT))


def _read_described(path: Path) -> None:
    log = path.with_name("fuzz.txt.log")  # either file may be named in an error
    log.write_bytes(LOG)
    _read_all(Columns(str(log), str(path)))


def _read_all(sequence: Columns) -> None:
    for _ in sequence.frames():
        pass
    sequence.truth(), sequence.notes()
