"""The description of a text log in columns: a small TOML file that says what the columns mean."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from evalkit.core.errors import BadData, brief
from evalkit.core.se2 import Floats
from evalkit.io.input_files import read_text
from evalkit.io.toml import parse_toml

EXPECTED = "a TOML file with the tables [time], [scan] and, where there is odometry, [pose] or [ticks]"

TIME_DIGITS = {"s": 0, "ms": 3, "us": 6, "ns": 9}
"""Decimal digits of a second that are whole units."""

LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
ANGLE_UNITS = {"rad": 1.0, "deg": math.pi / 180.0}

MAX_COLUMNS = 100_000

_SEPARATORS = bytes.maketrans(b",;\t", b"   ")
MIN_DECIMALS = 3
"""Fewer numbers with a comma in a line may as well be separated by it."""

_DECIMAL_COMMA = re.compile(rb"[-+]?\d+,\d+([eE][-+]?\d+)?")
DECIMAL_COMMA = "its numbers have a decimal comma", "write them with a point: sed 's/,/./g' {file}"
"""What is wrong with such a log, and what to do with the ``file``."""

_EMPTY = re.compile(rb"(^|[,;])(?=[ \t]*[,;])")


@dataclass(frozen=True)
class TimeColumn:
    """Column of the time of the first beam (from 1). ``wraps_at``: range of the clock in its unit, 0: none."""

    column: int
    unit: Literal["s", "ms", "us", "ns"] = "s"
    wraps_at: int = 0


@dataclass(frozen=True)
class ScanColumns:
    """Columns of the ranges: ``beams`` of them from column ``first`` on (from 1), or all up to the end of a line if 0.

    The first beam points to ``first_angle_deg`` in the lidar's frame (x forward, counter-clockwise), the others follow
    ``step_deg`` apart, in the other direction if ``clockwise``. ``no_return``: values, in the unit of the ranges, that
    mean no return. ``turned_s``: the time from the first beam to the last.
    """

    first: int
    step_deg: float
    beams: int = 0
    unit: Literal["m", "cm", "mm"] = "m"
    first_angle_deg: float = 0.0
    clockwise: bool = False
    no_return: tuple[float, ...] = ()
    range_min_m: float = 0.0
    range_max_m: float = 100.0
    turned_s: float = 0.0

    def angles(self, beams: int) -> Floats:
        """Return the angles (B,) of the beams in the lidar's frame (rad), counter-clockwise."""
        step = -self.step_deg if self.clockwise else self.step_deg
        return np.asarray(np.radians(self.first_angle_deg + step * np.arange(beams)), dtype=np.float64)


@dataclass(frozen=True)
class PoseColumns:
    """Columns of the odometry pose ``odom_from_base`` (from 1); x forward, y left, heading counter-clockwise."""

    x: int
    y: int
    heading: int
    unit: Literal["m", "cm", "mm"] = "m"
    heading_unit: Literal["rad", "deg"] = "rad"


@dataclass(frozen=True)
class TickColumns:
    """Columns of the counts of two wheels (from 1), and the geometry of a differential drive.

    ``wraps_at``: range of a counter, 65536 for 16 bits; 0: it does not wrap. ``turn_factor``: true rotation divided by
    the one computed from the track: less than 1 for wheels that slip sideways in turns.
    """

    left: int
    right: int
    ticks_per_turn: float
    wheel_diameter_m: float
    track_m: float
    wraps_at: int = 0
    turn_factor: float = 1.0


@dataclass(frozen=True)
class ColumnsLayout:
    """The meaning of the columns. Separators are blanks, tabs, commas and semicolons; ``header_lines`` are skipped.

    ``base_from_sensor``: pose of the lidar on the base (m, m, deg).
    """

    time: TimeColumn
    scan: ScanColumns
    pose: PoseColumns | None = None
    ticks: TickColumns | None = None
    header_lines: int = 0
    comment: str = "#"
    base_from_sensor: tuple[float, ...] = field(default=(0.0, 0.0, 0.0))

    def __post_init__(self) -> None:
        if self.pose is not None and self.ticks is not None:
            raise ValueError("pose, ticks: give one of them")
        if len(self.base_from_sensor) != 3:
            raise ValueError("base_from_sensor: expected [x, y, heading] in m, m, deg")
        if self.scan.beams == 1 or not self.scan.range_min_m < self.scan.range_max_m:
            raise ValueError("scan: expected two beams or more, and range_min_m less than range_max_m")

    @property
    def odometry_columns(self) -> tuple[int, ...]:
        """Columns of the odometry, counted from 0; () without odometry."""
        if self.pose is not None:
            return self.pose.x - 1, self.pose.y - 1, self.pose.heading - 1
        return (self.ticks.left - 1, self.ticks.right - 1) if self.ticks is not None else ()

    @property
    def min_columns(self) -> int:
        """Smallest number of columns of a line."""
        odometry = max(self.odometry_columns, default=0) + 1
        return max(self.time.column, self.scan.first - 1 + max(self.scan.beams, 2), odometry)


