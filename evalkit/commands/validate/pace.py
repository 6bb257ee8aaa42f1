"""What a scan costs several back ends side by side: the same scan for all before the next one, in changing order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from typing import Any

import numpy as np

from evalkit.commands.validate.equivalence import comparison as equivalence
from evalkit.commands.validate.equivalence.lockstep import Side
from evalkit.commands.validate.pairs import pairs
from evalkit.commands.validate.probes import Data, Named
from evalkit.core.match import Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.scan import Frame
from evalkit.core.timing import NO_COST, CallTiming, timed
from evalkit.execution.sandbox import note_place
from evalkit.execution.task import Result
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.protocols import NoAnswer, Odometry

WARM_UP = 5
"""Scans, or pairs of scans, shown before the clock starts."""

CLOCKS = ("wall_ns", "cpu_ns", "conversion_ns", "device_ns")


def scans_paced(methods: Sequence[Named], on: Data, scans: int) -> Result:
    """Times (C, N) of every scan through every back end, by every clock; ``period_ns``: between the sensor's scans."""
    sequence = registry.dataset(on["dataset"]).make(**on["parameters"])
    frames = list(islice(sequence.frames(), scans))
    sides = [_side(named) for named in methods]
    for side in sides:
        note_place(f"{side.label}, warming up")
        follow = _followed(side)
        for frame in frames[:WARM_UP]:
            follow(frame)()
    calls = [_followed(side) for side in sides]
    taken = [_timed(sides, calls, frame, number) for number, frame in enumerate(frames)]
    stamps = [frame.scan.stamp_ns for frame in frames]
    return {**_columns(taken), "period_ns": float(np.median(np.diff(stamps)))}


def pairs_paced(methods: Sequence[Named], on: Data, count: int) -> Result:
    """Times (C, N) of one registration of every pair of scans; whatever is built over the target is in it."""
    sequence = registry.dataset(on["dataset"]).make(**on["parameters"])
    questions = [pair.question for pair in pairs(sequence, count, exact=False)]
    sides = [_side(named) for named in methods]
    askers = [side.registrations()["s2m"] for side in sides]

    def asked(number: int) -> Callable[[Any], Callable[[], Match]]:
        return lambda q: lambda: askers[number].register(q.target, q.source, q.guess)

    calls = [asked(number) for number in range(len(askers))]
    for question in questions[:WARM_UP]:
        for call in calls:
            call(question)()
    return _columns([_timed(sides, calls, question, number) for number, question in enumerate(questions)])


def _side(named: Named) -> Side:
    """Without a trace: that would cost time."""
    spec = equivalence.side(named["name"], named["name"], named["given"]).spec
    return Side(named["name"], spec, frontend.complete_parameters(named["name"], spec, named["given"]))


def _followed(side: Side) -> Callable[[Frame], Callable[[], OdometryEstimate | None]]:
    odometry: Odometry = frontend.make_odometry(side.spec, side.parameters)

    def update(frame: Frame) -> OdometryEstimate | None:
        try:
            return odometry.update(frame)
        except NoAnswer:
            return None

    return lambda frame: lambda: update(frame)


def _timed(
    sides: list[Side], calls: list[Callable[[Any], Callable[[], Any]]], asked: Any, number: int
) -> list[Mapping[str, int]]:
    """What one question costs each, forwards and backwards in turn."""
    order = range(len(calls)) if number % 2 else reversed(range(len(calls)))
    found: dict[int, CallTiming] = {}
    for which in order:
        note_place(f"{sides[which].label}, question {number + 1}")
        answer, timing = timed(calls[which](asked))
        found[which] = timing.including(NO_COST if answer is None else answer.cost)
    return [{clock: getattr(found[which], clock) for clock in CLOCKS} for which in range(len(calls))]


def _columns(taken: list[list[Mapping[str, int]]]) -> dict[str, Any]:
    return {clock: np.array([[one[clock] for one in row] for row in taken]).T for clock in CLOCKS}
