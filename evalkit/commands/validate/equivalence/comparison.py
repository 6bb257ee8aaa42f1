"""Compares two back ends or two mappers over a sequence: the same questions, step by step, judged by intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Literal

import numpy as np

from evalkit.commands.validate.equivalence import lockstep, map_cells
from evalkit.commands.validate.equivalence.agreement import Equivalence, Level
from evalkit.commands.validate.equivalence.diagnosis import explanation, in_answer
from evalkit.commands.validate.equivalence.divergence import Divergence, first_divergence
from evalkit.commands.validate.equivalence.lockstep import Exchange, Side, Step
from evalkit.commands.validate.equivalence.margins import (
    Interval,
    Margin,
    Scale,
    difference,
    float32,
    interval,
    pose_intervals,
)
from evalkit.core.errors import BadData, BadParameter, DataMissing, NotInstalled
from evalkit.core.pose import Pose
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.address import address_of, spec_at
from evalkit.plugins.parameter_parsing import from_text
from evalkit.plugins.parameters import Parameter, Value, resolve_parameters
from evalkit.plugins.protocols import Sequence
from evalkit.plugins.specs import BackendSpec, DatasetSpec, MapperSpec, RegistrationSpec

Known = Margin | Literal["float32"]
Given = Mapping[str, object]
Texts = Mapping[str, str]

FLOAT32: Literal["float32"] = "float32"

ROUNDING = ("precision", "nearest-neighbour tie")
"""Classes that rounding alone explains."""


class NotEquivalent(AssertionError):
    """Two implementations that differ: ``NotEquivalent(text)``, the text of the comparison."""


def equivalence(
    a: str | BackendSpec,
    b: str | BackendSpec,
    on: str | DatasetSpec = "room",
    *,
    set_a: Given | None = None,
    set_b: Given | None = None,
    set_on: Given | None = None,
    margin: Known = Margin(),  # noqa: B008 - a Margin is frozen
    scans: int = 30,
    disturbed: bool = True,
) -> Equivalence:
    """What comparing two back ends over the first scans of a sequence finds.

    ``a``, ``b``: registered names, "module:SPEC", or specs. Two registrations are compared question by question; the
    questions come from running ``a``. With an odometry among them, trajectories are. ``margin``: "float32" computes
    what rounding to single precision may do. ``disturbed``: every scan's last question is asked again with a guess that
    is off. Raises NotInstalled, DataMissing, BackendFailed where ``a`` raises, BadData where there
    is nothing to compare.
    """
    sides = side("A", a, set_a or {}), side("B", b, set_b or {})
    name, sequence = _sequence(on, set_on or {})
    if all(isinstance(one.spec, RegistrationSpec) for one in sides):
        exchanges = list(lockstep.exchanges(*sides, sequence, scans, disturbed))
        found = of_exchanges(sides, name, exchanges, margin)
    else:
        found = _of_odometries(sides, name, sequence, scans, margin)
    if found.questions == 0:
        raise BadData(name, "", "no scan asks anything of A", "take a sequence with more scans, or more of them")
    return found


def mapper_equivalence(
    a: str | MapperSpec,
    b: str | MapperSpec,
    on: str | DatasetSpec = "room",
    *,
    set_a: Given | None = None,
    set_b: Given | None = None,
    set_on: Given | None = None,
    margin: Known = Margin(),  # noqa: B008 - a Margin is frozen
    scans: int = 30,
) -> Equivalence:
    """What comparing two mappers, cell by cell after every scan, finds.

    Both draw each scan where the wheel odometry says it was taken, or all at the origin where there is none. Grids are
    float32 by their type, which the margin's own log-odds cover.
    """
    known = Margin(origin="a grid is float32 by its type") if margin == FLOAT32 else margin
    (label_a, spec_a), (label_b, spec_b) = _mapper("A", a), _mapper("B", b)
    known_a, known_b = (
        resolve_parameters(label, spec.parameters, given or {})
        for label, spec, given in ((label_a, spec_a, set_a), (label_b, spec_b, set_b))
    )
    name, sequence = _sequence(on, set_on or {})
    drawing = map_cells.compared(
        label_a, lambda: spec_a.make(**known_a), lambda: spec_b.make(**known_b), _drawn(sequence, scans), known.log_odds
    )
    n = len(drawing.largest)
    if n == 0:
        raise BadData(name, "", "no scans", "take a sequence that has some")
    unanswered = int(np.count_nonzero(np.isinf(drawing.largest)))
    differing = sum(count > 0 for count in drawing.cells) + unanswered
    classes = {str(drawing.first.kind): differing} if drawing.first else {}
    largest = np.array(drawing.largest)[np.isfinite(drawing.largest)]
    intervals = (
        (interval("largest cell", "log-odds", largest, np.arange(1, len(largest) + 1), known.log_odds),)
        if len(largest)
        else ()
    )
    return Equivalence(label_a, label_b, name, "cells", n, n, unanswered, 0, drawing.first, classes, intervals, known)


def assert_equivalent(
    a: str | BackendSpec,
    b: str | BackendSpec,
    on: str | DatasetSpec = "room",
    *,
    set_a: Given | None = None,
    set_b: Given | None = None,
    set_on: Given | None = None,
    margin: Known = Margin(),  # noqa: B008 - a Margin is frozen
    scans: int = 30,
    disturbed: bool = True,
) -> Equivalence:
    """The comparison of two back ends as in ``equivalence``; raises NotEquivalent with all of it where they differ."""
    found = equivalence(
        a, b, on, set_a=set_a, set_b=set_b, set_on=set_on, margin=margin, scans=scans, disturbed=disturbed
    )
    if not found.equivalent:
        raise NotEquivalent(str(found))
    return found


def side(name: str, backend: str | BackendSpec, given: Given) -> Side:
    """One side with all its parameters, told to keep its trace where its spec knows how; NotInstalled if absent."""
    label = backend if isinstance(backend, str) else name
    spec = spec_at(address_of(backend), BackendSpec, registry.backend) if isinstance(backend, str) else backend
    if why := spec.missing():
        raise NotInstalled(label, "cannot be compared here", why)
    traced = {p.name: True for p in spec.parameters if p.name == "trace" and p.default is False}
    return Side(label, spec, frontend.complete_parameters(label, spec, {**traced, **given}))


def margin(word: str, metres: float, radians: float | None, log_odds: float) -> Known:
    """The margin of a command line; BadParameter names a word or a number that is none."""
    if word == FLOAT32:
        return FLOAT32
    if word:
        raise BadParameter("equiv", "margin", word, "float32, or --margin-m, --margin-rad and --margin-log-odds")
    try:
        return Margin(metres, metres if radians is None else radians, log_odds)
    except ValueError as error:
        raise BadParameter("equiv", "margin", (metres, radians, log_odds), f"positive numbers ({error})") from None


def settings(
    a: str, b: str, on: str, set_a: Texts, set_b: Texts, set_on: Texts, *, mapper: bool
) -> dict[str, dict[str, Value]]:
    """The words of a command line as ``set_a``, ``set_b`` and ``set_on``, in the types the plug-ins declare."""
    known = _mapper_parameters if mapper else _backend_parameters
    return {
        "set_a": from_text(a, known(a), set_a),
        "set_b": from_text(b, known(b), set_b),
        "set_on": from_text(on, registry.dataset(on).parameters, set_on),
    }


def _mapper_parameters(name: str) -> tuple[Parameter, ...]:
    return registry.mapper(name).parameters


def _backend_parameters(name: str) -> tuple[Parameter, ...]:
    return frontend.settable_parameters(spec_at(address_of(name), BackendSpec, registry.backend))


def of_exchanges(sides: tuple[Side, Side], name: str, exchanges: list[Exchange], margin: Known) -> Equivalence:
    """What the answers of both sides to the same questions say."""
    questions = [exchange.question for exchange in exchanges]
    known = _margin(margin, (Scale.of(one.target, one.source, one.guess) for one in questions))
    parted = [(one, divergence) for one in exchanges if (divergence := first_divergence(one, known))]
    found = [divergence for _, divergence in parted]
    strayed = sum(one.disturbed and _strayed(one, divergence, known) for one, divergence in parted)
    stages = dict.fromkeys(one.stage for one in questions)
    of_stage = ([one for one in exchanges if one.question.stage == stage] for stage in stages)
    intervals = [one for stage, part in zip(stages, of_stage, strict=True) for one in _intervals(stage, part, known)]
    scans, unanswered = len({one.scan for one in questions}), sum(one.b is None for one in exchanges)
    return Equivalence(
        sides[0].label, sides[1].label, name, _level(exchanges), scans, len(exchanges), unanswered, strayed,
        found[0] if found else None, _counted(found), tuple(intervals), known,
    )  # fmt: skip


def _strayed(exchange: Exchange, divergence: Divergence, margin: Margin) -> bool:
    if exchange.b is None or divergence.kind in ROUNDING:
        return False
    return not margin.holds(exchange.a.target_from_source, exchange.b.target_from_source)


def _intervals(stage: str, exchanges: list[Exchange], margin: Margin) -> tuple[Interval, ...]:
    answered = [(one.question.scan, one.a, one.b) for one in exchanges if one.b is not None]
    if not answered:
        return ()
    rows = np.stack([difference(a.target_from_source, b.target_from_source) for _, a, b in answered])
    return pose_intervals(stage, rows, [scan for scan, _, _ in answered], margin)


def _of_odometries(sides: tuple[Side, Side], name: str, sequence: Sequence, scans: int, margin: Known) -> Equivalence:
    return of_steps(sides, name, list(lockstep.steps(*sides, sequence, scans)), step_margin(margin, sequence, scans))


def step_margin(margin: Known, sequence: Sequence, scans: int) -> Margin:
    """The margin of odometries over a sequence: rounding grows with its scans."""
    frames = islice(sequence.frames(), scans)
    return _margin(margin, (Scale(one.scan.range_max_m, len(one.scan.ranges), 1.0) for one in frames))


def of_steps(sides: tuple[Side, Side], name: str, steps: list[Step], known: Margin) -> Equivalence:
    """What the poses of both sides, each following a sequence by itself, say."""
    found = [divergence for one in steps if (divergence := _parted(one, known))]
    both = [(one.scan, one.a, one.b) for one in steps if one.a is not None and one.b is not None]
    rows = np.stack([difference(a, b) for _, a, b in both]) if both else np.zeros((0, 3))
    intervals = pose_intervals("trajectory", rows, [scan for scan, _, _ in both], known) if both else ()
    unanswered = sum((one.a is None) != (one.b is None) for one in steps)
    return Equivalence(
        sides[0].label, sides[1].label, name, "trajectories", len(steps), len(steps), unanswered, 0,
        found[0] if found else None, _counted(found), intervals, known,
    )  # fmt: skip


def _parted(step: Step, margin: Margin) -> Divergence | None:
    """The divergence of two trajectories at one scan."""
    if step.a is None or step.b is None:
        if step.a is step.b:
            return None
        what = f"B {step.failure}" if step.b is None else "A has no answer, B has"
        return Divergence(step.scan, "trajectory", None, "pose", "different", what)
    if margin.holds(step.a, step.b):
        return None
    mistake = explanation(in_answer(step.a.row, Pose().row)[:-1], step.a.row, step.b.row, 1.0)
    if mistake:
        return Divergence(step.scan, "trajectory", None, "pose", mistake.kind, mistake.what)
    away = step.a.inverse() @ step.b
    gap = f"{np.hypot(away.x, away.y):.2g} m and {abs(away.theta):.2g} rad"
    rounded = np.hypot(away.x, away.y) <= 1e-5 and abs(away.theta) <= 1e-5
    kind: Literal["precision", "different"] = "precision" if rounded else "different"
    return Divergence(step.scan, "trajectory", None, "pose", kind, gap)


def _level(exchanges: list[Exchange]) -> Level:
    matches = [match for one in exchanges for match in (one.a, one.b) if match is not None and match.inliers]
    if not matches or not all(match.history for match in matches):
        return "answers"
    paired = all(one.pairs is not None for match in matches for one in match.history)
    return "pairs of every iteration" if paired else "poses of every iteration"


def _margin(margin: Known, scales: Iterator[Scale]) -> Margin:
    return float32(Scale.largest(scales)) if margin == FLOAT32 else margin


def _counted(found: list[Divergence]) -> dict[str, int]:
    return dict(Counter(str(one.kind) for one in found).most_common())


def _sequence(on: str | DatasetSpec, given: Given) -> tuple[str, Sequence]:
    name = on if isinstance(on, str) else "the sequence"
    spec = registry.dataset(on) if isinstance(on, str) else on
    known: dict[str, Value] = resolve_parameters(name, spec.parameters, given)
    if why := spec.missing(**{key: value for key, value in known.items() if key != "seed"}):
        raise DataMissing(name, "cannot be read here", why)
    return name, spec.make(**known)


def _mapper(name: str, mapper: str | MapperSpec) -> tuple[str, MapperSpec]:
    label, spec = (mapper, registry.mapper(mapper)) if isinstance(mapper, str) else (name, mapper)
    if why := spec.missing():
        raise NotInstalled(label, "cannot be compared here", why)
    return label, spec


def _drawn(sequence: Sequence, scans: int) -> Iterator[map_cells.Drawn]:
    for frame in islice(sequence.frames(), scans):
        yield frame.scan, (frame.odom_from_base or Pose()) @ frame.base_from_sensor
