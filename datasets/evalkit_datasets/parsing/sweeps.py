"""One sweep of a lidar from a ROS message: LaserScan, MultiEchoLaserScan, PointCloud2, or fields named by the user."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.errors import BadParameter
from evalkit.core.se2 import Floats
from evalkit_datasets.parsing.cloud_slice import CloudSlice, read_packed_points
from evalkit_datasets.parsing.columns_layout import ANGLE_UNITS, LENGTH_UNITS
from evalkit_datasets.parsing.range_minimum import raise_range_min_m

LASER_SCAN = "sensor_msgs/msg/LaserScan"
ECHOES = "sensor_msgs/msg/MultiEchoLaserScan"
CLOUD = "sensor_msgs/msg/PointCloud2"

MAX_SWEEP_S = 3600.0
"""A message with a longer sweep is damaged."""

MAX_RANGE_M = 100.0
"""Ranges from here on are no returns where the message states no limit."""

MIN_RANGE_MAX_M = 0.5
"""No lidar has a smaller maximum."""

POINT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy types by the numbers of sensor_msgs/PointField."""

RANGE_NAMES = ("ranges", "range", "distances", "distance", "dists", "dist", "ranges_mm", "range_mm", "distance_mm",
               "dist_mm", "distances_mm", "radius")  # fmt: skip
ANGLE_NAMES = ("angles", "angle", "azimuths", "azimuth", "bearings", "bearing", "thetas", "theta", "angles_deg",
               "angle_deg", "azimuth_deg", "angles_rad", "angle_rad")  # fmt: skip
FIRST_NAMES = ("angle_min", "start_angle", "first_angle", "min_angle", "angle_start")
STEP_NAMES = ("angle_increment", "angle_step", "angular_resolution", "step_angle", "angle_resolution", "resolution")
MAX_DEPTH = 3


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """One sweep in the lidar's frame. ``ranges`` (B,) in m as sent: none is inf, invalid ones are kept.

    ``angle_min``, ``angle_increment``: of evenly spaced beams (rad), counter-clockwise; ``own_angles`` (B,): of others.
    """

    stamp_ns: int
    frame: str
    ranges: Floats
    angle_min: float
    angle_increment: float
    range_min_m: float
    range_max_m: float
    time_increment_ns: int
    own_angles: Floats | None = None

    def angles(self) -> Floats:
        """Return the angles (B,) in firing order (rad)."""
        if self.own_angles is not None:
            return self.own_angles
        return np.asarray(self.angle_min + self.angle_increment * np.arange(len(self.ranges)), dtype=np.float64)

    @property
    def duration_ns(self) -> int:
        """Time from the first beam to the last."""
        return self.time_increment_ns * (len(self.ranges) - 1)

    @property
    def is_invalid(self) -> Bools:
        """Mask (B,) of invalid ranges: nan, zero, negative or below the minimum."""
        return np.asarray(~(self.ranges >= max(self.range_min_m, 1e-9)))


@dataclass(frozen=True)
class MessageFields:
    """Which fields of a message hold the sweep, by dotted names; a name may lead through a list of messages.

    ``ranges``: the ranges. Either ``angles``: those of the beams, or ``first`` and ``step``: fields or numbers.
    ``range_unit``: m, cm or mm. ``angle_unit``: rad or deg. ``clockwise``: the angles grow clockwise.
    """

    ranges: str
    angles: str = ""
    first: str = ""
    step: str = ""
    range_unit: str = "m"
    angle_unit: str = "rad"
    clockwise: bool = False

    def __str__(self) -> str:
        words = [f"ranges={self.ranges}", *(f"{key}={value}" for key in ("angles", "first", "step")
                                            if (value := getattr(self, key)))]  # fmt: skip
        words += [f"range_unit={self.range_unit}", f"angle_unit={self.angle_unit}"]
        return " ".join([*words, *(["clockwise"] if self.clockwise else [])])


@dataclass(frozen=True)
class SweepOptions:
    """How messages become sweeps: the slice of a point cloud, and the fields of messages of other types.

    ``sweep_s``: time from the first beam to the last (s), whatever the scans say; 0: as they say. Clouds
    have no order of beams, and are always taken at once. ``range_min_m``: the least minimum of a sweep's ranges.
    ``stamp_shift_s``: added to the stamps.
    """

    cloud: CloudSlice = field(default_factory=CloudSlice)
    fields: MessageFields | None = None
    sweep_s: float = 0.0
    range_min_m: float = 0.0
    stamp_shift_s: float = 0.0


