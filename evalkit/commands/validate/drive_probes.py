"""Drawn drives to two odometries, run in a separate process: plain values in, JSON values out.

Each drive is short and lacks something: returns, wheel odometry, a central mounting. Both sides get the same frames.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import compress
from typing import Any

import numpy as np

from evalkit.commands.validate.equivalence.diagnosis import EXPLAINED
from evalkit.commands.validate.equivalence.divergence import Divergence
from evalkit.commands.validate.equivalence.lockstep import ComparedBackend
from evalkit.commands.validate.equivalence.margins import (
    FLOAT32,
    FLOAT32_ROUNDOFF,
    TIE_ROUNDINGS,
    GeometryScale,
    Margin,
    MarginChoice,
    float32_margin,
)
from evalkit.commands.validate.equivalence.mistaken_frames import (
    mistaken_frames,
    mistaken_trajectories,
    skipped_scans,
)
from evalkit.commands.validate.rules import scenes
from evalkit.commands.validate.rules.scenes import drive, without_hits
from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.errors import format_exception
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.execution.sandbox import note_place
from evalkit.execution.task import Result
from evalkit.io.json_values import replace_non_finite
from evalkit.odometry import frontend
from evalkit.odometry.run_odometry import run_odometry

SCANS, LEVER_M, COPIES = 12, 4.0, 4
"""Scans of a drive; the lever (m) at which turns are measured; copies perturbed by rounding."""


LIKELY = 0.3
"""The share of a difference that a likely mistake may leave."""


@dataclass(frozen=True, eq=False)
class Driven:
    """A drive with the poses (N, 3) of both sides, nan without an answer; ``failure``: why the second one stopped."""

    family: str
    what: str
    frames: Sequence[Frame]
    a: Floats
    b: Floats
    failure: str
    rounding_m: float

    def apart_m(self) -> Floats:
        """The distances (N,) of the second side's poses from the reference's; inf if one is missing."""
        return distances_m(self.a, self.b)


def compare_drives(
    sides: tuple[ComparedBackend, ComparedBackend], seed: int, parsed: dict[str, MarginChoice]
) -> Result:
    """The comparison of both odometries on drawn drives under every margin, in the form of drawn questions."""
    driven: list[Driven] = []
    unrepeated = 0
    for family, what, frames in draw_drives(seed):
        note_place(f"drawn drives, {family}: {what}")
        a, failure = run_frames(sides[0], frames)
        if failure:  # what the reference refuses is no question
            continue
        b, failure = run_frames(sides[1], frames)
        again, _ = run_frames(sides[1], frames) if not driven else (b, "")
        unrepeated += not np.array_equal(b, again, equal_nan=True)
        driven.append(Driven(family, what, frames, a, b, failure, _rounding_m(sides[0], frames, a, parsed)))
    cause = _find_cause(sides[0], driven)
    found = {name: _summary(driven, margin, cause) for name, margin in parsed.items()}
    return found | {"seed": seed, "unrepeated": unrepeated}


def draw_drives(seed: int) -> Iterator[tuple[str, str, tuple[Frame, ...]]]:
    """Drives of a seed: family, description, frames."""
    rng = np.random.default_rng([seed, 4])

    def draw(**options: Any) -> tuple[Frame, ...]:
        return drive(SCANS, float(rng.uniform(0.2, 0.6)), float(rng.uniform(-0.6, 0.6)), **options).frames

    yield "drive", "a drive", draw()
    yield "drive", "a drive with wheels 10 % too large", draw(odometry_gain=1.1)
    yield (
        "mounting",
        "a lidar mounted off the centre",
        draw(base_from_sensor=Pose(*rng.uniform(-1.0, 1.0, 3) * (0.3, 0.2, 3.0))),
    )
    yield "beams", "all beams at once", draw(sweeping=False)
    first = float(rng.uniform(-2.5, -2.0))
    sector = tuple(scenes.sector(one, first, first + 4.5) for one in draw(sweeping=False))
    yield "beams", f"a lidar of 4.5 rad from {first:.3g} rad on", sector
    for value, name in ((np.inf, "no return"), (np.nan, "invalid")):
        holes = [np.flatnonzero(rng.random(360) < 0.3) for _ in range(SCANS)]
        frames = zip(draw(), holes, strict=True)
        yield "ranges", f"30 % of the ranges {name}", tuple(_with_holes(one, rows, value) for one, rows in frames)
    gap = set(rng.choice(np.arange(2, SCANS - 1), 2, replace=False).tolist())
    yield (
        "returns",
        "two scans without returns",
        tuple(without_hits(one) if number in gap else one for number, one in enumerate(draw())),
    )
    yield (
        "wheel odometry",
        "two scans without wheel odometry",
        tuple(
            replace(one, odom_from_base=None, start_from_end=None) if number in gap else one
            for number, one in enumerate(draw())
        ),
    )
    yield "wheel odometry", "none", draw(odometry_gain=None)


def run_frames(side: ComparedBackend, frames: Iterable[Frame]) -> tuple[Floats, str]:
    """The poses (N, 3) of a new odometry, nan without an answer, and the exception that ended it, or ""."""
    poses = np.full((SCANS, 3), np.nan)
    try:
        odometry = frontend.make_odometry(side.spec, side.parameters)
        for index, step in enumerate(run_odometry(odometry, frames)):
            if step.estimate is not None:
                poses[index] = step.estimate.pose.row
    except Exception as error:  # noqa: BLE001 - a third party's exception is a difference to report
        return poses, format_exception(error)
    return poses, ""


def distances_m(a: Floats, b: Floats) -> Floats:
    """The distances (N,) of poses (N, 3), turns measured at ``LEVER_M``; inf where one side alone has no answer."""
    away = se2.between(a, b)
    apart = np.hypot(away[:, 0], away[:, 1]) + LEVER_M * np.abs(away[:, 2])
    missing = np.isnan(a[:, 0]), np.isnan(b[:, 0])
    apart = np.where(missing[0] | missing[1], np.inf, apart)
    return np.where(missing[0] & missing[1], 0.0, apart)


def _with_holes(frame: Frame, rows: Ints, value: float) -> Frame:
    ranges = frame.scan.ranges.copy()
    ranges[rows] = value
    return replace(frame, scan=replace(frame.scan, ranges=ranges))


def _rounding_m(
    side: ComparedBackend, frames: Sequence[Frame], right: Floats, parsed: dict[str, MarginChoice]
) -> float:
    """The largest effect of ranges perturbed by rounding to single precision on the reference's own poses."""
    if FLOAT32 not in parsed.values():
        return 0.0
    rng, largest = np.random.default_rng(0), 0.0
    for _ in range(COPIES):
        changed = []
        for one in frames:
            reach = TIE_ROUNDINGS * FLOAT32_ROUNDOFF * float(np.max(one.scan.ranges, where=one.scan.hits, initial=0.0))
            ranges = one.scan.ranges + rng.uniform(-reach, reach, len(one.scan.ranges))
            changed.append(replace(one, scan=replace(one.scan, ranges=ranges)))
        apart = distances_m(right, run_frames(side, changed)[0])
        largest = max(largest, float(apart.max(initial=0.0)))
    return largest