def split_columns(line: bytes) -> list[bytes]:
    """Return the columns of a line: separated by commas, semicolons, tabs or blanks.

    One that is empty, before or between commas or semicolons, is "nan"; several tabs or blanks separate two columns.

    >>> split_columns(b"1.5; 2,,3")
    [b'1.5', b'2', b'nan', b'3']
    """
    return _EMPTY.sub(rb"\1nan", line).translate(_SEPARATORS).split()


def has_decimal_comma(line: bytes) -> bool:
    """Return whether numbers of a line, between semicolons or tabs, have a decimal comma: all that have a comma.

    >>> has_decimal_comma(b"12;0,5;-3,25;4,0"), has_decimal_comma(b"12;0,5,7,-3;25"), has_decimal_comma(b"12;0.5,7")
    (True, False, False)
    """
    if b"," not in line or b"." in line or not (b";" in line or b"\t" in line):
        return False
    fields = [field.strip() for field in line.replace(b"\t", b";").split(b";") if b"," in field]
    return len(fields) >= MIN_DECIMALS and all(map(_DECIMAL_COMMA.fullmatch, fields))


def is_described(path: Path) -> bool:
    """Return whether a description of its columns lies beside a log."""
    return path.with_name(f"{path.name}.toml").is_file()


def read_layout(path: Path) -> ColumnsLayout:
    """Return the layout of a TOML file; raises DataMissing if there is none and BadData if it is not valid."""
    try:
        return layout_from_table(str(path), parse_toml(read_text(path, EXPECTED)))
    except ValueError as error:
        raise BadData(str(path), "", f"not valid TOML ({error})", f"give {EXPECTED}") from None


def layout_from_table(owner: str, table: Mapping[str, Any]) -> ColumnsLayout:
    """Return the layout of TOML tables; raises BadData that names ``owner`` and the key."""
    parts: dict[str, Any] = dict(table)
    for name, kind in (("time", TimeColumn), ("scan", ScanColumns), ("pose", PoseColumns), ("ticks", TickColumns)):
        if name in parts:
            parts[name] = _make(owner, name, kind, parts[name])
    return _make(owner, "", ColumnsLayout, parts)


LayoutPart = TypeVar("LayoutPart")

_RANGES: Mapping[str, tuple[float, float]] = {
    **dict.fromkeys(("column", "first", "x", "y", "heading", "left", "right"), (1, MAX_COLUMNS)),
    **dict.fromkeys(("ticks_per_turn", "wheel_diameter_m", "track_m", "turn_factor"), (1e-6, 1e9)),
    "step_deg": (1e-6, 360.0),
    "beams": (0, MAX_COLUMNS),
    "wraps_at": (0, 2**63),
    "range_max_m": (1e-3, 1e6),
    "range_min_m": (0.0, 1e6),
    "turned_s": (0.0, 3600.0),
    "header_lines": (0, 10**6),
}
"""Limits of the numbers, by key."""


def _make(owner: str, place: str, kind: type[LayoutPart], values: object) -> LayoutPart:
    """Return a dataclass of the values of a table, all of them checked."""
    if not isinstance(values, Mapping):
        raise BadData(owner, place, f"{brief(values)} is not a table", f"give {EXPECTED}")
    known = get_type_hints(kind)
    for key, value in values.items():
        if key not in known:
            raise BadData(owner, place, f"unknown key {brief(key)}", f"known: {', '.join(known)}")
        if problem := _find_problem(key, known[key], value):
            raise BadData(owner, f"{place}.{key}".strip("."), problem, f"give {EXPECTED}")
    try:
        return kind(**{key: tuple(value) if isinstance(value, list) else value for key, value in values.items()})
    except TypeError as error:  # a key without default is absent
        raise BadData(owner, place, str(error).split(": ")[-1] + " missing", f"give {EXPECTED}") from None
    except ValueError as error:
        raise BadData(owner, place, str(error), f"give {EXPECTED}") from None


def _find_problem(key: str, kind: Any, value: object) -> str:
    """Return what is wrong with a value, "" if nothing: its type, its unit, or its size."""
    if choices := get_args(kind) if get_origin(kind) is Literal else ():
        return "" if value in choices else f"{brief(value)} is not one of {', '.join(choices)}"
    if kind in (str, bool):
        return "" if type(value) is kind else f"{brief(value)} is not a {kind.__name__}"
    if kind not in (int, float, tuple[float, ...]):
        return ""  # a table, made before
    if isinstance(value, list) != (get_origin(kind) is tuple):
        return f"{brief(value)} is not {'a number' if isinstance(value, list) else 'a list'}"
    numbers = value if isinstance(value, list) else [value]
    return next(filter(None, (_find_number_problem(key, kind is int, number) for number in numbers)), "")


def _find_number_problem(key: str, integer: bool, number: Any) -> str:
    if type(number) not in ((int,) if integer else (int, float)) or not math.isfinite(number):
        return f"{brief(number)} is not {'an integer' if integer else 'a finite number'}"
    low, high = _RANGES.get(key, (-math.inf, math.inf))
    return "" if low <= number <= high else f"expected {low:g} to {high:g}, got {number:g}"
