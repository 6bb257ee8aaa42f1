"""Comparison of two back ends or two mappers over a sequence: the same questions, judged by equivalence intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import wraps
from itertools import islice
from typing import ParamSpec

import numpy as np

from evalkit.commands.validate.equivalence import lockstep, map_cells
from evalkit.commands.validate.equivalence.agreement import Depth, Equivalence
from evalkit.commands.validate.equivalence.diagnosis import ROUNDING, DivergenceKind, find_mistake, mistakes_in_answer
from evalkit.commands.validate.equivalence.divergence import Divergence, first_divergence
from evalkit.commands.validate.equivalence.fields import count_fields
from evalkit.commands.validate.equivalence.lockstep import AnswerPair, ComparedBackend, PosePair
from evalkit.commands.validate.equivalence.margins import (
    FLOAT32,
    EquivalenceInterval,
    GeometryScale,
    Margin,
    MarginChoice,
    describe_gap,
    difference,
    float32_margin,
    interval,
    pose_intervals,
)
from evalkit.core.errors import BadData, DataMissing, NotInstalled
from evalkit.core.pose import Pose
from evalkit.odometry import frontend
from evalkit.plugins import defaults, registry
from evalkit.plugins.address import address_of, label_of, mapper_at, spec_at, stop_loading
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.plugins.protocols import Sequence
from evalkit.plugins.specs import BackendSpec, DatasetSpec, MapperSpec, RegistrationSpec

GivenParameters = Mapping[str, object]
Arguments = ParamSpec("Arguments")
Sides = tuple[ComparedBackend, ComparedBackend]

EXPLAINED_QUESTIONS = 3
"""Divergences of a comparison whose cause is searched for; the others are only classified."""


class NotEquivalent(AssertionError):
    """Two implementations differ: ``NotEquivalent(text)``, the text of the comparison."""


def equivalence(
    a: str | BackendSpec,
    b: str | BackendSpec,
    on: str | DatasetSpec = "",
    *,
    set_a: GivenParameters | None = None,
    set_b: GivenParameters | None = None,
    set_on: GivenParameters | None = None,
    margin: MarginChoice = Margin(),  # noqa: B008 - a Margin is frozen
    scans: int = 30,
    disturbed: bool = True,
) -> Equivalence:
    """Compare two back ends over the first scans of a sequence.

    ``a``, ``b``: registered names, "module:SPEC", or specs. ``on``: a data set, "" for a short simulated one. Two
    registrations answer the same questions, which come from running ``a``; if one is an odometry, trajectories are
    compared. ``margin``: "float32" computes the effect of rounding to single precision. ``disturbed``: repeats the last
    question of each scan with a disturbed guess. Raises NotInstalled, DataMissing, BackendFailed if ``a`` raises, and
    BadData if there is nothing to compare.
    """
    sides = load_backend("A", a, set_a or {}), load_backend("B", b, set_b or {})
    name, sequence = _load_sequence(on, set_on or {})
    if all(isinstance(one.spec, RegistrationSpec) for one in sides):
        answered = list(lockstep.answer_pairs(*sides, sequence, scans, disturbed))
        result = compare_answers(sides, name, answered, margin)
    else:
        poses = list(lockstep.pose_pairs(*sides, sequence, scans))
        result = compare_poses(sides, name, poses, pose_margin(margin, sequence, scans))
    if result.questions == 0:
        raise BadData(name, "", "no scan leads to a question", "take a sequence with more scans, or more of them")
    return result


def mapper_equivalence(
    a: str | MapperSpec,
    b: str | MapperSpec,
    on: str | DatasetSpec = "",
    *,
    set_a: GivenParameters | None = None,
    set_b: GivenParameters | None = None,
    margin: MarginChoice = Margin(),  # noqa: B008 - a Margin is frozen
    scans: int = 30,
) -> Equivalence:
    """Compare two mappers, cell by cell after every scan.

    Both draw each scan at its wheel odometry, or at the origin if there is none. Grids are float32 by type; the
    margin's log-odds include that rounding.
    """
    known = Margin(origin="a grid is float32 by its type") if margin == FLOAT32 else margin
    (label_a, spec_a), (label_b, spec_b) = _load_mapper("A", a), _load_mapper("B", b)
    known_a, known_b = (
        resolve_parameters(label, spec.parameters, given or {})
        for label, spec, given in ((label_a, spec_a, set_a), (label_b, spec_b, set_b))
    )
    name, sequence = _load_sequence(on, {})
    result = map_cells.compare_mappers(
        label_a,
        lambda: spec_a.make(**known_a),
        lambda: spec_b.make(**known_b),
        _posed_scans(sequence, scans),
        known.log_odds,
    )
    n = len(result.largest)
    if n == 0:
        raise BadData(name, "", "no scans", "take a sequence that has scans")
    unanswered = int(np.count_nonzero(np.isinf(result.largest)))
    differing = sum(count > 0 for count in result.cells) + unanswered
    classes = {str(result.first.kind): differing} if result.first else {}
    largest = np.array(result.largest)[np.isfinite(result.largest)]
    number = np.arange(1, len(largest) + 1)
    intervals = (interval("largest cell", "log odds", largest, number, known.log_odds),) if len(largest) else ()
    return Equivalence(
        label_a, label_b, name, "cells", n, n, unanswered, 0, result.first, classes, {}, intervals, known
    )


def _raise_if_different(compare: Callable[Arguments, Equivalence]) -> Callable[Arguments, Equivalence]:
    @wraps(compare)
    def compare_and_raise(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Equivalence:
        stop_loading()
        result = compare(*args, **kwargs)
        if not result.equivalent:
            raise NotEquivalent(str(result))
        return result

    return compare_and_raise


assert_equivalent = _raise_if_different(equivalence)
"""``assert_equivalent(a, b, on="", *, set_a, set_b, set_on, margin=Margin(), scans=30, disturbed=True)``:
compare two back ends over the first scans of a sequence; raise NotEquivalent with the differences, if there are any.

