"""Occupancy grids as ROS map_server saves them: a PGM or PNG image and a YAML file that says what it means."""

from __future__ import annotations

import re
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.core.errors import BadData, DataMissing, brief
from evalkit.core.grid import OccupancyGrid
from evalkit.io.input_files import bytes_of

Shades = NDArray[np.uint8] | NDArray[np.uint16]

UNKNOWN = 205
"""The grey map_server itself writes for unknown."""

LOG_ODDS = 3.5
"""What "occupied" and "free" become: p = 0.97 and 0.03, clear of every threshold."""

MAX_PIXELS = 2**26
"""Of an image: a square of 400 m in cells of 5 cm. A few bytes may claim, and a small PNG hold, any number."""

MAX_YAML_BYTES = 4096

_GAP = rb"(?:\s|#[^\n]*\n)+"
_HEADER = re.compile(rb"P([25])" + 3 * (_GAP + rb"(\d{1,10})") + rb"(?:#[^\n]*\n)?\s")


def read(path: Path) -> OccupancyGrid:
    """The grid of a map's YAML file; its image is sought beside it.

    Trinary maps only. The image's row 0 is the top, the grid's row 0 the lowest y. A pixel of 205 stays unknown even
    where ``free_thresh`` would call it free: older savers wrote 0.25 while 205 stands for 0.196.
    """
    settings = _settings(path)
    grey, maximum = _grey(path.parent / settings["image"])
    shades = np.arange(maximum + 1)  # each is judged once, however many pixels have it
    occupancy = shades / maximum if settings["negate"] else (maximum - shades) / maximum
    unknown = (shades == UNKNOWN) & (maximum == 255)
    occupied = (occupancy > settings["occupied_thresh"]) & ~unknown
    free = (occupancy < settings["free_thresh"]) & ~unknown
    log_odds = np.where(occupied, LOG_ODDS, np.where(free, -LOG_ODDS, 0.0)).astype(np.float32)
    x, y, _ = settings["origin"]
    below = np.flipud(grey)
    return OccupancyGrid(log_odds[below], (occupied | free)[below], settings["resolution"], x, y)


def image_of(path: Path) -> Path | None:
    """The image a map's YAML file names, None where it names none that can be read."""
    try:
        image: str = _settings(path)["image"]
    except (BadData, DataMissing):
        return None
    return path.parent / image


def _settings(path: Path) -> dict[str, Any]:
    """The checked keys of the YAML file."""
    from ruamel.yaml import YAML  # noqa: PLC0415 - only maps need it
    from ruamel.yaml.error import YAMLError  # noqa: PLC0415

    content = bytes_of(path, "the YAML file of a map")
    if len(content) > MAX_YAML_BYTES:
        raise BadData(str(path), "", f"{len(content)} bytes, far too many", "give the YAML file of a map")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadData(str(path), f"byte {error.start}", "no text", "give the YAML file of a map") from None
    try:
        found = YAML(typ="safe", pure=True).load(text)
    except (YAMLError, ValueError, RecursionError) as error:
        raise BadData(str(path), "", f"no YAML ({' '.join(str(error).split())[:100]})", "save the map again") from None
    if not isinstance(found, dict):
        raise BadData(str(path), "", "no keys in it", "give the YAML file of a map")
    known = {"mode": "trinary", "negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196, **found}
    for key in ("image", "resolution", "origin"):
        if key not in known:
            raise BadData(str(path), "", f"missing key '{key}'", "give the YAML file of a map")
    for key in ("image", "mode"):
        if not isinstance(known[key], str):  # not shown: an alias of aliases is longer than any memory
            raise BadData(str(path), key, "no text", "give the YAML file of a map")
    if known["mode"] != "trinary":
        raise BadData(str(path), "mode", f"{brief(known['mode'])} is not read", "save the map in mode trinary")
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


def _grey(path: Path) -> tuple[Shades, int]:
    """The grey values (H, W) of the image, row 0 the top, and the value of white, which none exceeds."""
    content = bytes_of(path, "the image of the map")
    return _png(path, content) if content.startswith(b"\x89PNG") else _pgm(path, content)


def _png(path: Path, content: bytes) -> tuple[Shades, int]:
    """Colours become their mean, as map_server takes them."""
    from PIL import Image  # noqa: PLC0415 - only maps need it

    try:
        with Image.open(BytesIO(content)) as image:
            _bounded(path, *image.size)
            if image.mode.startswith("I"):  # 16 bits
                return np.clip(np.asarray(image), 0, 65535).astype(np.uint16), 65535
            if image.mode in ("1", "L"):
                return np.asarray(image.convert("L")), 255
            total = np.asarray(image.convert("RGB")).sum(axis=2, dtype=np.uint16)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise BadData(str(path), "", f"damaged PNG image ({error})", "save the map again") from None
    return ((total + 1) // 3).astype(np.uint8), 255


def _pgm(path: Path, content: bytes) -> tuple[Shades, int]:
    header = _HEADER.match(content)
    if header is None:
        raise BadData(str(path), "", f"no PGM or PNG image: it begins {content[:8]!r}", "convert it")
    width, height, maximum = (int(number) for number in header.groups()[1:])
    _bounded(path, width, height)
    body = content[header.end() :]
    grey: NDArray[Any]
    try:
        if header[1] == b"2":
            grey = np.array([int(word) for word in re.sub(rb"#[^\n]*", b"", body).split()], dtype=np.int64)
        else:
            grey = np.frombuffer(body, dtype=np.uint8 if maximum < 256 else ">u2")
    except (ValueError, OverflowError) as error:
        raise BadData(str(path), "", f"damaged pixels ({error})", "save the map again") from None
    if not 0 < maximum < 2**16 or len(grey) < width * height:
        raise BadData(
            str(path), "", f"{len(grey)} pixels for {width} x {height}, white {maximum}", "save the map again"
        )
    shades = np.clip(grey[: width * height], 0, maximum).astype(np.uint16)
    return shades.reshape(height, width), maximum


def _bounded(path: Path, width: int, height: int) -> None:
    """Refuses an image that would fill the memory, or has no pixel at all, before it is unpacked."""
    if not 0 < width * height <= MAX_PIXELS:
        what = f"{width} x {height} pixels, and at most {MAX_PIXELS} are read"
        raise BadData(str(path), "", what, "save the map in larger cells")
