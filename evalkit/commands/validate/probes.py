"""What a back end is asked for its dossier, in a process apart: plain values in, JSON values and arrays out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from evalkit.commands.validate import pairs
from evalkit.commands.validate.equivalence import comparison as equivalence
from evalkit.commands.validate.equivalence import lockstep
from evalkit.commands.validate.equivalence.comparison import FLOAT32, ROUNDING, Known
from evalkit.commands.validate.equivalence.divergence import first_divergence
from evalkit.commands.validate.equivalence.lockstep import Exchange, Side
from evalkit.commands.validate.equivalence.margins import FLOAT32_ROUNDOFF, TIE_ROUNDINGS, Margin, difference
from evalkit.commands.validate.pairs import Pair, TwoScans
from evalkit.commands.validate.rules import runner as conformance
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.execution.sandbox import note_place
from evalkit.execution.task import Result
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value
from evalkit.plugins.protocols import NoAnswer, Odometry, Sequence
from evalkit.plugins.specs import RegistrationSpec

Named = Mapping[str, Any]
"""A back end: its "name", and what is "given" to it."""

Data = Mapping[str, Any]
"""A sequence: its "dataset" and "parameters"."""

EXACT = "exact"
AWAY = Pose(0.0213, 0.0117, 0.3)
"""No special place: from a cell's corner beams at 45 degrees meet corners, where rounding alone says which cell."""

NOWHERE = (np.nan, np.nan, np.nan)


def rules(name: str, given: Mapping[str, Value], limit_s: float, digest: str = "") -> Result:  # noqa: ARG001
    """Check the rules, in processes of their own. ``digest``: of the build that is asked."""
    found = conformance.check(name, given, limit_s)
    return {"verdicts": [[one.rule, one.sentence, one.outcome, one.observed] for one in found.verdicts]}


def pairs_compared(a: Named, b: Named, on: Data, count: int, exact: bool, margins: list[str]) -> Result:
    """Both back ends asked about pairs of scans: every answer, what noise leaves of it, and where they part."""
    sides = _side(a), _side(b)
    alone = all(isinstance(side.spec, RegistrationSpec) for side in sides)
    first, second = (side.registrations()["s2m"] if alone else TwoScans(side) for side in sides)
    asked = _pairs(on, count, exact)
    exchanges = []
    for pair in asked:
        question = pair.question
        note_place(f"{on['label']}, pair {question.scan} ({question.stage})")
        mine = first.register(question.target, question.source, question.guess)
        exchanges.append(lockstep.asked(second, question, mine))
    answers = [one.a.target_from_source for one in exchanges]
    residuals = [pairs.residual_m(one.question, answer) for one, answer in zip(exchanges, answers, strict=True)]
    return {
        **_known(asked),
        **_judged(sides, on["label"], exchanges, margins),
        "alone": alone,
        "a": _rows(answers),
        "b": _rows(None if one.b is None else one.b.target_from_source for one in exchanges),
        "residual_m": np.array(residuals),
    }


def pair_answers(named: Named, on: Data, count: int, exact: bool) -> Result:
    """What one back end answers to the same pairs: ``rows`` (N, 3), nan where it has no answer."""
    side = _side(named)
    alone = isinstance(side.spec, RegistrationSpec)
    asker = side.registrations()["s2m"] if alone else TwoScans(side)
    rows: list[Pose | None] = []
    for pair in _pairs(on, count, exact):
        question = pair.question
        note_place(f"{on['label']}, pair {question.scan} ({question.stage})")
        try:
            rows.append(asker.register(question.target, question.source, question.guess).target_from_source)
        except Exception:  # noqa: BLE001 - a third party's code; no answer is one of its answers
            rows.append(None)
    return {"rows": _rows(rows), "alone": alone}


def scans_compared(a: Named, b: Named, on: Data, scans: int, margins: list[str]) -> Result:
    """Both back ends over the first scans of a sequence: registrations in lockstep, odometries each by itself."""
    sides, sequence = (_side(a), _side(b)), _sequence(on)
    if all(isinstance(side.spec, RegistrationSpec) for side in sides):
        exchanges = []
        for exchange in lockstep.exchanges(*sides, sequence, scans):
            note_place(f"{on['label']}, scan {exchange.question.scan}")
            exchanges.append(exchange)
        return {**_judged(sides, on["label"], exchanges, margins), **_apart(exchanges)}
    steps = []
    for step in lockstep.steps(*sides, sequence, scans):
        note_place(f"{on['label']}, scan {step.scan}")
        steps.append(step)
    known = {word: equivalence.step_margin(margin(word), sequence, scans) for word in margins}
    both = [(one.scan, difference(one.a, one.b)) for one in steps if one.a is not None and one.b is not None]
    return {
        **{
            word: equivalence.of_steps(sides, on["label"], steps, one).as_json() | {"astray": 0}
            for word, one in known.items()
        },
        "stage": ["trajectory"] * len(both),
        **_differences([scan for scan, _ in both], [row for _, row in both]),
    }