``a``, ``b``: registered names, "module:SPEC", or specs; ``set_a``, ``set_b``: their parameters. ``on``: a data set, ""
for a short simulated one; ``set_on``: its parameters. ``margin``: how far answers may differ; "float32" allows what
rounding to single precision does. ``scans``: how many. ``disturbed``: repeat the last question of each scan with a
disturbed guess. Raises NotInstalled, DataMissing, BackendFailed if ``a`` raises, and BadData without a question.
"""


def load_backend(name: str, backend: str | BackendSpec, given: GivenParameters) -> ComparedBackend:
    """A back end with all its parameters, and its trace on if it has one; NotInstalled if it cannot run here."""
    label = label_of(backend, name)
    spec = spec_at(address_of(backend), BackendSpec, registry.backend) if isinstance(backend, str) else backend
    if why := spec.missing():
        raise NotInstalled(label, "cannot be compared here", why)
    traced = {p.name: True for p in spec.parameters if p.name == "trace" and p.default is False}
    return ComparedBackend(label, spec, frontend.complete_parameters(label, spec, {**traced, **given}))


def compare_answers(sides: Sides, name: str, answered: list[AnswerPair], margin: MarginChoice) -> Equivalence:
    """The comparison of both sides' answers to the same questions."""
    questions = [one.question for one in answered]
    known = _compute_margin(margin, (GeometryScale.of(one.target, one.source, one.guess) for one in questions))
    diverged: list[tuple[AnswerPair, Divergence]] = []
    for one in answered:
        if divergence := first_divergence(one, known, explain=len(diverged) < EXPLAINED_QUESTIONS):
            diverged.append((one, divergence))
    divergences = [divergence for _, divergence in diverged]
    strayed = sum(one.disturbed and _is_strayed(one, divergence, known) for one, divergence in diverged)
    stages = dict.fromkeys(one.stage for one in questions)
    of_stage = ([one for one in answered if one.question.stage == stage] for stage in stages)
    intervals = [one for stage, part in zip(stages, of_stage, strict=True) for one in _intervals(stage, part, known)]
    scans, unanswered = len({one.scan for one in questions}), sum(one.b is None for one in answered)
    return Equivalence(
        sides[0].label, sides[1].label, name, _depth(answered), scans, len(answered), unanswered, strayed,
        divergences[0] if divergences else None, _count_kinds(divergences),
        count_fields([(one, known) for one in answered], margin), tuple(intervals), known,
    )  # fmt: skip


def _is_strayed(answered: AnswerPair, divergence: Divergence, margin: Margin) -> bool:
    if answered.b is None or divergence.kind in ROUNDING:
        return False
    return not margin.holds(answered.a.target_from_source, answered.b.target_from_source)