def parse_fields(text: str) -> MessageFields | None:
    """Return the fields in a parameter such as ``ranges=dist angles=angle angle_unit=deg``; None for "".

    Raises BadParameter for an unknown key or unit, or where ranges or angles are missing.
    """
    if not text:
        return None
    expected = "'ranges=NAME angles=NAME' or 'ranges=NAME first=NAME step=NAME', range_unit=m|cm|mm, angle_unit=rad|deg"
    pairs = {key: value for key, _, value in (word.partition("=") for word in text.replace(",", " ").split())}
    clockwise = pairs.pop("clockwise", None)
    known = {"ranges", "angles", "first", "step", "range_unit", "angle_unit"}
    complete = pairs.get("ranges") and (pairs.get("angles") or (pairs.get("first") and pairs.get("step")))
    units = pairs.get("range_unit", "m") in LENGTH_UNITS and pairs.get("angle_unit", "rad") in ANGLE_UNITS
    if not (complete and units and set(pairs) <= known and clockwise in (None, "", "true")):
        raise BadParameter("rosbag", "fields", repr(text[:120]), expected)
    return MessageFields(**pairs, clockwise=clockwise is not None)


def guess_fields(message: Any) -> MessageFields | None:
    """Return the fields of a message of an unknown type that look like ranges and angles, or None.

    Names decide. Units are those in a name ("_mm", "_deg"); integers are millimetres; angles beyond a turn are degrees.
    """
    found = _walk(message)
    ranges = next((path for name in RANGE_NAMES for path in found.get(name, ()) if _is_array(message, path)), "")
    if not ranges:
        return None
    beside = ranges.rpartition(".")[0]
    angles = next((path for name in ANGLE_NAMES for path in found.get(name, ())
                   if _is_array(message, path) and path.rpartition(".")[0] == beside), "")  # fmt: skip
    first, step = ("" if angles else _find_number(message, found, names) for names in (FIRST_NAMES, STEP_NAMES))
    if not angles and not (first and step):
        return None
    values = np.asarray(value_at(message, ranges))
    named = next((unit for unit in ("mm", "cm") if ranges.endswith(f"_{unit}")), "")
    length = named or ("mm" if np.issubdtype(values.dtype, np.integer) else "m")
    extent = np.abs(np.asarray([value_at(message, path) for path in filter(None, (angles, first, step))], dtype=float))
    degrees = "_deg" in (angles or first) or (extent.size > 0 and bool(np.nanmax(extent) > 2.0 * np.pi + 0.1))
    return MessageFields(ranges, angles, first, step, length, "deg" if degrees else "rad")


def _find_number(message: Any, found: Mapping[str, list[str]], names: tuple[str, ...]) -> str:
    return next((path for name in names for path in found.get(name, ()) if not _is_array(message, path)), "")


def value_at(message: Any, path: str) -> Any:
    """Return the value of a dotted name; through a list of messages, the list of their values. Raises ValueError."""
    for at, name in enumerate(path.split(".")):
        if isinstance(message, list):
            return [value_at(each, ".".join(path.split(".")[at:])) for each in message]
        if not hasattr(message, name):
            raise ValueError(f"no field '{path}' in the message")
        message = getattr(message, name)
    return message


def parse_sweep(message: Any, kind: str, recorded_ns: int, options: SweepOptions) -> Sweep | None:
    """Return the sweep of a message, None if the message is damaged; ``recorded_ns`` is its time if it has no stamp."""
    is_cloud = options.fields is None and kind == CLOUD
    by_fields = options.fields is not None or kind not in _PARSERS
    if is_cloud:
        sweep = _parse_cloud(options.cloud, message, recorded_ns)
    else:
        sweep = _parse_fields(options, message, recorded_ns) if by_fields else _PARSERS[kind](message, recorded_ns)
    if sweep is None:
        return None
    stamp_ns = sweep.stamp_ns + round(options.stamp_shift_s * 1e9)
    if is_cloud:
        return replace(sweep, stamp_ns=stamp_ns)
    low = raise_range_min_m("rosbag", sweep.range_min_m, options.range_min_m, sweep.range_max_m)
    given_ns = round(options.sweep_s * 1e9 / (len(sweep.ranges) - 1))
    increment_ns = given_ns or sweep.time_increment_ns
    return replace(sweep, stamp_ns=stamp_ns, range_min_m=low, time_increment_ns=increment_ns)


def parse_stamp_ns(header: Any) -> int:
    """Return the time of a header in ns."""
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def normalise_frame(frame: str) -> str:
    """Return the name of a frame without the leading slash that ROS 1 may write."""
    return frame.lstrip("/")


def _parse_laser(message: Any, recorded_ns: int) -> Sweep | None:
    with np.errstate(invalid="ignore"):  # widening some nan patterns raises a warning
        return _parse_even_beams(message, np.asarray(message.ranges, dtype=np.float64), recorded_ns)


def _parse_echoes(message: Any, recorded_ns: int) -> Sweep | None:
    """Return the first echo of each beam, which is the nearest."""
    with np.errstate(invalid="ignore"):
        first = [beam.echoes[0] if len(beam.echoes) else np.inf for beam in message.ranges]
        return _parse_even_beams(message, np.array(first, dtype=np.float64), recorded_ns)


