"""What a comparison says of a recording before it runs: problems, the robot's own body in view, skewed scans."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from evalkit.plugins.parameters import Value
from evalkit.plugins.specs import Choice
from evalkit_datasets.commands.inspect.finding import InspectionFinding
from evalkit_datasets.commands.inspect.inspector import Inspection
from evalkit_datasets.commands.inspect.lidar_findings import SET_BACK, check_body
from evalkit_datasets.commands.inspect.lidar_stats import LidarStats
from evalkit_datasets.commands.inspect.odometry_findings import DIRECTION, STAMPS, is_apart
from evalkit_datasets.commands.inspect.turn_comparison import SHIFT_STEP_S
from evalkit_datasets.parsing.range_minimum import RANGE_MIN

PROBLEM = "problem"  # the name of a choice that sets nothing

STATED_BY: Mapping[str, frozenset[str]] = {
    DIRECTION: frozenset({"base_from_sensor", "fields"}),
    STAMPS: frozenset({"stamp_shift_s"}),
    SET_BACK: frozenset({"start", "limit"}),
}
"""Parameters of a user who has read a finding, by what it is about: it is not repeated."""

MIN_SKEW_M = 0.1
"""Motion within a scan that moves points by less, at the median range, is not reported: two usual cells."""


def repeat_problems(recording: Inspection, given: Mapping[str, Value]) -> Iterator[Choice]:
    """Say before a comparison what makes its numbers wrong, such as ranges in another unit."""
    said: set[str] = set()  # the same odometry may come as messages and as tf
    for finding in (one for one in recording.findings if one.level == "problem" or one.about in (DIRECTION, STAMPS)):
        unused = finding.about.startswith("odometry ") and given.get("odometry") == "none"
        stated = not STATED_BY.get(finding.about, frozenset()).isdisjoint(given)
        if not unused and not stated and finding.what not in said:
            yield _repeat(finding)
        said.add(finding.what)


def repeat_body(lidar: LidarStats, given: Mapping[str, Value]) -> Iterator[Choice]:
    """Say before a comparison that the lidar sees the robot itself, unless its ranges are left out already."""
    body = lidar.returns.body
    if body is not None and float(str(given.get(RANGE_MIN.name, 0.0))) < body.range_min_m:
        yield from map(_repeat, check_body(lidar))


def repeat_sweep(recording: Inspection, lidar: LidarStats, given: Mapping[str, Value]) -> Iterator[Choice]:
    """Say before a comparison that scans may be skewed by the motion within them, where that is large and not known.

    If the turns of the odometry show that scans are taken at their stamps, they are not; if they show the middle of a
    revolution, a finding on the stamps says so.
    """
    if "sweep_s" in given or given.get("odometry") == "none" or not lidar.may_be_swept:
        return
    sweep_s, known_s = lidar.revolution_s, 0.5 * lidar.revolution_s - SHIFT_STEP_S
    turns = recording.turns.values()
    if any(turn.is_shifted or turn.shift_interval[1] < known_s for turn in turns):
        return
    wheels = [one for one in recording.odometries if one.like_wheels and one.unit is None and not is_apart(lidar, one)]
    turned_deg = sweep_s * max((one.fastest_deg_s for one in wheels), default=0.0)
    moved_m = sweep_s * max((one.fastest_m_s for one in wheels), default=0.0)
    if max(moved_m, math.radians(turned_deg) * lidar.returns.median_m) < MIN_SKEW_M:
        return
    what = (
        f"{lidar.topic}: its time_increment is 0 or less, and no turn shows whether all beams are fired at once: if it "
        f"turns once a scan, the robot moves by up to {moved_m:.2f} m and {turned_deg:.0f} deg within a scan"
    )
    yield Choice(PROBLEM, None, f"warning: {what}; then use --set sweep_s={sweep_s:.2g}", warns=True)


def _repeat(finding: InspectionFinding) -> Choice:
    advice = f"; {finding.advice}" if finding.advice else ""
    return Choice(PROBLEM, None, f"{finding.level}: {finding.about}: {finding.what}{advice}", warns=True)
