"""Findings on the lidars of a recording: times, clocks, units, ranges, and the robot's own body in view."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from evalkit_datasets.commands.inspect.finding import (
    FIELDS,
    MAX_OFFSET_S,
    InspectionFinding,
    format_count,
    note,
    problem,
    warning,
)
from evalkit_datasets.commands.inspect.lidar_stats import LidarStats
from evalkit_datasets.commands.inspect.timing import ClockOffset, StreamTiming
from evalkit_datasets.readers import carmen

MAX_DRIFT_PPM = 500.0
MAX_OFFSET_RANGE_S = 0.05
HANDLED = "handled by the reader"
SET_BACK = "clock set back"
LOG_LINES = "laser lines"

MAX_MEDIAN_M, MIN_MEDIAN_M = 200.0, 0.02
"""Median range of a scan beyond which the unit is doubted."""

MAX_VIEW_DEG = 400.0
"""A wider field of view is doubted: revolutions may overlap a little."""

MAX_BEYOND = 0.5
"""Share of finite ranges beyond the declared maximum from which the unit is doubted."""

MIN_RATE_HZ, MAX_RATE_HZ, MIN_RATED = 0.02, 500.0, 10
"""Scans per second beyond which the unit of time is doubted, of at least so many scans."""

MAX_HITS_BESIDE = 0.05
"""Ranges beyond the maximum beside a larger share of hits may be a code for no return."""

SURE_MILLIMETRES = 2000.0
"""Median range read as m from which it is in mm: in cm it would be 20 m, that of no room or hall."""

UNIT_REMEDIES = {
    "rosbag": {
        "too long": f"give --set '{FIELDS} range_unit=mm'",
        "too short": "record metres",
        "angles": f"give --set '{FIELDS} angle_unit=deg'",
        "times": "use the time of recording",
    },
    "columns": {
        "too long": 'write unit = "mm" in [scan] of the layout',
        "too short": 'write unit = "m" in [scan] of the layout',
        "angles": "check step_deg in [scan] of the layout",
        "times": "check unit in [time] of the layout: s, ms, us or ns",
    },
}
"""How units of a lidar are stated, by reader; other formats define them."""

SWEEP_REMEDIES = {
    "rosbag": "give --set sweep_s={sweep_s}",
    "columns": "write turned_s = {sweep_s} in [scan] of the layout",
}
"""How the time of a sweep is stated, by reader; other formats have none."""

MAX_SECTORS = 3
"""Sectors of the robot's own body that are listed."""


def check_lidars(lidars: Sequence[LidarStats], reader: str) -> Iterator[InspectionFinding]:
    """Report what is wrong or notable with the scans of each lidar."""
    for lidar in lidars:
        yield from _check_units(lidar, reader)
        yield from _check_times(lidar)
        yield from _check_sweep(lidar, reader)
        yield from _check_ranges(lidar)
        yield from check_body(lidar)
    if len(lidars) > 1:
        names = ", ".join(lidar.topic for lidar in lidars)
        yield note("lidars", f"{len(lidars)} lidars: {names}; a run uses one of them", "select one with topic")


def _check_times(lidar: LidarStats) -> Iterator[InspectionFinding]:
    found, about = lidar.timing, lidar.topic
    if not found.usable:
        advice = "the reader keeps the first of equal stamps; record the time of each scan"
        if lidar.kind == LOG_LINES:
            advice = (
                "the reader places the scans one second apart in the order of the file: times and speeds are unknown"
            )
        yield problem(about, f"{found.repeated} of {found.count} scans have the stamp of another scan", advice)
    elif found.repeated or found.backwards:
        what = f"stamps decrease {found.backwards} times, {found.repeated} are repeated"
        yield warning(about, what, "the reader sorts the scans and keeps the first of equal stamps")
    if lidar.clock is not None and lidar.kind != LOG_LINES:
        yield from _check_steps_back(found, about)
    if found.gap_count:
        longest = found.gaps[0]
        what = f"{format_count(found.gap_count, 'gap')}, the longest {longest.length_s:.2f} s at {longest.at_s:.1f} s"
        yield InspectionFinding("warning" if longest.length_s > 1.0 else "note", about, what)
    if found.period_s and found.jitter_s > 0.2 * found.period_s:
        yield note(about, f"the period of {found.period_s:.3f} s has a jitter of {found.jitter_s:.3f} s")
    if lidar.unstamped:
        yield warning(about, f"{lidar.unstamped} scans have no stamp; the time of recording is used")
    if lidar.clock is not None:
        yield from _check_clock(lidar.clock, about, lidar.kind == LOG_LINES)


