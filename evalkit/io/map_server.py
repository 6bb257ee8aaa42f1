"""Read and write occupancy grids in ROS map_server format: a PGM or PNG image and a YAML file with its metadata."""

from __future__ import annotations

import re
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.core.errors import BadData, DataMissing, brief
from evalkit.core.grid import OccupancyGrid
from evalkit.io.input_files import read_bytes
from evalkit.io.output_files import write_bytes, write_text

Shades = NDArray[np.uint8] | NDArray[np.uint16]

UNKNOWN = 205
"""Grey value that map_server writes for unknown cells."""

LOG_ODDS = 3.5
"""Log-odds of occupied cells, and minus that of free ones: p = 0.97 and 0.03, well beyond every threshold."""

MAX_PIXELS = 2**26
"""Limit for an image: a square of 400 m in cells of 5 cm. A few bytes can declare any size."""

MAX_YAML_BYTES = 4096

_GAP = rb"(?:\s|#[^\n]*\n)+"
_HEADER = re.compile(rb"P([25])" + 3 * (_GAP + rb"(\d{1,10})") + rb"(?:#[^\n]*\n)?\s")


def read_map(path: Path) -> OccupancyGrid:
    """Return the grid of a map's YAML file; the image is looked up relative to it. Only mode trinary is supported.

    Row 0 of the image is the top, row 0 of the grid the lowest y. A pixel of 205 is unknown even if ``free_thresh``
    makes it free: older versions of map_saver wrote 0.25, and 205 means 0.196. Raises DataMissing or BadData.
    """
    settings = _read_settings(path)
    grey, maximum = _read_grey(path.parent / settings["image"])
    shades = np.arange(maximum + 1)  # each grey value is classified once
    occupancy = shades / maximum if settings["negate"] else (maximum - shades) / maximum
    unknown = (shades == UNKNOWN) & (maximum == 255)
    occupied = (occupancy > settings["occupied_thresh"]) & ~unknown
    free = (occupancy < settings["free_thresh"]) & ~unknown
    log_odds = np.where(occupied, LOG_ODDS, np.where(free, -LOG_ODDS, 0.0)).astype(np.float32)
    x, y, _ = settings["origin"]
    below = np.flipud(grey)
    return OccupancyGrid(log_odds[below], (occupied | free)[below], settings["resolution"], x, y)


def write_map(stem: Path, grid: OccupancyGrid, root: Path | None = None) -> None:
    """Write STEM.pgm (row 0 on top; 254 free, 0 occupied, 205 unknown) and STEM.yaml with every digit.

    ``root``: as in ``output_files.write_bytes``. Raises StoreError.
    """
    pixels = np.full(grid.shape, UNKNOWN, dtype=np.uint8)
    pixels[grid.free()], pixels[grid.occupied()] = 254, 0
    rows, columns = grid.shape
    size, x, y = (float(value) for value in (grid.resolution_m, grid.origin_x, grid.origin_y))  # no numpy in repr
    header = b"P5\n%d %d\n255\n" % (columns, rows)
    write_bytes(stem.with_name(stem.name + ".pgm"), header + pixels[::-1].tobytes(), root)
    write_text(
        stem.with_name(stem.name + ".yaml"),
        f"image: {stem.name}.pgm\nmode: trinary\nresolution: {size!r}\norigin: [{x!r}, {y!r}, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n",
        root,
    )


def find_map_image(path: Path) -> Path | None:
    """Return the path of the image named in a map's YAML file, or None if the YAML file is invalid."""
    try:
        image: str = _read_settings(path)["image"]
    except (BadData, DataMissing):
        return None
    return path.parent / image