def _limit_m(one: Driven, margin: MarginChoice) -> float:
    known = margin
    if isinstance(known, str):
        scan = one.frames[0].scan
        known = float32_margin(GeometryScale(scan.range_max_m, len(scan.ranges), 1.0))
        return max(known.metres + LEVER_M * known.radians, 3.0 * one.rounding_m)
    return known.metres + LEVER_M * known.radians


def _find_cause(side: ComparedBackend, driven: Sequence[Driven]) -> str:
    """The mistake with which the reference gives the other side's poses on a drive that differs; "" if none."""
    for one in sorted(driven, key=lambda one: -float(one.apart_m().max(initial=0.0))):  # the plainest one first
        apart = one.apart_m()
        whole = float(apart.max(initial=0.0))
        if one.failure or not np.isfinite(whole) or whole < 1e-6:
            continue
        best, likely = LIKELY, ""
        for what, rows in _mistaken_poses(side, one):
            left = float(distances_m(rows, one.b).max()) / whole
            if left < EXPLAINED:
                return what
            if left < best:
                best, likely = left, f"most like: {what}"
        if likely:
            return likely
    return ""


def _mistaken_poses(side: ComparedBackend, one: Driven) -> Iterator[tuple[str, Floats]]:
    """The poses (N, 3) that the reference has with each mistake."""
    yield from mistaken_trajectories(one.a)
    for what, last in skipped_scans(len(one.frames)):
        kept = np.unique(last)
        rows, _ = run_frames(side, [one.frames[number] for number in kept])
        yield what, rows[np.searchsorted(kept, last)]
    for what, change in mistaken_frames():
        note_place(f"drawn drives, hypothesis: {what}")
        rows, failure = run_frames(side, map(change, one.frames))
        if not failure:
            yield what, rows


def _summary(driven: Sequence[Driven], margin: MarginChoice, cause: str) -> dict[str, Any]:
    families: dict[str, dict[str, Any]] = {}
    beyond, unanswered, first = 0, 0, None
    for family in dict.fromkeys(one.family for one in driven):
        members = [one for one in driven if one.family == family]
        differs = [bool(one.failure or (one.apart_m() > _limit_m(one, margin)).any()) for one in members]
        wrong = list(compress(members, differs))
        missing = sum(bool(one.failure) for one in members)
        equal = (one for one, other in zip(members, differs, strict=True) if not other)
        apart = [(float(one.apart_m().max(initial=0.0)), _limit_m(one, margin)) for one in equal]
        largest_m, allowed_m = max(apart, key=lambda each: each[0] / each[1], default=(0.0, 0.0))
        beyond, unanswered = beyond + len(wrong), unanswered + missing
        divergence = None if not wrong else replace_non_finite(asdict(_divergence(wrong[0], margin, cause)))
        families[family] = {
            "asked": len(members), "wrong": len(wrong), "unanswered": missing, "fields": {}, "examples": {},
            "what": wrong[0].what if wrong else "", "first": divergence,
            "largest_m": largest_m, "allowed_m": allowed_m, "excepted": 0,
        }  # fmt: skip
        first = first or divergence
    widest = Margin() if isinstance(margin, str) else margin
    return {
        "equivalent": not beyond, "level": "answers", "n": len(driven), "questions": len(driven),
        "unanswered": unanswered, "beyond_rounding": beyond, "first": first, "classes": {}, "intervals": [],
        "fields": {}, "margin": asdict(widest), "families": families, "where": cause,
    }  # fmt: skip


def _divergence(one: Driven, margin: MarginChoice, cause: str) -> Divergence:
    if one.failure:
        return Divergence(1, one.family, None, "answer", "different", f"B {one.failure}")
    apart = one.apart_m()
    scan = int(np.argmax(apart > _limit_m(one, margin))) + 1
    rounded = isinstance(margin, Margin) and float(apart.max()) < max(3.0 * one.rounding_m, 1e-6)
    what = cause or f"poses {float(apart.max()):.2g} m apart at most, turns at {LEVER_M:g} m"
    return Divergence(scan, one.family, None, "pose", "precision" if rounded else "different", what)