def _check_sweep(lidar: LidarStats, reader: str) -> Iterator[InspectionFinding]:
    """Report a time from the first beam to the last that is missing, or that cannot be right."""
    period_s = lidar.timing.period_s
    if lidar.may_be_swept:
        what = f"time_increment is 0 or less: the motion within the scans, {period_s:.2g} s apart, is not corrected"
        mend = f"set sweep_s = {lidar.revolution_s:.2g} of the reader, and mend its driver"
        yield warning(lidar.topic, what, f"if the lidar turns once a scan, {mend}")
    if lidar.is_sweep_too_long and lidar.timing.rate_hz <= MAX_RATE_HZ and reader in SWEEP_REMEDIES:
        what = f"a scan takes {lidar.sweep_s:.3g} s by its time_increment, but the next begins after {period_s:.2g} s"
        sweep_s = f"{lidar.revolution_s:.2g}"
        advice = f"if the lidar turns once a scan, {SWEEP_REMEDIES[reader].format(sweep_s=sweep_s)}"
        yield problem(lidar.topic, what, advice, ("sweep_s", float(sweep_s)))


def _check_steps_back(found: StreamTiming, about: str) -> Iterator[InspectionFinding]:
    """Report a clock that was set back while the recorder's went on: the times of two parts overlap."""
    step = found.step_back
    if step is None or not found.usable:
        return
    count = "once" if found.steps_back == 1 else f"{found.steps_back} times"
    where = f"{step.length_s:.2f} s at {step.at_s:.1f} s ({count})"
    back = f"the stamps of {about} go back by {where} while the recording goes on"
    before, behind = step.before, found.count - found.repeated - step.behind
    parts = [f"--set limit={step.before}"] * (before > 0) + [f"--set start={step.behind}"] * (behind > 0)
    part, mend = f"take the part before it or behind it: {' or '.join(parts)}", None
    if found.steps_back > 1 or not parts:
        part = "mend the clock, and record again"
    else:
        mend = ("limit", step.before) if before >= behind else ("start", step.behind)
    yield problem(SET_BACK, f"{back}: in the order of their stamps, scans of different places mix", part, mend)


def _check_clock(found: ClockOffset, about: str, log: bool) -> Iterator[InspectionFinding]:
    if log:
        if found.max_s - found.min_s > MAX_OFFSET_RANGE_S:
            what = (
                f"ipc and logger stamps differ by {found.min_s:.2f} to {found.max_s:.2f} s: the offset is not constant"
            )
            yield note(about, what, "ground truth must use the ipc stamp, as the reader does")
        return
    if abs(found.median_s) > MAX_OFFSET_S:
        side = "ahead of" if found.median_s > 0 else "behind"
        what = f"header stamps are {abs(found.median_s):.3f} s {side} the time of recording"
        advice = "two clocks" if found.median_s > 0 else "latency, or two clocks"
        yield InspectionFinding(
            "warning" if found.median_s > 0 else "note",
            about,
            what,
            f"{advice}; do not combine with stamps of another clock",
        )
    if found.step_s:
        what = f"its clock steps by {found.step_s:+.2f} s against the recorder's at {found.step_at_s:.1f} s"
        yield warning(about, what, "a clock that was set, or a recorder that was held up")
    elif abs(found.drift_ppm) > MAX_DRIFT_PPM:
        yield warning(about, f"its clock drifts from the recorder's by {found.drift_ppm:.0f} ppm")


