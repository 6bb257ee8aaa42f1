"""Propose the layout of a text log in columns from its own numbers: time, ranges, odometry, units, angles."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.errors import EvalkitError
from evalkit.core.pose import MAX_COORDINATE_M
from evalkit.core.se2 import Floats
from evalkit.io.text_lines import iter_lines
from evalkit_datasets.commands.inspect.streams import LaserStream, OdometryStream, ScanSample
from evalkit_datasets.commands.inspect.turn_comparison import compare_turns
from evalkit_datasets.parsing.columns_layout import ANGLE_UNITS, LENGTH_UNITS, has_decimal_comma, split_columns
from evalkit_datasets.readers.columns import EXPECTED, Columns

MAX_LINES, MIN_LINES, MAX_VALUES = 3000, 10, 2_000_000
MIN_BEAMS, MAX_COLUMNS = 20, 5000
NEAR = 0.3
"""Neighbouring beams differ by less than this share, mostly; columns of different meaning differ by more."""

PERIODS = {"s": (0.008, 2.0), "ms": (8.0, 2000.0), "us": (8e3, 2e6), "ns": (8e6, 2e9)}
"""Period of a scan in each unit of time (8 ms to 2 s): at most one fits, for the border values the first."""

MAX_REPEATED = 0.1
"""Share of lines with the time of the line before: a log may repeat lines."""

MAX_HEADING = 4.0 * math.pi
"""Headings beyond two turns are in deg, unless the scans show that the robot turned so far."""

MAX_LINE_TURN = math.radians(60.0)
"""No robot turns by more from line to line."""

MEDIAN_M = (0.3, 20.0)
"""Median range of a room or a hall."""

VIEWS = {
    180: (-90.0, 1.0), 181: (-90.0, 1.0), 361: (-90.0, 0.5), 541: (-135.0, 0.5), 681: (-119.5, 0.3515625),
    682: (-119.7, 0.3515625), 683: (-119.9, 0.3515625), 811: (-135.0, 1.0 / 3.0), 1081: (-135.0, 0.25),
}  # fmt: skip
"""First angle and step (deg) of lidars in use, by number of beams; others are taken to turn all around."""


@dataclass(frozen=True)
class LayoutProposal:
    """A layout as TOML with its reasons as comments, tried on the log: ``scans`` could be read."""

    toml: str
    scans: int
    reasons: tuple[str, ...]


def propose_layout(path: Path) -> LayoutProposal | None:
    """Return a layout with which the log can be read, None if its lines are no rows of numbers with ranges."""
    header, rows = _read_rows(path)
    if len(rows) < MIN_LINES or rows.shape[1] < MIN_BEAMS:
        return None
    first, beams = _find_ranges(rows)
    others = [at for at in range(rows.shape[1]) if not first <= at < first + beams]
    time = _find_time(rows, others)
    if beams < MIN_BEAMS or time is None:
        return None
    at, unit, wraps_at, period_s = time
    ranges = rows[:, first : first + beams]
    scan, why = _describe_ranges(ranges)
    layout: dict[str, Any] = {"header_lines": header} if header else {}
    layout["base_from_sensor"] = [0.0, 0.0, 0.0]
    layout["time"] = {"column": at + 1, "unit": unit} | ({"wraps_at": wraps_at} if wraps_at else {})
    layout["scan"] = {"first": first + 1, "beams": beams, **scan}
    reasons = [f"column {at + 1} increases by {period_s:.3g} s a line: the time, in {unit}", *why]
    pose = _find_pose(rows, [one for one in others if one != at])
    if pose is not None:
        x, angle_unit = pose
        columns: dict[str, Any] = {"x": x + 1, "y": x + 2, "heading": x + 3}
        layout["pose"] = columns
        reasons.append(f"columns {x + 1} to {x + 3} change smoothly: odometry, x, y and heading")
        if angle_unit == "deg" and not _turned_in_rad(path, layout):
            columns["heading_unit"] = "deg"
            reasons.append("headings of more than two turns in rad: taken as deg")
    elif counters := _find_counters(rows, [one for one in others if one != at]):
        named = " and ".join(str(one + 1) for one in counters)
        reasons.append(
            f"columns {named} are integers that change smoothly: counts of wheels? A table [ticks] with left, right, "
            "ticks_per_turn, wheel_diameter_m and track_m makes them odometry"
        )
    return _try_layout(path, layout, reasons)


def _read_rows(path: Path) -> tuple[int, Floats]:
    """Return the number of header lines, and the numbers (N, C) of the first lines with the most frequent length.

    None of a log with decimal commas.
    """
    lines: list[Floats] = []
    header = values = 0
    for line in iter_lines(path, EXPECTED):
        if has_decimal_comma(line):
            return 0, np.zeros((0, 0))
        words = split_columns(line)[:MAX_COLUMNS]
        try:
            lines.append(np.array(words, dtype=np.float64))
        except ValueError:
            header += not lines
        values += len(words)
        if len(lines) >= MAX_LINES or values > MAX_VALUES:
            break
    widths = Counter(map(len, lines))
    width = widths.most_common(1)[0][0] if widths else 0
    kept = [line for line in lines if len(line) == width]
    return header, np.stack(kept) if kept else np.zeros((0, 0))


def _find_ranges(rows: Floats) -> tuple[int, int]:
    """Return the first column and the number of the longest block whose neighbours are alike and never negative."""
    one, other = rows[:, :-1], rows[:, 1:]
    with np.errstate(invalid="ignore", divide="ignore"):
        both = (one > 0.0) & (other > 0.0) & np.isfinite(one) & np.isfinite(other)
        alike = both & (np.abs(one - other) < NEAR * np.maximum(one, other))
    counts = both.sum(axis=0)
    near = (counts < 3) | (alike.sum(axis=0) >= 0.5 * counts)
    plain: Bools = ~np.asarray((rows < 0.0).any(axis=0))
    edges = np.flatnonzero(~(near & plain[:-1] & plain[1:]))
    starts = np.concatenate([[0], edges + 1])
    ends = np.concatenate([edges, [rows.shape[1] - 1]])
    longest = int(np.argmax(ends - starts))
    return int(starts[longest]), int(ends[longest] - starts[longest] + 1)


def _find_time(rows: Floats, columns: list[int]) -> tuple[int, str, int, float] | None:
    """Return column, unit, range of its counter (0: no wraps) and period (s) of the most regular rising column."""
    found = []
    for at in columns:
        if not np.isfinite(rows[:, at]).all():
            continue
        steps = np.diff(rows[:, at])
        back: Bools = np.asarray(steps < 0.0)
        if back.mean() > 0.02 or (steps <= 0.0).mean() > MAX_REPEATED:
            continue
        middle = float(np.median(steps[steps > 0.0]))
        unit = next((name for name, (low, high) in PERIODS.items() if low <= middle <= high), None)
        if unit is None:
            continue
        wraps = 0
        if back.any():  # a counter of 16 or 32 bits begins again
            wraps = next((2**bits for bits in (16, 32) if rows[:, at].max() < 2**bits), 0)
            if not wraps or (rows[1:][back, at] > 0.1 * wraps).any():
                continue
        irregular = float(np.median(np.abs(steps[steps > 0.0] - middle))) / middle
        scale = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]
        found.append((irregular, at, unit, wraps, middle * scale))
    return min(found)[1:] if found else None


def _describe_ranges(ranges: Floats) -> tuple[dict[str, Any], list[str]]:
    """Return unit, angles, limits and codes of the ranges (N, B), and why."""
    hits = ranges[np.isfinite(ranges) & (ranges > 0.0)]
    with np.errstate(over="ignore"):  # numbers that are no lengths
        middle = float(np.median(hits)) if len(hits) else 1.0
    whole = bool((hits == np.round(hits)).all())
    order = ("mm", "cm", "m") if whole and float(np.percentile(hits, 99)) > 900.0 else ("cm", "m") if whole else ("m",)
    unit = next((one for one in order if MEDIAN_M[0] <= middle * LENGTH_UNITS[one] <= MEDIAN_M[1]), order[-1])
    metres = LENGTH_UNITS[unit]
    values, counts = np.unique(hits, return_counts=True)
    scan: dict[str, Any] = {"unit": unit}
    why = [f"ranges in {unit}: their median is {middle * metres:.1f} m"]
    highest = float(values[-1]) if len(values) else 1.0
    codes = [0.0] if (ranges == 0.0).mean() > 0.05 else []
    if len(values) > 1 and counts[-1] > 0.01 * ranges.size and highest > 1.02 * values[-2]:
        codes.append(highest)
        highest = float(values[-2])
    if codes:
        scan["no_return"] = [int(code) if code == int(code) else code for code in codes]
        share = 100.0 * np.isin(ranges, codes).mean()
        why.append(f"{' and '.join(f'{code:g}' for code in codes)}: {share:.0f} % of the ranges, taken as no return")
    beams = ranges.shape[1]
    first_deg, step_deg = VIEWS.get(beams, (0.0, 360.0 / beams))
    scan |= {"first_angle_deg": first_deg, "step_deg": round(step_deg, 7)}
    scan["range_max_m"] = math.ceil(10.0 * min(highest * metres * 1.001, MAX_COORDINATE_M)) / 10.0
    view = f"{abs(step_deg) * (beams if beams not in VIEWS else beams - 1):.0f} deg"
    why.append(f"{beams} beams: {view} from {first_deg:g} deg on, counter-clockwise; check it")
    return scan, why


def _find_pose(rows: Floats, columns: list[int]) -> tuple[int, str] | None:
    """Return the first of three neighbouring columns that are a smooth path and its heading, and its unit.

    Headings in rad are found first; None if there is no path.
    """
    for unit in ANGLE_UNITS:
        for at in columns:
            if {at + 1, at + 2} <= set(columns) and _is_path(rows[:, at : at + 3], unit):
                return at, unit
    return None


def _is_path(poses: Floats, unit: str) -> bool:
    """Return whether poses (N, 3) are a smooth path with headings in a unit."""
    x, y, heading = poses.T
    if (poses == np.round(poses)).all() or (unit == "rad" and np.abs(heading).max() > MAX_HEADING):
        return False
    turns = np.abs(se2.wrap(np.diff(heading) * ANGLE_UNITS[unit]))
    steps = np.hypot(np.diff(x), np.diff(y))
    smooth = unit == "rad" or (np.ptp(heading) > MAX_HEADING and turns.max(initial=0.0) < MAX_LINE_TURN)
    return bool(smooth and steps.max(initial=0.0) < 2.0 and steps.sum() > 0.1)


def _find_counters(rows: Floats, columns: list[int]) -> list[int]:
    """Return two neighbouring columns of integers that change by little from line to line."""
    for at in columns:
        pair = rows[:, at : at + 2]
        if at + 1 not in columns or not (pair == np.round(pair)).all() or (np.ptp(pair, axis=0) < 10.0).any():
            continue
        if (np.median(np.abs(np.diff(pair, axis=0)), axis=0) < 0.05 * np.ptp(pair, axis=0)).all():
            return [at, at + 1]
    return []


def _try_layout(path: Path, layout: dict[str, Any], reasons: list[str]) -> LayoutProposal | None:
    """Open the log with a layout; reverse the angles if the odometry turns the other way."""
    try:
        turn = _compare_turns(path, layout)
        if turn is not None and turn < -0.5:
            layout["scan"]["clockwise"] = True
            reasons.append("the scans turn against the odometry: the beams are taken as clockwise")
        elif turn is None or turn < 0.5:
            why = "the odometry does not turn measurably" if "pose" in layout else "no odometry is known"
            if turn is not None:
                why = f"the scans turn {turn:.1f} times as much as the odometry (check heading_unit)"
            reasons.append(f"direction not checked: {why}; counter-clockwise assumed, else clockwise = true in [scan]")
        reasons.append("mounting assumed: base_from_sensor (m, m, deg), the lidar at the robot's centre, 0 deg forward")
        scans = len(Columns(str(path), layout))
    except EvalkitError:
        return None
    return LayoutProposal("\n".join(_format_toml(layout, reasons)) + "\n", scans, tuple(reasons))


def _compare_turns(path: Path, layout: dict[str, Any]) -> float | None:
    """Return the rotation of the scans divided by that of the odometry; None without odometry or rotations."""
    if "pose" not in layout:
        return None
    frames = list(Columns(str(path), layout, limit=MAX_LINES).frames())
    stamps = np.array([frame.scan.stamp_ns for frame in frames], dtype=np.int64)
    poses = np.array([frame.odom_from_base.row for frame in frames if frame.odom_from_base is not None])
    first = frames[0].scan
    scans = ScanSample(frame.scan.ranges for frame in frames)
    laser = LaserStream("columns", "columns", "laser", stamps, None, scans, first.angles, first.range_min_m,
                        first.range_max_m)  # fmt: skip
    found = compare_turns(OdometryStream("columns", "odom", "base", stamps, poses), laser)
    return None if found is None else found.scale


def _turned_in_rad(path: Path, layout: dict[str, Any]) -> bool:
    """Return whether the scans turn as much as headings in rad do, to either side, and not as those in deg."""

    def is_alike(unit: str) -> bool:
        turn = _compare_turns(path, {**layout, "pose": {**layout["pose"], "heading_unit": unit}})
        return turn is not None and 0.5 < abs(turn) < 1.5

    return is_alike("rad") and not is_alike("deg")


def _format_toml(layout: dict[str, Any], reasons: list[str]) -> Iterator[str]:
    yield from (f"# {reason}" for reason in reasons)
    for name, content in layout.items():
        if isinstance(content, dict):
            yield f"[{name}]"
            yield from (f"{key} = {json.dumps(value)}" for key, value in content.items())
        else:
            yield f"{name} = {content}"
