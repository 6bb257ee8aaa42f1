"""Probes of back ends and mappers, each run in a separate process: plain values in, JSON values and arrays out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from evalkit.commands.validate import scan_pairs
from evalkit.commands.validate.equivalence import comparison, lockstep
from evalkit.commands.validate.equivalence.diagnosis import ROUNDING
from evalkit.commands.validate.equivalence.divergence import first_divergence
from evalkit.commands.validate.equivalence.fields import count_equal_fields, count_fields, describe_field, wrong_fields
from evalkit.commands.validate.equivalence.lockstep import DISTURBED, AnswerPair, ComparedBackend
from evalkit.commands.validate.equivalence.margins import (
    FLOAT32,
    FLOAT32_ROUNDOFF,
    TIE_ROUNDINGS,
    Margin,
    MarginChoice,
    difference,
    radius_m,
)
from evalkit.commands.validate.equivalence.rounding import is_decided_by_rounding, is_reached_by_rounding
from evalkit.commands.validate.rules import runner
from evalkit.commands.validate.rules.state_rules import match_bits
from evalkit.commands.validate.scan_pairs import ScanPair, TwoScans
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.execution.sandbox import note_place
from evalkit.execution.task import Result
from evalkit.odometry import frontend
from evalkit.odometry.run_odometry import estimate_poses
from evalkit.plugins import registry
from evalkit.plugins.changed_sequence import ChangedSequence
from evalkit.plugins.parameters import Value
from evalkit.plugins.protocols import Registration, Sequence
from evalkit.plugins.specs import RegistrationSpec

Plugin = Mapping[str, Any]
"""A back end or a mapper: its "name", and the parameters "given" to it."""

Data = Mapping[str, Any]
"""A sequence: its "label", "dataset" and "parameters"."""

EXACT = "exact"
START = Pose(0.0213, 0.0117, 0.3)
"""A start off every cell corner: from a corner, beams at 45 degrees pass corners, where rounding alone decides."""

CERTAIN = 3
"""Poses that differ by more than rounding, after which this is no question of rounding."""

NO_POSE = (np.nan, np.nan, np.nan)


def rules(name: str, given: Mapping[str, Value], limit_s: float, seed: int, digest: str = "") -> Result:  # noqa: ARG001
    """The results of all rules, which run in separate processes. ``digest``: of the build, for the task's key."""
    report = runner.check(name, given, limit_s, seed=seed)
    return {"rules": [asdict(one) for one in report.results]}


def compare_pairs(a: Plugin, b: Plugin, on: Data, count: int, exact: bool, margins: list[str]) -> Result:
    """The answers of both back ends to pairs of scans, their residuals, and where they diverge under each margin."""
    sides = load_backend(a), load_backend(b)
    alone = all(isinstance(side.spec, RegistrationSpec) for side in sides)
    first, second = (side.registrations()["s2m"] if alone else TwoScans(side) for side in sides)
    pairs = _pairs(on, count, exact)
    answered = []
    for pair in pairs:
        question = pair.question
        note_place(f"{on['label']}, pair {question.scan} ({question.stage})")
        match = first.register(question.target, question.source, question.guess)
        answered.append(lockstep.answer(second, question, match, first if alone else None))
    unrepeated = _count_unrepeated(lambda: sides[1].registrations()["s2m"] if alone else TwoScans(sides[1]), answered)
    answers = [one.a.target_from_source for one in answered]
    residuals = [scan_pairs.residual_m(one.question, answer) for one, answer in zip(answered, answers, strict=True)]
    clear = answered if alone else _leave_out_undecided(first, answered)
    compared = _compare(sides, on["label"], clear, margins, lambda _: first if alone else None)
    for result in compared.values():
        for name in ("excepted", "apart", "questions"):
            result[name] += len(answered) - len(clear)
    return {
        **_describe_questions(pairs),
        **compared,
        "alone": alone,
        "unrepeated": unrepeated,
        "a": _rows(answers),
        "b": _rows(None if one.b is None else one.b.target_from_source for one in answered),
        "residual_m": np.array(residuals),
    }


