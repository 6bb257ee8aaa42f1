"""Occupancy grids as ROS map_server saves them: a PGM or PNG image and a YAML file that says what it means."""

from __future__ import annotations

import re
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.content import bytes_of
from evalkit.errors import BadData, DataMissing
from evalkit.se2 import Floats
from evalkit.types import OccupancyGrid

UNKNOWN = 205
"""The grey map_server itself writes for unknown."""

LOG_ODDS = 3.5
"""What "occupied" and "free" become: p = 0.97 and 0.03, clear of every threshold."""

_HEADER = re.compile(rb"P([25])(?:\s|#[^\n]*\n)+(\d+)(?:\s|#[^\n]*\n)+(\d+)(?:\s|#[^\n]*\n)+(\d+)(?:#[^\n]*\n)?\s")


def read(path: Path) -> OccupancyGrid:
    """The grid of a map's YAML file; its image is sought beside it.

    Trinary maps only. The image's row 0 is the top, the grid's row 0 the lowest y. A pixel of 205 stays unknown even
    where ``free_thresh`` would call it free: older savers wrote 0.25 while 205 stands for 0.196.
    """
    settings = _settings(path)
    grey, maximum = _grey(path.parent / str(settings["image"]))
    occupancy = grey / maximum if settings["negate"] else (maximum - grey) / maximum
    unknown = (grey == UNKNOWN) & (maximum == 255)
    occupied = (occupancy > settings["occupied_thresh"]) & ~unknown
    free = (occupancy < settings["free_thresh"]) & ~unknown
    log_odds = np.where(occupied, LOG_ODDS, np.where(free, -LOG_ODDS, 0.0)).astype(np.float32)
    x, y, _ = settings["origin"]
    return OccupancyGrid(np.flipud(log_odds), np.flipud(occupied | free), settings["resolution"], x, y)


def image_of(path: Path) -> Path | None:
    """The image a map's YAML file names, None where it names none that can be read."""
    try:
        return path.parent / str(_settings(path)["image"])
    except (BadData, DataMissing):
        return None


def _settings(path: Path) -> dict[str, Any]:
    """The checked keys of the YAML file."""
    from ruamel.yaml import YAML  # noqa: PLC0415 - only maps need it
    from ruamel.yaml.error import YAMLError  # noqa: PLC0415

    content = bytes_of(path, "the YAML file of a map")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadData(str(path), f"byte {error.start}", "no text", "give the YAML file of a map") from None
    try:
        found = YAML(typ="safe", pure=True).load(text)
    except YAMLError as error:
        raise BadData(str(path), "", f"no YAML ({' '.join(str(error).split())[:100]})", "save the map again") from None
    if not isinstance(found, dict):
        raise BadData(str(path), "", "no keys in it", "give the YAML file of a map")
    known = {"mode": "trinary", "negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196, **found}
    for key in ("image", "resolution", "origin"):
        if key not in known:
            raise BadData(str(path), "", f"missing key '{key}'", "give the YAML file of a map")
    if known["mode"] != "trinary":
        raise BadData(str(path), "mode", f"'{known['mode']}' is not read", "save the map in mode trinary")
    return known | _geometry(path, known)


def _geometry(path: Path, known: dict[str, Any]) -> dict[str, Any]:
    try:
        checked: dict[str, Any] = {
            key: float(known[key]) for key in ("resolution", "occupied_thresh", "free_thresh", "negate")
        }
        x, y, yaw = (float(value) for value in known["origin"])
    except (TypeError, ValueError):
        raise BadData(str(path), "", "a value that is no number", "expected numbers, and origin: [x, y, yaw]") from None
    if not (checked["resolution"] > 0.0 and np.isfinite([checked["resolution"], x, y]).all()):
        raise BadData(str(path), "resolution", f"{checked['resolution']}", "expected metres per cell, more than 0")
    if abs(yaw) > 1e-9:
        raise BadData(str(path), "origin", f"the map is turned by {yaw} rad", "save it with yaw 0")
    return checked | {"origin": (x, y, yaw)}


def _grey(path: Path) -> tuple[Floats, int]:
    """The grey values (H, W) of the image, row 0 the top, and the value of white."""
    content = bytes_of(path, "the image of the map")
    return _png(path, content) if content.startswith(b"\x89PNG") else _pgm(path, content)


def _png(path: Path, content: bytes) -> tuple[Floats, int]:
    """Colours become their mean, as map_server takes them."""
    from PIL import Image  # noqa: PLC0415 - only maps need it

    try:
        with Image.open(BytesIO(content)) as image:
            deep = image.mode.startswith("I")  # 16 bits
            grey = np.asarray(image if deep else image.convert("RGB"), dtype=np.float64)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise BadData(str(path), "", f"damaged PNG image ({error})", "save the map again") from None
    return (grey, 65535) if deep else (np.round(grey.mean(axis=2)), 255)


def _pgm(path: Path, content: bytes) -> tuple[Floats, int]:
    header = _HEADER.match(content)
    if header is None:
        raise BadData(str(path), "", f"no PGM or PNG image: it begins {content[:8]!r}", "convert it")
    width, height, maximum = (int(number) for number in header.groups()[1:])
    body = content[header.end() :]
    try:
        if header[1] == b"2":
            grey = np.array([int(word) for word in re.sub(rb"#[^\n]*", b"", body).split()], dtype=np.float64)
        else:
            grey = np.frombuffer(body, dtype=np.uint8 if maximum < 256 else ">u2").astype(np.float64)
    except ValueError as error:
        raise BadData(str(path), "", f"damaged pixels ({error})", "save the map again") from None
    if maximum == 0 or width * height == 0 or len(grey) < width * height:
        raise BadData(
            str(path), "", f"{len(grey)} pixels for {width} x {height}, white {maximum}", "save the map again"
        )
    return grey[: width * height].reshape(height, width), maximum
