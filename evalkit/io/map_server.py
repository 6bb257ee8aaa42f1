"""Read and write occupancy grids in ROS map_server format: a PGM or PNG image and a YAML file with its metadata."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evalkit.core.errors import BadData, DataMissing, brief
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
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

MODES = ("trinary", "scale", "raw")

_GAP = rb"(?:\s|#[^\n]*\n)+"
_HEADER = re.compile(rb"P([25])" + 3 * (_GAP + rb"(\d{1,10})") + rb"(?:#[^\n]*\n)?\s")


def read_map(path: Path) -> OccupancyGrid:
    """Return the grid of a map's YAML file, see ``read_rotated_map``; raises BadData also for a rotated map."""
    grid, map_from_grid = read_rotated_map(path)
    if map_from_grid.theta != 0.0:
        raise BadData(str(path), "origin", f"the map is rotated by {map_from_grid.theta:g} rad", "save it with yaw 0")
    return grid


def read_rotated_map(path: Path) -> tuple[OccupancyGrid, Pose]:
    """Return the grid of a map's YAML file and ``map_from_grid``; the image is looked up relative to the file.

    ``map_from_grid`` is the identity, unless the origin is rotated: then the grid's corner is at 0 and the motion is
    the origin. Row 0 of the image is the top, row 0 of the grid the lowest y.

    Modes trinary, scale and raw as in map_server. In mode trinary a pixel of 205 is unknown even if ``free_thresh``
    makes it free: older versions of map_saver wrote 0.25, and 205 means 0.196. Raises DataMissing or BadData.
    """
    settings = _read_settings(path)
    grey, maximum = _read_grey(path.parent / settings["image"])
    log_odds, observed = _classify(settings, maximum)  # each grey value once
    below = np.flipud(grey)
    x, y, yaw = settings["origin"]
    turned = abs(yaw) > 1e-9
    corner, map_from_grid = ((0.0, 0.0), Pose(x, y, yaw)) if turned else ((x, y), Pose())
    return OccupancyGrid(log_odds[below], observed[below], settings["resolution"], *corner), map_from_grid


def log_odds_of_percent(percent: ArrayLike) -> NDArray[np.float32]:
    """Return the log-odds of probabilities in percent, limited to those of map_server's walls and free cells."""
    limit = 1.0 / (1.0 + np.exp(LOG_ODDS))
    share = np.clip(np.asarray(percent, dtype=np.float64) / 100.0, limit, 1.0 - limit)
    return np.log(share / (1.0 - share)).astype(np.float32)