def _check_units(lidar: LidarStats, reader: str) -> Iterator[InspectionFinding]:
    """Check whether ranges and times have the order of magnitude of a lidar's."""
    middle, rate, beyond = lidar.returns.median_m, lidar.timing.rate_hz, lidar.returns.beyond_maximum
    remedies = UNIT_REMEDIES.get(reader, {})
    if middle > MAX_MEDIAN_M or beyond > MAX_BEYOND:
        far = f"{100 * beyond:.0f} % of the ranges lie beyond the maximum of {lidar.range_max_m or 0.0:g} m"
        what = f"the median range is {middle:.0f} m" if beyond <= MAX_BEYOND else far
        read_m = lidar.returns.beyond_m if lidar.returns.hits < MAX_HITS_BESIDE else middle
        mend = ("fields", "range_unit=mm") if read_m > SURE_MILLIMETRES else None
        what = f"{what}: millimetres or centimetres taken for metres?"
        yield problem(lidar.topic, what, remedies.get("too long", ""), mend)
    elif 0.0 < middle < MIN_MEDIAN_M:
        what = f"the median range is {1e3 * middle:.1f} mm: metres taken for millimetres?"
        yield problem(lidar.topic, what, remedies.get("too short", ""))
    if abs(lidar.step_deg) * (lidar.beams - 1) > MAX_VIEW_DEG:
        what = f"{lidar.beams} beams {abs(lidar.step_deg):.3g} deg apart are more than a full turn"
        what, mend = f"{what}: degrees taken for radians?", ("fields", "angle_unit=deg")
        yield problem(lidar.topic, what, remedies.get("angles", ""), mend)
    if lidar.timing.usable and lidar.timing.count > MIN_RATED and not MIN_RATE_HZ <= rate <= MAX_RATE_HZ:
        what = f"{rate:.3g} scans per second: stamps in another unit than they are read in?"
        yield problem(lidar.topic, what, remedies.get("times", ""))


def _check_ranges(lidar: LidarStats) -> Iterator[InspectionFinding]:
    found, about = lidar.returns, lidar.topic
    for code in found.codes:
        value = f"{code.high_m:g}" if code.low_m == code.high_m else f"{code.low_m:g} to {code.high_m:g}"
        what = f"{value} m means no return: {100 * code.share:.1f} % of the beams ({code.why})"
        advice = advise_on_code(code.low_m, lidar.range_max_m)
        yield InspectionFinding("note" if advice == HANDLED else "warning", about, what, advice)
    if found.zero > 0.005:
        yield note(about, f"{100 * found.zero:.1f} % of the ranges are 0", "the reader marks them as invalid")
    if found.nan + found.negative > 0.005:
        yield note(about, f"{100 * (found.nan + found.negative):.1f} % of the ranges are nan or negative")
    if found.at_maximum > 0.001:
        what = f"{100 * found.at_maximum:.1f} % of the ranges are the maximum itself, {lidar.range_max_m:g} m"
        yield note(about, what, "the reader marks them as no return")
    if found.beyond_maximum > 0.001:
        what = f"{100 * found.beyond_maximum:.1f} % of the ranges lie beyond the maximum of {lidar.range_max_m:g} m"
        yield note(about, what, "the reader marks them as no return")
    if len(found.beams) > 1:
        yield warning(about, f"the number of beams changes: {', '.join(map(str, found.beams[:6]))}")
    if found.hits < 0.5:
        advice = (
            "a point cloud: its band of heights may miss the walls, or its unit is not m" if found.nan > 0.5 else ""
        )
        yield warning(about, f"only {100 * found.hits:.0f} % of the beams are hits", advice)
    if found.repeated > 0:
        yield warning(about, f"{found.repeated} scans are identical to the previous one")
    if found.still > 0.95:
        yield note(
            about, "the robot stands still: scans do not change within a second", "suitable for noise, not for drift"
        )


def check_body(lidar: LidarStats) -> Iterator[InspectionFinding]:
    """Warn of beams that hit the robot itself."""
    body = lidar.returns.body
    if body is None:
        return
    listed = [f"{first:.0f} to {last:.0f}" for first, last in body.sectors_deg[:MAX_SECTORS]]
    sectors = ", ".join([*listed, *(["..."] if len(body.sectors_deg) > MAX_SECTORS else [])])
    ranges = " to ".join(dict.fromkeys([f"{body.nearest_m:.2f}", f"{body.farthest_m:.2f}"]))
    beams = f"{100 * body.share:.0f} % of the beams ({sectors} deg)"
    what = f"{beams} always have the same range, {ranges} m: the robot's own body?"
    mend = f"set range_min_m = {body.range_min_m:g} (m; of a text log in [scan] of its layout)"
    yield warning(lidar.topic, what, f"{mend}: all methods then leave them out, with all else that is nearer")


def is_default_code(low_m: float) -> bool:
    """Return whether the CARMEN reader treats this value as no return by default."""
    return bool(np.isclose(low_m, (*carmen.CODES_M, *carmen.MILLIMETRE_CODES_M), atol=1e-6).any())


def advise_on_code(low_m: float, range_max_m: float | None) -> str:
    """Return what to do about a no-return code."""
    if range_max_m is not None:
        return "the driver should send inf; the reader treats it as a hit"
    return (
        HANDLED
        if low_m >= 50.0 or is_default_code(low_m)
        else f"set range_max_m = {math.floor(low_m * 100) / 100:g} (m)"
    )
