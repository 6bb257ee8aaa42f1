"""Reads distances measured with a tape from a TOML file: two places, metres, and how sure the tape is."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

from evalkit.core.errors import BadData, brief
from evalkit.core.measured_distances import Place, Span
from evalkit.io.input_files import read_text
from evalkit.io.timestamps import parse_stamp_ns
from evalkit.io.toml import parse_toml

WHAT = "a TOML file with one [[span]] a distance: from, to, metres"
SEEN = "expected a time in seconds, { at = seconds, point = [x, y] } or { wall = [x, y] }"
KEYS = ("name", "from", "to", "metres", "sigma_m")
SIGMA_M = 0.01


def read(path: Path) -> tuple[Span, ...]:
    """The distances in the order of the file.

    A place is a time in seconds (the robot then), ``{ at = seconds, point = [x, y] }`` (a point in m in the robot's
    frame then) or ``{ wall = [x, y] }`` (the wall of the map near that point). ``sigma_m`` is 0.01 where not given.
    """
    try:  # a float would lose the nanoseconds of a present-day time
        content = parse_toml(read_text(path, WHAT), Decimal)
    except ValueError as error:
        raise BadData(str(path), "", f"not valid TOML ({error})", f"give {WHAT}") from None
    rows = content.get("span")
    if not isinstance(rows, list) or not rows or set(content) != {"span"}:
        raise BadData(str(path), "", "its tables are not [[span]] alone", f"give {WHAT}")
    return tuple(_span(path, number, row) for number, row in enumerate(rows, start=1))


def _span(path: Path, number: int, row: object) -> Span:
    where = f"span {number}"
    if not isinstance(row, dict):
        raise BadData(str(path), where, f"{brief(row)} is no table", f"give {WHAT}")
    _known(path, where, row, KEYS)
    for key in ("from", "to", "metres"):
        if key not in row:
            raise BadData(str(path), where, f"missing key '{key}'", f"give {WHAT}")
    name = str(row.get("name", where))
    first, second = (_place(path, f"{where}, {key}", row[key]) for key in ("from", "to"))
    lengths = [_number(path, f"{where}, {key}", row.get(key, SIGMA_M)) for key in ("metres", "sigma_m")]
    try:
        return Span(name, first, second, *lengths)
    except ValueError as error:
        raise BadData(str(path), where, str(error), "a distance and its standard deviation are positive") from None


def _place(path: Path, where: str, value: object) -> Place:
    if not isinstance(value, dict):
        return Place(stamp_ns=_time(path, where, value))
    _known(path, where, value, ("wall",) if "wall" in value else ("at", "point"))
    if "wall" in value:
        return Place(*_point(path, where, value["wall"]))
    if "at" not in value:
        raise BadData(str(path), where, "neither 'at' nor 'wall'", SEEN)
    return Place(*_point(path, where, value.get("point", [0, 0])), _time(path, where, value["at"]))


def _time(path: Path, where: str, value: object) -> int:
    try:
        if isinstance(value, bool) or not isinstance(value, (int, str, Decimal)):
            raise ValueError(f"{brief(value)} is not a time in seconds")
        return parse_stamp_ns(str(value))
    except ValueError as error:
        raise BadData(str(path), where, str(error), SEEN) from None


def _point(path: Path, where: str, value: object) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise BadData(str(path), where, f"'{brief(str(value))[1:-1]}' is no point", SEEN)
    x, y = (_number(path, where, each) for each in value)
    return x, y


def _number(path: Path, where: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float, Decimal)) or not Decimal(value).is_finite():
        raise BadData(str(path), where, f"'{brief(str(value))[1:-1]}' is not a number", "give metres as a number")
    return float(value)


def _known(path: Path, where: str, row: Mapping[str, Any], keys: tuple[str, ...]) -> None:
    for key in row:
        if key not in keys:
            raise BadData(str(path), where, f"unknown key {brief(key)}", f"known: {', '.join(keys)}")