def _leave_out_undecided(reference: Registration, answered: list[AnswerPair]) -> list[AnswerPair]:
    """The answers of two odometries without those that rounding decides; all if it would decide more than half."""
    clear = [one for one in answered if not _is_undecided(reference, one)]
    return clear if 2 * len(clear) >= len(answered) else answered


def _is_undecided(reference: Registration, answered: AnswerPair) -> bool:
    """Whether an odometry's answer differs, and rounding to double precision moves that of the reference to it.

    Nothing inside an odometry is seen, such as two points that are equally far away to the last bit.
    """
    a, b = answered.a.target_from_source, answered.b
    apart = b is not None and not Margin().holds(a, b.target_from_source)
    return b is not None and apart and is_reached_by_rounding(reference, answered.question, b.target_from_source)


def _count_unrepeated(make: Callable[[], Registration], answered: list[AnswerPair]) -> int:
    """The number of answers that a new object does not give again to the bit, in the opposite order."""
    registration = make()
    again = [lockstep.answer(registration, one.question, one.a) for one in reversed(answered)]
    return sum(
        first.b is not None and (other.b is None or match_bits(first.b) != match_bits(other.b))
        for first, other in zip(reversed(answered), again, strict=True)
    )


def answer_pairs(backend: Plugin, on: Data, count: int, exact: bool) -> Result:
    """The answers of one back end to the same pairs: ``rows`` (N, 3), nan if it has no answer."""
    side = load_backend(backend)
    alone = isinstance(side.spec, RegistrationSpec)
    registration = side.registrations()["s2m"] if alone else TwoScans(side)
    rows: list[Pose | None] = []
    for pair in _pairs(on, count, exact):
        question = pair.question
        note_place(f"{on['label']}, pair {question.scan} ({question.stage})")
        try:
            rows.append(registration.register(question.target, question.source, question.guess).target_from_source)
        except Exception:  # noqa: BLE001 - a third party's code; an exception counts as no answer
            rows.append(None)
    return {"rows": _rows(rows), "alone": alone}


def compare_scans(a: Plugin, b: Plugin, on: Data, scans: int, margins: list[str], disturbed: bool = True) -> Result:
    """Both back ends over the first scans of a sequence: registrations in lockstep, odometries separately.

    ``disturbed``: see ``lockstep.answer_pairs``.
    """
    sides, sequence = (load_backend(a), load_backend(b)), load_sequence(on)
    if all(isinstance(side.spec, RegistrationSpec) for side in sides):
        answered = []
        for pair in lockstep.answer_pairs(*sides, sequence, scans, disturbed):
            note_place(f"{on['label']}, scan {pair.question.scan}")
            answered.append(pair)
        stages = sides[0].registrations()
        compared = _compare(sides, on["label"], answered, margins, lambda stage: stages[stage.removesuffix(DISTURBED)])
        return {**compared, **_answer_differences(answered)}
    poses = []
    for pose in lockstep.pose_pairs(*sides, sequence, scans):
        note_place(f"{on['label']}, scan {pose.scan}")
        poses.append(pose)
    known = {name: comparison.pose_margin(parse_margin(name), sequence, scans) for name in margins}
    both = [(one.scan, difference(one.a, one.b)) for one in poses if one.a is not None and one.b is not None]
    return {
        **{
            name: comparison.compare_poses(sides, on["label"], poses, one).as_json() | {"beyond_rounding": 0}
            for name, one in known.items()
        },
        "stage": ["trajectory"] * len(both),
        **_differences([scan for scan, _ in both], [row for _, row in both]),
    }


def perturbed_paths(backend: Plugin, on: Data, copies: int) -> Result:
    """Paths (K, N, 3) of a back end over ``copies`` of a sequence, each range changed by up to the effect of rounding.

    That is ``TIE_ROUNDINGS`` roundings to float32 of the longest range, within which two distances count as equal. The
    change of the path shows the possible effect of single precision.
    """
    side, rng = load_backend(backend), np.random.default_rng(0)
    frames = list(load_sequence(on).frames())
    paths = []
    for copy in range(copies):
        note_place(f"{on['label']}, copy {copy + 1}")
        odometry = frontend.make_odometry(side.spec, side.parameters)
        paths.append(estimate_poses(odometry, (_perturb(frame, rng) for frame in frames)))
    return {"stamps_ns": np.array([frame.scan.stamp_ns for frame in frames]), "paths": np.array(paths)}


