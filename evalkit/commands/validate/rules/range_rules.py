"""The rules on the range of questions to a Registration: sizes, scales, headings, and points in special places."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from evalkit.commands.validate.rules.rule import RuleBroken, is_refusal
from evalkit.commands.validate.rules.scenes import CloudPair, clear_pair, distance_m, drawn_pair, format_pose
from evalkit.core.errors import BackendFailed, format_exception
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats

if TYPE_CHECKING:
    from evalkit.commands.validate.rules.registration_fixture import RegistrationFixture

LARGE = 70_000
"""Points of a large cloud: more than 16 bits can count."""

LARGE_M = 0.02
"""Tolerance of the answer for a large cloud in another order: another point of a voxel, another order of a sum."""


def validate_match(match: object) -> Match:
    """The argument if it is a Match with valid values; raises RuleBroken otherwise."""
    if not isinstance(match, Match):
        raise RuleBroken(f"register() returns a {type(match).__name__}, expected an evalkit.Match")
    pose = match.target_from_source
    if not isinstance(pose, Pose) or not np.isfinite(pose.row).all():
        raise RuleBroken(f"target_from_source is {pose!r}, expected a finite evalkit.Pose")
    if not isinstance(match.converged, bool):
        raise RuleBroken(f"converged is {match.converged!r}, expected True or False")
    if match.iterations < 0 or match.inliers < 0 or match.error < 0.0:
        raise RuleBroken(
            f"iterations {match.iterations}, inliers {match.inliers}, error {match.error}: expected none below 0"
        )
    return match


def check_empty(fixture: RegistrationFixture) -> str:
    """Empty clouds give an answer or an exception, not a crash."""
    none, some = Cloud(np.zeros((0, 2))), clear_pair().target
    return _survives(fixture, {"empty source": (some, none), "empty target": (none, some), "both empty": (none, none)})


def check_few_points(fixture: RegistrationFixture) -> str:
    """One, two, coinciding or collinear points give an answer or an exception, not a crash."""
    some = clear_pair().target
    one, two, same = (Cloud(some.points[rows]) for rows in ([0], [0, 1], [3] * 20))
    line = Cloud(np.linspace(-1.0, 1.0, 20)[:, None] * [0.6, 0.8])
    zero = Cloud(np.zeros((20, 2)))
    return _survives(
        fixture,
        {"one point": (some, one), "one point as target": (one, some), "one point each": (one, one),
         "two points": (some, two), "two points as target": (two, some), "20 times the same point": (some, same),
         "20 times the same point as target": (same, some), "collinear points": (line, line),
         "collinear points onto others": (some, line), "points at zero": (zero, zero)},
    )  # fmt: skip


def check_extremes(fixture: RegistrationFixture) -> str:
    """Coordinates from 1 mm to 10 km, far guesses and headings beyond half a turn give an answer or an exception."""
    pair, rng = drawn_pair(np.random.default_rng(fixture.seed), 200, 150), np.random.default_rng(fixture.seed)
    target, source = pair.target.points, pair.source.points
    grid = np.asarray(rng.integers(-40, 40, (150, 2)) * 0.05, dtype=np.float64)
    away = np.array([9e3, -7e3])
    questions = {
        "coordinates of 1 mm": (Cloud(1e-3 * target), Cloud(1e-3 * source)),
        "coordinates of 10 km": (Cloud(2500.0 * target), Cloud(2500.0 * source)),
        "far from the origin": (Cloud(target + away), Cloud(source + away)),
        "points on the borders of cells": (Cloud(grid), Cloud(grid[::-1] + 0.01)),
        "largest coordinates": (Cloud(target * 1e15), Cloud(source)),
    }
    found = _survives(fixture, questions)
    for theta in (math.pi, -math.pi, 1.5 * math.pi, 7.0):
        guess = Pose(pair.guess.x, pair.guess.y, 0.0)
        object.__setattr__(guess, "theta", theta)  # a Pose is wrapped; foreign code may be called by others
        _survives(fixture, {f"a guess of {theta:.3g} rad": (pair.target, pair.source)}, guess)
    return found


def check_large(fixture: RegistrationFixture) -> str:
    """Of 70,000 points all are used: another order gives the same answer, wherever those are that matter."""
    rng = np.random.default_rng(fixture.seed)
    for targets, sources in ((LARGE, 80), (80, LARGE)):
        pair = drawn_pair(rng, targets, sources)
        shuffled = CloudPair(
            Cloud(rng.permutation(pair.target.points)), Cloud(rng.permutation(pair.source.points)), pair.truth,
            pair.guess,
        )  # fmt: skip
        _require_same(fixture, pair, shuffled, f"{targets} targets and {sources} sources, in another order")
    pair = drawn_pair(rng, 120, 80)
    far = _ring(rng, LARGE)
    for name, near in (("target", pair.target.points), ("source", pair.source.points)):
        clouds = [Cloud(np.concatenate(parts)) for parts in ((near, far), (far, near))]
        first, last = (replace(pair, target=one) if name == "target" else replace(pair, source=one) for one in clouds)
        _require_same(fixture, first, last, f"{name} with {LARGE} far points before the near ones, not after them")
    return f"{LARGE} targets, and as many sources, give the same answer in another order"


def _require_same(fixture: RegistrationFixture, one: CloudPair, other: CloudPair, what: str) -> None:
    """Raise RuleBroken if two forms of one question have other answers."""
    matches = []
    for each in (one, other):
        fixture.note_progress()  # for a slow back end, as in emulation
        matches.append(fixture.shared.register(each.target, each.source, each.guess))
    first, second = matches
    off = distance_m(first.target_from_source, second.target_from_source)
    if off > LARGE_M or abs(first.inliers - second.inliers) > 0.02 * max(first.inliers, 50):
        raise RuleBroken(
            f"{what}: {format_pose(second.target_from_source)} by {second.inliers} pairs instead of "
            f"{format_pose(first.target_from_source)} by {first.inliers}"
        )


def _ring(rng: np.random.Generator, count: int) -> Floats:
    """Points 40 to 60 m away, in all directions."""
    bearing, away = rng.uniform(-np.pi, np.pi, count), rng.uniform(40.0, 60.0, count)
    return np.stack([away * np.cos(bearing), away * np.sin(bearing)], axis=1)


def _survives(
    fixture: RegistrationFixture,
    questions: Mapping[str, tuple[Cloud, Cloud]],
    guess: Pose = Pose(0.1, 0.2, 0.3),  # noqa: B008
) -> str:
    """A valid answer or a refusal passes; the runner detects a crash."""
    refused = []
    for name, (target, source) in questions.items():
        try:
            match = fixture.shared.register(target, source, guess)
        except Exception as error:
            if not is_refusal(error):
                instead = "" if isinstance(error, BackendFailed) else "; return the guess with converged=False"
                raise RuleBroken(f"{name}: {format_exception(error)}{instead}") from error
            refused.append(f"{name}: {format_exception(error)}")
            continue
        try:
            validate_match(match)
        except RuleBroken as observation:
            raise RuleBroken(f"{name}: {observation}") from observation
    note = "; in a run, an exception ends the run" if refused else ""
    return "; ".join(refused) + note if refused else f"answers: {', '.join(questions)}"


RANGE_RULES = (check_empty, check_few_points, check_extremes, check_large)