def _parse_even_beams(message: Any, ranges: Floats, recorded_ns: int) -> Sweep | None:
    stated = message.range_max not in (0.0, np.inf)
    high = message.range_max if stated else MAX_RANGE_M
    geometry = [message.angle_min, message.angle_increment, message.range_min, high]
    plausible = np.isfinite(geometry).all() and 0.0 <= geometry[2] < geometry[3] and geometry[1] != 0.0
    increment = _time_increment_s(message)
    if len(ranges) < 2 or not plausible or increment * len(ranges) > MAX_SWEEP_S:
        return None
    stamp, frame = parse_stamp_ns(message.header) or recorded_ns, normalise_frame(message.header.frame_id)
    first, step, low, high = map(float, geometry)
    return Sweep(stamp, frame, ranges, first, step, low, high, round(increment * 1e9))


def _time_increment_s(message: Any) -> float:
    """Return the time between two beams (s), 0 where the message does not state it."""
    increment = float(getattr(message, "time_increment", 0.0))
    return increment if np.isfinite(increment) and increment > 0.0 else 0.0


def _parse_cloud(cloud: CloudSlice, message: Any, recorded_ns: int) -> Sweep | None:
    fields = {each.name: (POINT_TYPES.get(int(each.datatype), ""), int(each.offset)) for each in message.fields}
    data = np.asarray(message.data, dtype=np.uint8)
    shape = int(message.height), int(message.width), int(message.row_step), int(message.point_step)
    points = read_packed_points(data, fields, shape, bool(message.is_bigendian))
    if points is None:
        return None
    stamp, frame = parse_stamp_ns(message.header) or recorded_ns, normalise_frame(message.header.frame_id)
    ranges, angles = cloud.cut(points)
    return Sweep(stamp, frame, ranges, 0.0, 0.0, cloud.range_min_m, cloud.range_max_m, 0, angles)


def _parse_fields(options: SweepOptions, message: Any, recorded_ns: int) -> Sweep | None:
    fields = options.fields
    if fields is None:
        return None
    ranges = np.asarray(value_at(message, fields.ranges), dtype=np.float64) * LENGTH_UNITS[fields.range_unit]
    unit = ANGLE_UNITS[fields.angle_unit] * (-1.0 if fields.clockwise else 1.0)
    if fields.angles:
        angles = np.asarray(value_at(message, fields.angles), dtype=np.float64) * unit
    else:
        first, step = (_number_at(message, path) * unit for path in (fields.first, fields.step))
        angles = np.asarray(first + step * np.arange(len(ranges)), dtype=np.float64)
    if ranges.ndim != 1 or angles.shape != ranges.shape or len(ranges) < 2 or not np.isfinite(angles).all():
        return None
    header = getattr(message, "header", None)
    stamp = recorded_ns if header is None else parse_stamp_ns(header) or recorded_ns
    frame = "" if header is None else normalise_frame(header.frame_id)
    low, high = (float(getattr(message, name, 0.0)) for name in ("range_min", "range_max"))
    scale = LENGTH_UNITS[fields.range_unit]
    if high * scale < MIN_RANGE_MAX_M <= high:  # the ranges alone are in another unit
        scale = 1.0
    scaled = [value * scale for value in (low, high)]
    limits = scaled if np.isfinite(scaled).all() and 0.0 <= scaled[0] < scaled[1] else [0.0, MAX_RANGE_M]
    increment = _time_increment_s(message)
    if increment * len(ranges) > MAX_SWEEP_S:
        return None
    return Sweep(stamp, frame, ranges, 0.0, 0.0, limits[0], limits[1], round(increment * 1e9), angles)


_PARSERS: Mapping[str, Callable[[Any, int], Sweep | None]] = {LASER_SCAN: _parse_laser, ECHOES: _parse_echoes}


def _number_at(message: Any, path: str) -> float:
    """Return a number that is given, or that a field holds."""
    try:
        return float(path)
    except ValueError:
        return float(value_at(message, path))


def _is_array(message: Any, path: str) -> bool:
    value = value_at(message, path)
    return isinstance(value, (list, np.ndarray)) and np.asarray(value).dtype.kind in "iuf" and np.ndim(value) == 1


def _walk(message: Any, prefix: str = "", depth: int = 0) -> dict[str, list[str]]:
    """Return the dotted names of a message's fields by their last word, in lower case; the first of a list is asked."""
    found: dict[str, list[str]] = {}
    for name in getattr(message, "__dataclass_fields__", ()) if depth < MAX_DEPTH else ():
        value = getattr(message, name)
        inner = value[0] if isinstance(value, list) and value else value
        found.setdefault(name.lower(), []).append(prefix + name)
        if hasattr(inner, "__dataclass_fields__"):
            for last, paths in _walk(inner, f"{prefix}{name}.", depth + 1).items():
                found.setdefault(last, []).extend(paths)
    return found