def compare_maps(a: Plugin, b: Plugin, on: Data, scans: int, margin: str) -> Result:
    """Two mappers drawing the same scans, compared cell by cell, from a start off the corners of cells."""
    spec, sequence = registry.dataset(on["dataset"]), load_sequence(on)
    note_place(f"{on['label']}: {a['name']} and {b['name']}")
    moved = replace(spec, make=lambda: ChangedSequence(sequence, _move_odometry), parameters=())
    result = comparison.mapper_equivalence(
        a["name"], b["name"], moved, set_a=a["given"], set_b=b["given"], margin=parse_margin(margin), scans=scans
    )
    return {"cells": result.as_json()}


def _move_odometry(_index: int, frame: Frame) -> Frame:
    """Begin the wheel odometry at ``START``; without any, it stays there."""
    return replace(frame, odom_from_base=START @ (frame.odom_from_base or Pose()))


def parse_margin(text: str) -> MarginChoice:
    """The margin of "exact", of "float32", or of "METRES[,RADIANS[,LOG_ODDS]]"; ValueError for anything else.

    Without radians, they equal the metres.
    """
    if text == EXACT:
        return Margin(origin="a million times the rounding error of double precision")
    if text == FLOAT32:
        return FLOAT32
    numbers = [float(word) for word in text.split(",")]
    if len(numbers) > 3:
        raise ValueError(f"margin: found {text!r}, expected at most three numbers")
    metres, radians = numbers[0], numbers[1] if len(numbers) > 1 else numbers[0]
    log_odds = numbers[2] if len(numbers) > 2 else Margin().log_odds
    return Margin(metres, radians, log_odds, origin="as given with --margin")


def load_backend(backend: Plugin) -> ComparedBackend:
    """A back end with its complete parameters."""
    return comparison.load_backend(backend["name"], backend["name"], backend["given"])


def load_sequence(on: Data) -> Sequence:
    """The sequence of a data set and its parameters."""
    return registry.dataset(on["dataset"]).open(on["parameters"])


def _perturb(frame: Frame, rng: np.random.Generator) -> Frame:
    scan = frame.scan
    reach = TIE_ROUNDINGS * FLOAT32_ROUNDOFF * float(np.max(scan.ranges, where=scan.hits, initial=0.0))
    ranges = scan.ranges + rng.uniform(-reach, reach, len(scan.ranges))
    inside = np.where(scan.hits, np.clip(ranges, scan.range_min_m, scan.range_max_m), scan.ranges)
    return replace(frame, scan=replace(scan, ranges=inside))


def _pairs(on: Data, count: int, exact: bool) -> list[ScanPair]:
    return list(scan_pairs.scan_pairs(load_sequence(on), count, exact))


def _describe_questions(pairs: list[ScanPair]) -> dict[str, Any]:
    """The truth, guess, stage, number of points and radius of each question."""
    questions = [pair.question for pair in pairs]
    return {
        "truth": _rows(pair.truth for pair in pairs),
        "guess": _rows(question.guess for question in questions),
        "stage": [question.stage for question in questions],
        "points": np.array([len(question.source) for question in questions]),
        "radius_m": np.array([radius_m(question.source.points) for question in questions]),
    }