def _intervals(stage: str, answered: list[AnswerPair], margin: Margin) -> tuple[EquivalenceInterval, ...]:
    both = [(one.question.scan, one.a, one.b) for one in answered if one.b is not None]
    if not both:
        return ()
    rows = np.stack([difference(a.target_from_source, b.target_from_source) for _, a, b in both])
    return pose_intervals(stage, rows, [scan for scan, _, _ in both], margin)


def pose_margin(margin: MarginChoice, sequence: Sequence, scans: int) -> Margin:
    """The margin of odometries over a sequence: rounding grows with its scans."""
    frames = islice(sequence.frames(), scans)
    return _compute_margin(margin, (GeometryScale(one.scan.range_max_m, len(one.scan.ranges), 1.0) for one in frames))


def compare_poses(sides: Sides, name: str, poses: list[PosePair], margin: Margin) -> Equivalence:
    """The comparison of the poses of two odometries, each run separately over the sequence."""
    divergences = [divergence for one in poses if (divergence := _pose_divergence(one, margin))]
    both = [(one.scan, one.a, one.b) for one in poses if one.a is not None and one.b is not None]
    rows = np.stack([difference(a, b) for _, a, b in both]) if both else np.zeros((0, 3))
    intervals = pose_intervals("trajectory", rows, [scan for scan, _, _ in both], margin) if both else ()
    unanswered = sum((one.a is None) != (one.b is None) for one in poses)
    return Equivalence(
        sides[0].label, sides[1].label, name, "trajectories", len(poses), len(poses), unanswered, 0,
        divergences[0] if divergences else None, _count_kinds(divergences), {}, intervals, margin,
    )  # fmt: skip


def _pose_divergence(poses: PosePair, margin: Margin) -> Divergence | None:
    """The divergence of two trajectories at one scan."""
    if poses.a is None or poses.b is None:
        if poses.a is poses.b:
            return None
        what = f"B {poses.failure}" if poses.b is None else "A has no answer, B has one"
        return Divergence(poses.scan, "trajectory", None, "pose", "different", what)
    if margin.holds(poses.a, poses.b):
        return None
    candidates = mistakes_in_answer(poses.a.row, Pose().row)[:-1]
    mistake = find_mistake(candidates, poses.a.row, poses.b.row, 1.0)
    if mistake:
        return Divergence(poses.scan, "trajectory", None, "pose", mistake.kind, mistake.what)
    kind: DivergenceKind = "precision" if Margin(1e-5, 1e-5).holds(poses.a, poses.b) else "different"
    return Divergence(poses.scan, "trajectory", None, "pose", kind, describe_gap(poses.a, poses.b))


def _depth(answered: list[AnswerPair]) -> Depth:
    matches = [match for one in answered for match in (one.a, one.b) if match is not None and match.inliers]
    if not matches or not all(match.history for match in matches):
        return "answers"
    paired = all(one.pairs is not None for match in matches for one in match.history)
    return "pairs of every iteration" if paired else "poses of every iteration"


def _compute_margin(margin: MarginChoice, scales: Iterator[GeometryScale]) -> Margin:
    return float32_margin(GeometryScale.largest(scales)) if margin == FLOAT32 else margin


def _count_kinds(divergences: list[Divergence]) -> dict[str, int]:
    return dict(Counter(str(one.kind) for one in divergences).most_common())


def _load_sequence(on: str | DatasetSpec, given: GivenParameters) -> tuple[str, Sequence]:
    if on == "":
        on = defaults.find_simulated_dataset()
        given = {**defaults.find_excerpts("quick")[on], **given}
    name = on if isinstance(on, str) else "the sequence"
    spec = registry.dataset(on) if isinstance(on, str) else on
    known: dict[str, Value] = resolve_parameters(name, spec.parameters, given)
    if why := spec.missing(**{key: value for key, value in known.items() if key != "seed"}):
        raise DataMissing(name, "cannot be read here", why)
    return name, spec.make(**known)


def _load_mapper(name: str, mapper: str | MapperSpec) -> tuple[str, MapperSpec]:
    label, spec = mapper if isinstance(mapper, str) else name, mapper_at(mapper)
    if why := spec.missing():
        raise NotInstalled(label, "cannot be compared here", why)
    return label, spec


def _posed_scans(sequence: Sequence, scans: int) -> Iterator[map_cells.PosedScan]:
    for frame in islice(sequence.frames(), scans):
        yield frame.scan, (frame.odom_from_base or Pose()) @ frame.base_from_sensor