def _read_settings(path: Path) -> dict[str, Any]:
    """Return the keys of the YAML file, checked, with defaults filled in."""
    from ruamel.yaml import YAML  # noqa: PLC0415 - heavy, and used for maps only
    from ruamel.yaml.error import YAMLError  # noqa: PLC0415

    content = read_bytes(path, "the YAML file of a map")
    if len(content) > MAX_YAML_BYTES:
        raise BadData(str(path), "", f"{len(content)} bytes, more than {MAX_YAML_BYTES}", "give the YAML file of a map")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadData(str(path), f"byte {error.start}", "not UTF-8 text", "give the YAML file of a map") from None
    try:
        loaded = YAML(typ="safe", pure=True).load(text)
    except (YAMLError, ValueError, RecursionError) as error:
        raise BadData(
            str(path), "", f"not valid YAML ({' '.join(str(error).split())[:100]})", "save the map again"
        ) from None
    if not isinstance(loaded, dict):
        raise BadData(str(path), "", "no keys in it", "give the YAML file of a map")
    known = {"mode": "trinary", "negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196, **loaded}
    for key in ("image", "resolution", "origin"):
        if key not in known:
            raise BadData(str(path), "", f"missing key '{key}'", "give the YAML file of a map")
    for key in ("image", "mode"):
        if not isinstance(known[key], str):  # value not shown: nested aliases can be arbitrarily long
            raise BadData(str(path), key, "not a string", "give the YAML file of a map")
    if known["mode"] != "trinary":
        raise BadData(str(path), "mode", f"{brief(known['mode'])} is not supported", "save the map in mode trinary")
    return known | _check_geometry(path, known)


def _check_geometry(path: Path, known: dict[str, Any]) -> dict[str, Any]:
    try:
        checked: dict[str, Any] = {
            key: float(known[key]) for key in ("resolution", "occupied_thresh", "free_thresh", "negate")
        }
        x, y, yaw = (float(value) for value in known["origin"])
    except (TypeError, ValueError):
        raise BadData(str(path), "", "a value is not a number", "expected numbers, and origin: [x, y, yaw]") from None
    if not (checked["resolution"] > 0.0 and np.isfinite([checked["resolution"], x, y]).all()):
        raise BadData(str(path), "resolution", f"{checked['resolution']}", "expected metres per cell, more than 0")
    if abs(yaw) > 1e-9:
        raise BadData(str(path), "origin", f"the map is rotated by {yaw} rad", "save it with yaw 0")
    return checked | {"origin": (x, y, yaw)}


def _read_grey(path: Path) -> tuple[Shades, int]:
    """Return the grey values (H, W) of the image, row 0 at the top, and the value of white, their maximum."""
    content = read_bytes(path, "the image of the map")
    return _parse_png(path, content) if content.startswith(b"\x89PNG") else _parse_pgm(path, content)


def _parse_png(path: Path, content: bytes) -> tuple[Shades, int]:
    """Return grey values and white; the grey of a colour is the mean of its channels, as in map_server."""
    from PIL import Image  # noqa: PLC0415 - heavy, and used for maps only

    try:
        with Image.open(BytesIO(content)) as image:
            _check_size(path, *image.size)
            if image.mode.startswith("I"):  # 16 bits
                return np.clip(np.asarray(image), 0, 65535).astype(np.uint16), 65535
            if image.mode in ("1", "L"):
                return np.asarray(image.convert("L")), 255
            total = np.asarray(image.convert("RGB")).sum(axis=2, dtype=np.uint16)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise BadData(str(path), "", f"damaged PNG image ({error})", "save the map again") from None
    return ((total + 1) // 3).astype(np.uint8), 255


def _parse_pgm(path: Path, content: bytes) -> tuple[Shades, int]:
    header = _HEADER.match(content)
    if header is None:
        raise BadData(
            str(path), "", f"not a PGM or PNG image: it begins with {content[:8]!r}", "convert it to PGM or PNG"
        )
    width, height, maximum = (int(number) for number in header.groups()[1:])
    _check_size(path, width, height)
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


def _check_size(path: Path, width: int, height: int) -> None:
    """Raise BadData for an image without pixels or one that would fill the memory, before it is decoded."""
    if not 0 < width * height <= MAX_PIXELS:
        what = f"{width} x {height} pixels; the limit is {MAX_PIXELS}"
        raise BadData(str(path), "", what, "save the map with larger cells")
