"""Drawn questions to two registrations, by family: sizes, scales, headings, points, limits, edges and parameters.

A seed decides all of them, so that an implementation cannot be tuned to them. Every question goes to both sides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from evalkit.commands.validate.equivalence.lockstep import ComparedBackend, Question
from evalkit.commands.validate.rules.scenes import drawn_pair
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.plugins.parameters import Parameter, Value

Changes = Mapping[str, Value]
Shared = Mapping[str, tuple[Parameter, Value]]
"""The parameters of the method that both sides have, and their values, by name."""

SIZES = (1, 2, 3, 4, 5, 7, 8, 9, 15, 17, 31, 33, 63, 64, 65, 127, 129, 255, 256, 257, 511, 513, 1023, 1025, 2049)
QUICK_SIZES = (1, 2, 3, 5, 8, 33, 129, 257, 1025)
LARGE = ((4097, 60), (60, 4097), (65_537, 40), (40, 65_537), (70_000, 60))

MAX_FLOAT32_REACH_M = 150.0
"""Coordinates (m) beyond which single precision cannot hold a point to 0.01 mm: a question for double precision."""


@dataclass(frozen=True, eq=False)
class DrawnQuestion:
    """A question with its family, a description, and the parameters that both sides are changed by.

    ``ties``: the same question with a tie broken the other way; the answer to either is right.
    """

    family: str
    what: str
    question: Question
    changes: Changes = field(default_factory=dict)
    ties: tuple[Question, ...] = ()


def draw_questions(seed: int, a: ComparedBackend, b: ComparedBackend, quick: bool) -> Iterator[DrawnQuestion]:
    """All questions of a seed to two registrations; ``quick``: fewer sizes."""
    rng = np.random.default_rng([seed, 2])
    shared = shared_parameters(a, b)
    yield from _clear(rng)
    yield from _limits(rng, shared)
    yield from _edges(rng)
    yield from _points(rng, shared)
    yield from _headings(rng)
    yield from _scales(rng, shared)
    yield from _sizes(rng, quick)
    yield from _ties(rng)
    yield from _parameters(rng, shared)


def shared_parameters(a: ComparedBackend, b: ComparedBackend) -> dict[str, tuple[Parameter, Value]]:
    """The parameters of the method that both sides declare with one type, by name, and their values."""
    own = {one.name: one for one in b.spec.parameters}
    return {
        one.name: (_intersect_bounds(one, own[one.name]), a.parameters.get(one.name, one.default))
        for one in a.spec.parameters
        if one.name in own and type(one.default) is type(own[one.name].default) and one.name != "trace"
    }


def _intersect_bounds(one: Parameter, other: Parameter) -> Parameter:
    return replace(one, low=max(one.low, other.low), high=min(one.high, other.high))


def _ask(
    family: str, what: str, target: Floats, source: Floats, guess: Pose, changes: Changes | None = None
) -> DrawnQuestion:
    return DrawnQuestion(family, what, Question(1, family, Cloud(target), Cloud(source), guess), changes or {})


def _clear(rng: np.random.Generator) -> Iterator[DrawnQuestion]:
    """Well separated points and a guess within 2 cm: any neighbour search and any outlier rule give the same pairs."""
    for _ in range(4):
        target, source, near = _draw_separated(rng)
        yield _ask("clear", "well separated points", target, source, near)


def _draw_separated(rng: np.random.Generator) -> tuple[Floats, Floats, Pose]:
    grid = np.stack(np.meshgrid(np.arange(-5.0, 5.0), np.arange(-4.0, 4.0)), axis=-1).reshape(-1, 2)
    target = grid + rng.uniform(-0.2, 0.2, grid.shape)
    source = target[rng.permutation(len(target))[:50]] + rng.uniform(-0.004, 0.004, (50, 2))
    return target, source, Pose.of(rng.uniform(-1.0, 1.0, 3) * [0.01, 0.01, 0.001])


def _sizes(rng: np.random.Generator, quick: bool) -> Iterator[DrawnQuestion]:
    sizes = QUICK_SIZES if quick else SIZES
    shapes = [*((150, n) for n in sizes), *((n, 60) for n in sizes), *LARGE]
    pairs = [
        (f"{targets} targets, {sources} sources", drawn_pair(rng, targets, sources)) for targets, sources in shapes
    ]
    for what, pair in pairs:
        yield _ask("sizes", what, pair.target.points, pair.source.points, pair.guess)
    none, last = np.zeros((0, 2)), pairs[-1][1]
    for what, target, source in (
        ("no source", last.target.points[:99], none),
        ("no target", none, last.source.points[:9]),
    ):
        yield _ask("sizes", what, target, source, last.guess)


def _scales(rng: np.random.Generator, shared: Shared) -> Iterator[DrawnQuestion]:
    lengths = {name: value for name, (one, value) in shared.items()
               if one.unit.split(" ")[0] == "m" and isinstance(value, float)}  # fmt: skip
    for factor in (1e-3, 0.03, 20.0, 2500.0):
        pair = drawn_pair(rng, 150, 120)
        guess = Pose(factor * pair.guess.x, factor * pair.guess.y, pair.guess.theta)
        scaled = {name: factor * value for name, value in lengths.items()}
        for changes in ({}, scaled) if scaled else ({},):
            what = f"coordinates of {4 * factor:g} m" + (f", lengths {factor:g} times" if changes else "")
            yield _ask("scales", what, factor * pair.target.points, factor * pair.source.points, guess, changes)
    for away in (np.array([60.0, -45.0]), np.array([105.0, -80.0]), np.array([9e3, -7e3])):
        pair = drawn_pair(rng, 150, 120)
        moved = Pose(pair.guess.x + away[0], pair.guess.y + away[1], pair.guess.theta)
        what = f"target {float(np.hypot(*away)):.0f} m from the origin"
        yield _ask("scales", what, pair.target.points + away, pair.source.points, moved)
        target, source, near = _draw_separated(rng)  # whose pairs no rounding changes
        moved = Pose(near.x + away[0], near.y + away[1], near.theta)
        yield _ask("scales", f"{what}, well separated points", target + away, source, moved)


def _headings(rng: np.random.Generator) -> Iterator[DrawnQuestion]:
    for theta in (math.pi, -math.pi, 0.5 * math.pi, -0.5 * math.pi, 2.5, -2.5):
        pair = drawn_pair(rng, 150, 120)
        truth = Pose(pair.truth.x, pair.truth.y, theta + rng.uniform(-0.02, 0.02))
        source = truth.inverse().transform(pair.truth.transform(pair.source.points))
        for turns in (0, 1):
            guess = truth @ Pose(0.03, -0.02, rng.uniform(-0.04, 0.04))
            heading = guess.theta + turns * math.copysign(2.0 * math.pi, -guess.theta)
            object.__setattr__(guess, "theta", heading)  # a Pose is wrapped; foreign code may be called by others
            yield _ask("headings", f"a guess of {heading:.4g} rad", pair.target.points, source, guess)


def _points(rng: np.random.Generator, shared: Shared) -> Iterator[DrawnQuestion]:
    pair = drawn_pair(rng, 150, 120)
    near = Pose(0.01, -0.015, 0.01)
    room = pair.target.points
    centre = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [0.0, -1.5], [-1.5, 0.0], [-0.0, 0.5], [0.5, -0.0]])
    special = np.concatenate([room[::3], centre])
    for what, guess in (("points at zero and on the axes, from the identity", Pose()), ("the same, from near", near)):
        moved = special + np.concatenate([rng.uniform(-0.04, 0.04, (len(room[::3]), 2)), np.zeros((len(centre), 2))])
        yield _ask("points", what, special, moved, guess)
    for size in (0.05, 0.1, 0.25, 0.3, 0.5, 1.0):
        cells = np.unique(rng.integers(-round(4 / size), round(4 / size), (120, 2)), axis=0).astype(np.float64) * size
        moved = (
            cells[: len(cells) - 7]
            + rng.uniform(-0.2, 0.2, 2) * size
            + rng.uniform(-0.05, 0.05, (len(cells) - 7, 2)) * size
        )
        yield _ask("points", f"points on the borders of cells of {size:g} m", cells, moved, Pose())
    for quadrant in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        both = rng.uniform(0.2, 5.0, (120, 2)) * np.array(quadrant, dtype=np.float64)
        yield _ask(
            "points", f"points of one quadrant {quadrant}", both, both[:100] + rng.normal(0.0, 0.03, (100, 2)), near
        )
    doubled = np.repeat(pair.source.points[:60], 2, axis=0)
    flipped = [{}, *({name: not value} for name, (_, value) in shared.items() if isinstance(value, bool))]
    for changes in flipped:
        yield _ask("points", "every source point twice", room, doubled, pair.guess, changes)
    for what, direction in (("x", (1.0, 0.0)), ("y", (0.0, 1.0)), ("a diagonal", (0.6, 0.8))):
        along = np.sort(rng.uniform(-4.0, 4.0, 80))[:, None] * direction
        yield _ask(
            "points", f"collinear along {what}", along, along[::2] + rng.normal(0.0, 0.01, (40, 1)) * direction, near
        )


def _limits(rng: np.random.Generator, shared: Shared) -> Iterator[DrawnQuestion]:
    for name, (one, value) in shared.items():
        if one.unit.split(" ")[0] != "m" or not isinstance(value, float) or not 0.01 <= value <= 10.0:
            continue
        for relative in (1e-4, 0.004, 0.05):
            grid = np.stack(np.meshgrid(np.arange(6.0), np.arange(6.0)), axis=-1).reshape(-1, 2) * 4.0 * value
            target = grid + rng.uniform(-0.3, 0.3, grid.shape) * value
            bearing = rng.uniform(-np.pi, np.pi, len(grid))
            length = value * np.resize([0.0, 0.0, 1.0 - relative, 1.0 + relative], len(grid))
            source = target + np.stack([length * np.cos(bearing), length * np.sin(bearing)], axis=1)
            yield _ask("limits", f"pairs {100 * relative:g} % below and above {name}", target, source, Pose())
    yield _ask("limits", "pairs of 2 cm to 3 m, 12 m between the targets", *_pairs_of_all_lengths(), Pose())
    for pairs in range(1, 8):
        target = rng.uniform(-4.0, 4.0, (60, 2))
        source = np.concatenate([target[:pairs] + rng.normal(0.0, 0.01, (pairs, 2)), target[:20] + 80.0])
        yield _ask("limits", f"{pairs} points with a partner", target, source, Pose())


def _pairs_of_all_lengths() -> tuple[Floats, Floats]:
    """Targets (48, 2) and sources (48, 2) that show a limit of their distance, also one that is no parameter."""
    grid = np.stack(np.meshgrid(np.arange(7.0), np.arange(7.0)), axis=-1).reshape(-1, 2)[:48]
    target = 12.0 * (grid - 3.0)
    length, bearing = np.geomspace(0.02, 3.0, 48), 2.4 * np.arange(48)
    return target, target + length[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)


def _edges(rng: np.random.Generator) -> Iterator[DrawnQuestion]:
    pair = drawn_pair(rng, 150, 120)
    points = pair.target.points
    yield _ask("edges", "the guess is the answer, the identity", points, points, Pose())
    truth = Pose(0.5, -1.25, 0.75)
    yield _ask("edges", "the guess is the answer", truth.transform(points), points, truth)
    for metres in (0.3, 0.6, 1.5):
        for _ in range(3):
            pair = drawn_pair(rng, 200, 150)
            bearing = rng.uniform(-np.pi, np.pi)
            guess = pair.truth @ Pose(
                metres * np.cos(bearing), metres * np.sin(bearing), rng.choice([-0.5, 0.5]) * metres
            )
            yield _ask("edges", f"a guess {metres:g} m off", pair.target.points, pair.source.points, guess)
    away = Pose(50.0, 0.0, 0.0)
    yield _ask("edges", "clouds without a pair", pair.target.points, pair.source.points, away @ pair.guess)


def _ties(rng: np.random.Generator) -> Iterator[DrawnQuestion]:
    """One source point exactly between two targets; either is right, all other pairs are clear."""
    for axis in (0, 1):
        target = np.round(rng.uniform(1.0, 6.0, (12, 2)) * 4.0) / 2.0 + np.arange(12)[:, None] * [4.0, 0.0]
        source = target + 0.0625
        between = np.zeros(2)
        gap = np.eye(2)[axis] * 0.125
        targets = np.concatenate([target, [between - gap, between + gap]])
        both = [Cloud(np.concatenate([source, [between + sign * 1e-6 * gap]])) for sign in (0.0, 1.0, -1.0)]
        one, *others = (Question(1, "ties", Cloud(targets), each, Pose()) for each in both)
        yield DrawnQuestion("ties", "a point exactly between two others", one, ties=tuple(others))


def _parameters(rng: np.random.Generator, shared: Shared) -> Iterator[DrawnQuestion]:
    pairs = [drawn_pair(rng, 200, 150) for _ in range(3)]
    few = rng.uniform(-4.0, 4.0, (60, 2))
    sets = [{name: value} for name, (one, base) in shared.items() for value in _values(rng, one, base)]
    for _ in range(4 if len(shared) > 1 else 0):
        options = {name: [base, *_values(rng, one, base)] for name, (one, base) in shared.items()}
        sets += [{name: choices[rng.integers(len(choices))] for name, choices in options.items()}]
    sets += [{name: 300, threshold: one.low} for name, (_, value) in shared.items() if _is_count(value)
             for threshold, (one, other) in shared.items() if isinstance(other, float) and one.low == 0.0]  # fmt: skip
    for drawn in sets:
        changes = {name: type(shared[name][1])(value) for name, value in drawn.items()}
        family = f"parameter {next(iter(changes))}" if len(changes) == 1 else "parameters at once"
        what = ", ".join(f"{name} = {value}" for name, value in changes.items())
        for pair in pairs:
            guess = pair.truth @ Pose.of(rng.uniform(-1.0, 1.0, 3) * [0.2, 0.2, 0.1])
            yield _ask(family, what, pair.target.points, pair.source.points, guess, changes)
        for count in (2, 3, 4, 5):
            source = np.concatenate([few[:count] + rng.normal(0.0, 0.02, (count, 2)), few[:9] + 80.0])
            yield _ask(family, what, few, source, Pose(), changes)


def _is_count(value: Value) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value > 10


def _values(rng: np.random.Generator, one: Parameter, value: Value) -> list[Value]:
    """Other values of a parameter: near, far, and at its bounds."""
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, str):
        return [choice for choice in one.choices if choice != value]
    if isinstance(value, int):
        wanted: list[Value] = [1, 2, 3, 4, 5, value + 1, value - 1, 3 * value]
    else:
        wanted = [
            0.0,
            value * float(rng.uniform(0.3, 0.6)),
            value * float(rng.uniform(1.5, 3.0)),
            10.0 * value,
            0.1 * value,
        ]
    bounds = [bound for bound in (one.low, one.high) if math.isfinite(bound) and abs(bound) < 1e6]
    known = dict.fromkeys(type(value)(each) for each in (*wanted, *bounds))
    return [each for each in known if max(one.low, 0) <= float(each) <= one.high and each != value]