def _classify(settings: dict[str, Any], maximum: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return log-odds and whether a cell is observed, by grey value 0 to ``maximum``."""
    shades = np.arange(maximum + 1)
    if settings["mode"] == "raw":  # the pixel is the value of the cell in percent; above 100 it is unknown
        return np.where(shades <= 100, log_odds_of_percent(shades), np.float32(0.0)), shades <= 100
    occupancy = shades / maximum if settings["negate"] else (maximum - shades) / maximum
    low, high = settings["free_thresh"], settings["occupied_thresh"]
    if settings["mode"] == "scale":  # linear between the thresholds
        inner = 100.0 * (occupancy - low) / max(high - low, 1e-9)
        percent = np.where(occupancy > high, 100.0, np.where(occupancy < low, 0.0, inner))
        return log_odds_of_percent(percent), np.ones(maximum + 1, dtype=np.bool_)
    unknown = (shades == UNKNOWN) & (maximum == 255)
    occupied, free = (occupancy > high) & ~unknown, (occupancy < low) & ~unknown
    return np.where(occupied, LOG_ODDS, np.where(free, -LOG_ODDS, 0.0)).astype(np.float32), occupied | free


def draw_pixels(grid: OccupancyGrid) -> Shades:
    """Return the grey values (H, W) of a map, row 0 on top: 254 free, 0 occupied, 205 unknown."""
    pixels = np.full(grid.shape, UNKNOWN, dtype=np.uint8)
    pixels[grid.free()], pixels[grid.occupied()] = 254, 0
    return pixels[::-1]


def write_map(stem: Path, grid: OccupancyGrid, root: Path | None = None, world_from_start: Pose | None = None) -> None:
    """Write STEM.pgm (row 0 on top; 254 free, 0 occupied, 205 unknown) and STEM.yaml with every digit.

    ``root``: as in ``output_files.write_bytes``. ``world_from_start``: from the frame of the trajectory that the map is
    drawn from to that of the map, as a comment of the YAML file. Raises StoreError.
    """
    comment = ""
    if world_from_start is not None:
        moved = " ".join(map(repr, world_from_start.row.tolist()))
        comment = (
            f"# frame: world; the trajectory is start_from_base, world_from_start = {moved} (x y theta: m, m, rad)\n"
        )
    rows, columns = grid.shape
    size, x, y = (float(value) for value in (grid.resolution_m, grid.origin_x, grid.origin_y))  # no numpy in repr
    header = b"P5\n%d %d\n255\n" % (columns, rows)
    write_bytes(stem.with_name(stem.name + ".pgm"), header + draw_pixels(grid).tobytes(), root)
    write_text(
        stem.with_name(stem.name + ".yaml"),
        f"{comment}image: {stem.name}.pgm\nmode: trinary\nresolution: {size!r}\n"
        f"origin: [{x!r}, {y!r}, 0.0]\nnegate: 0\n"
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
    from ruamel.yaml.error import YAMLError  # noqa: PLC0415 - heavy, and used for maps only

    from evalkit.io.plain_yaml import make_yaml  # noqa: PLC0415 - as above

    content = read_bytes(path, "the YAML file of a map")
    if len(content) > MAX_YAML_BYTES:
        raise _no_yaml_error(path, f"{len(content)} bytes, more than {MAX_YAML_BYTES}")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _no_yaml_error(path, f"no UTF-8 text at byte {error.start}") from None
    try:
        loaded = make_yaml().load(text)
    except (YAMLError, ValueError, RecursionError) as error:
        raise BadData(
            str(path), "", f"not valid YAML ({' '.join(str(error).split())[:100]})", "save the map again"
        ) from None
    if not isinstance(loaded, dict):
        raise _no_yaml_error(path, "it has no keys")
    known = {"mode": "trinary", "negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196, **loaded}
    for key in ("image", "resolution", "origin"):
        if key not in known:
            raise _no_yaml_error(path, f"missing key '{key}'")
    for key in ("image", "mode"):
        if not isinstance(known[key], str):
            raise BadData(str(path), key, f"{brief(known[key])} is not a string", "give the YAML file of a map")
    if known["mode"] not in MODES:
        raise BadData(str(path), "mode", f"{brief(known['mode'])} is no mode", f"expected one of {', '.join(MODES)}")
    return known | _check_geometry(path, known)


def _no_yaml_error(path: Path, why: str) -> BadData:
    remedy = "give the .yaml that map_saver or evalkit export -f map writes"
    return BadData(str(path), "", f"this is not the YAML file of a map ({why})", remedy)


def _check_geometry(path: Path, known: dict[str, Any]) -> dict[str, Any]:
    checked: dict[str, Any] = {
        key: _parse_number(path, key, known[key]) for key in ("resolution", "occupied_thresh", "free_thresh", "negate")
    }
    origin = known["origin"]
    if not isinstance(origin, list) or len(origin) != 3:
        raise BadData(str(path), "origin", f"found {brief(origin)}", "expected [x, y, yaw]")
    if not checked["resolution"] > 0.0:
        raise BadData(str(path), "resolution", f"{checked['resolution']}", "expected metres per cell, more than 0")
    for key in ("occupied_thresh", "free_thresh"):
        if not 0.0 <= checked[key] <= 1.0:
            raise BadData(str(path), key, f"found {brief(known[key])}", "expected a probability, 0 to 1")
    return checked | {"origin": tuple(_parse_number(path, "origin", value) for value in origin)}


def _parse_number(path: Path, key: str, value: object) -> float:
    number = math.nan
    with suppress(TypeError, ValueError, OverflowError):
        number = float(cast(float, value))
    if not math.isfinite(number):
        raise BadData(str(path), key, f"found {brief(value)}", "expected a finite number")
    return number


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