def rounded_paths(named: Named, on: Data, times: int) -> Result:
    """Paths (K, N, 3) of a back end over ``times`` copies of a sequence, each range changed by what rounding may.

    That is ``TIE_ROUNDINGS`` roundings to float32 of the longest range, within which two distances count as equal. What
    such a copy does to the path is what single precision may do to it.
    """
    side, rng = _side(named), np.random.default_rng(0)
    frames = list(_sequence(on).frames())
    paths = []
    for copy in range(times):
        note_place(f"{on['label']}, copy {copy + 1}")
        odometry = frontend.make_odometry(side.spec, side.parameters)
        paths.append(_rows(_answer(odometry, _rounded(frame, rng)) for frame in frames))
    return {"stamps_ns": np.array([frame.scan.stamp_ns for frame in frames]), "paths": np.array(paths)}


def maps_compared(a: str, b: str, on: Data, scans: int) -> Result:
    """Two mappers drawing the same scans, cell by cell, from where no beam meets a corner of cells but by chance."""
    spec, sequence = registry.dataset(on["dataset"]), _sequence(on)
    note_place(f"{on['label']}: {a} and {b}")
    placed = replace(spec, make=lambda: _Placed(sequence), parameters=())
    found = equivalence.mapper_equivalence(a, b, placed, scans=scans)
    return {"cells": found.as_json()}


class _Placed:
    """A sequence whose wheels start from ``AWAY``; where there are none, they stay there."""

    def __init__(self, sequence: Sequence) -> None:
        self._sequence = sequence

    def __len__(self) -> int:
        return len(self._sequence)

    def frames(self) -> Iterator[Frame]:
        for frame in self._sequence.frames():
            yield replace(frame, odom_from_base=AWAY @ (frame.odom_from_base or Pose()))

    def truth(self) -> Truth:
        return self._sequence.truth()

    def notes(self) -> Mapping[str, int]:
        return self._sequence.notes()


def margin(word: str) -> Known:
    """The margin of a word: "exact", "float32", or metres (and as many radians)."""
    if word == EXACT:
        return Margin(origin="a million times what rounding in double precision leaves")
    return FLOAT32 if word == FLOAT32 else Margin(float(word), float(word), origin="as given with --margin")


def _rounded(frame: Frame, rng: np.random.Generator) -> Frame:
    scan = frame.scan
    reach = TIE_ROUNDINGS * FLOAT32_ROUNDOFF * float(np.max(scan.ranges, where=scan.hits, initial=0.0))
    ranges = scan.ranges + rng.uniform(-reach, reach, len(scan.ranges))
    inside = np.where(scan.hits, np.clip(ranges, scan.range_min_m, scan.range_max_m), scan.ranges)
    return replace(frame, scan=replace(scan, ranges=inside))


def _answer(odometry: Odometry, frame: Frame) -> Pose | None:
    try:
        return odometry.update(frame).pose
    except NoAnswer:
        return None


def _side(named: Named) -> Side:
    return equivalence.side(named["name"], named["name"], named["given"])


def _sequence(on: Data) -> Sequence:
    return registry.dataset(on["dataset"]).make(**on["parameters"])


def _pairs(on: Data, count: int, exact: bool) -> list[Pair]:
    return list(pairs.pairs(_sequence(on), count, exact))


def _known(asked: list[Pair]) -> dict[str, Any]:
    """What there is to know of the questions themselves."""
    questions = [pair.question for pair in asked]
    return {
        "truth": _rows(pair.truth for pair in asked),
        "guess": _rows(question.guess for question in questions),
        "stage": [question.stage for question in questions],
        "points": np.array([len(question.source) for question in questions]),
        "radius_m": np.array([pairs.radius_m(question) for question in questions]),
    }


def _judged(sides: tuple[Side, Side], label: str, exchanges: list[Exchange], margins: list[str]) -> dict[str, Any]:
    """What the answers say under every margin; ``astray``: answers beyond it for another reason than rounding."""
    found = {}
    for word in margins:
        held = equivalence.of_exchanges(sides, label, exchanges, margin(word))
        astray = sum(_astray(one, held.margin) for one in exchanges)
        found[word] = held.as_json() | {"astray": astray}
    return found


def _astray(exchange: Exchange, known: Margin) -> bool:
    if exchange.b is None:
        return True
    parted = first_divergence(exchange, known)
    away = not known.holds(exchange.a.target_from_source, exchange.b.target_from_source)
    return parted is not None and parted.kind not in ROUNDING and away


def _apart(exchanges: list[Exchange]) -> dict[str, Any]:
    both = [(one.question, difference(one.a.target_from_source, one.b.target_from_source))
            for one in exchanges if one.b is not None]  # fmt: skip
    rows = _differences([question.scan for question, _ in both], [row for _, row in both])
    return {"stage": [question.stage for question, _ in both], **rows}


def _differences(scans: list[int], rows: list[Floats]) -> dict[str, Any]:
    apart = np.array(rows).reshape(-1, 3)
    return {"scan": np.array(scans), "metres": np.hypot(apart[:, 0], apart[:, 1]), "radians": np.abs(apart[:, 2])}


def _rows(poses: Iterable[Pose | None]) -> Floats:
    return np.array([NOWHERE if pose is None else pose.row for pose in poses]).reshape(-1, 3)