def _compare(
    sides: tuple[ComparedBackend, ComparedBackend],
    label: str,
    answered: list[AnswerPair],
    margins: list[str],
    reference_of: Callable[[str], Registration | None],
) -> dict[str, Any]:
    """The comparison under every margin; ``beyond_rounding``: answers beyond it for another reason than rounding.

    ``apart``: all beyond it; ``excepted``: those that rounding decides; ``largest_m``: the largest distance of all but
    these. ``equal_fields``, ``excused_fields``: see ``count_equal_fields``; ``first_fields``: see ``_find_first``.

    ``reference_of``: the reference of a stage, which is asked again with perturbed points where an answer differs under
    the float32 margin: what rounding decides is no difference.
    """
    results = {}
    for name in margins:
        choice = parse_margin(name)
        result = comparison.compare_answers(sides, label, answered, choice)
        beyond = [one for one in answered if _beyond_rounding(one, result.margin)]
        fields, compared = result.fields, answered
        if choice == FLOAT32 and (beyond or fields):
            undecided = _find_undecided(answered, beyond, result.margin, reference_of)
            beyond = [one for one in beyond if id(one) not in undecided]
            compared = [one for one in answered if id(one) not in undecided]
            fields = count_fields([(one, result.margin) for one in compared], choice)
        apart = [one for one in answered if one.b is not None
                 and not result.margin.holds(one.a.target_from_source, one.b.target_from_source)]  # fmt: skip
        excepted = [one for one in apart if one not in beyond]
        largest_m = max((_distance_m(one) for one in answered if one not in excepted), default=0.0)
        equal_fields, excused_fields = count_equal_fields(((one, result.margin) for one in answered), fields)
        results[name] = result.as_json() | {
            "beyond_rounding": len(beyond), "apart": len(apart), "excepted": len(excepted), "largest_m": largest_m,
            "fields": dict(fields), "equal_fields": equal_fields, "excused_fields": excused_fields,
            "first_fields": {field: _find_first(field, compared, result.margin) for field in fields if field != "pose"},
        }  # fmt: skip
    return results


def _find_first(field: str, answered: list[AnswerPair], margin: Margin) -> dict[str, Any]:
    """Scan and stage of the first answer in which a field differs where the pose does not, and both values in words."""
    for one in answered:
        if one.b is not None and field in wrong_fields(one.a, one.b, margin):
            what = describe_field(field, one.a, one.b, margin)
            return {"scan": one.question.scan, "stage": one.question.stage, "what": what}
    raise ValueError(f"{field}: differs in no answer")


def _find_undecided(
    answered: list[AnswerPair], beyond: list[AnswerPair], margin: Margin,
    reference_of: Callable[[str], Registration | None],
) -> set[int]:  # fmt: skip
    """The ids of answers that rounding decides; after ``CERTAIN`` poses that it does not, no further one is tried."""
    found: set[int] = set()
    certain = 0
    for one in answered:
        reference = reference_of(one.question.stage)
        if reference is None or one.b is None or not (one in beyond or wrong_fields(one.a, one.b, margin)):
            continue
        if is_decided_by_rounding(reference, one.question, one.a, margin):
            found.add(id(one))
        elif one in beyond and (certain := certain + 1) == CERTAIN:
            break
    return found


def _beyond_rounding(answered: AnswerPair, margin: Margin) -> bool:
    if answered.b is None:
        return True
    divergence = first_divergence(answered, margin, explain=False)
    apart = not margin.holds(answered.a.target_from_source, answered.b.target_from_source)
    return divergence is not None and divergence.kind not in ROUNDING and apart


def _distance_m(answered: AnswerPair) -> float:
    """The distance of both answers; 0 without an answer of B."""
    if answered.b is None:
        return 0.0
    x, y, _ = difference(answered.a.target_from_source, answered.b.target_from_source).tolist()
    return float(np.hypot(x, y))


def _answer_differences(answered: list[AnswerPair]) -> dict[str, Any]:
    both = [(one.question, difference(one.a.target_from_source, one.b.target_from_source))
            for one in answered if one.b is not None]  # fmt: skip
    rows = _differences([question.scan for question, _ in both], [row for _, row in both])
    return {"stage": [question.stage for question, _ in both], **rows}


def _differences(scans: list[int], rows: list[Floats]) -> dict[str, Any]:
    apart = np.array(rows).reshape(-1, 3)
    return {"scan": np.array(scans), "metres": np.hypot(apart[:, 0], apart[:, 1]), "radians": np.abs(apart[:, 2])}


def _rows(poses: Iterable[Pose | None]) -> Floats:
    return np.array([NO_POSE if pose is None else pose.row for pose in poses]).reshape(-1, 3)
