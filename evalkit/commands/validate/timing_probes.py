"""Times of several back ends side by side: all of them process a scan before the next one, in alternating order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from evalkit.commands.validate.equivalence import comparison
from evalkit.commands.validate.equivalence.lockstep import ComparedBackend
from evalkit.commands.validate.probes import Data, Plugin, load_sequence
from evalkit.commands.validate.scan_pairs import scan_pairs
from evalkit.core.match import Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.scan import Frame
from evalkit.core.timing import NO_COST, CallTiming, timed
from evalkit.execution.sandbox import note_place
from evalkit.execution.task import Result
from evalkit.odometry import frontend
from evalkit.odometry.run_odometry import answer_frame
from evalkit.plugins.protocols import NoAnswer

WARM_UP = 5
"""Scans, or pairs of scans, processed before the measurement starts."""

CLOCKS = ("wall_ns", "cpu_ns", "conversion_ns", "device_ns")


def time_scans(methods: Sequence[Plugin], on: Data, scans: int) -> Result:
    """Times (C, N) of every scan through every back end, by every clock; ``period_ns``: median period of the sensor."""
    frames = list(islice(load_sequence(on).frames(), scans))
    backends = [_load_untraced(method) for method in methods]
    for backend in backends:
        note_place(f"{backend.label}, warming up")
        update = _odometry_call(backend)
        for frame in frames[:WARM_UP]:
            update(frame)()
    calls = [_odometry_call(backend) for backend in backends]
    times = [_time_each(backends, calls, frame, number) for number, frame in enumerate(frames)]
    stamps = [frame.scan.stamp_ns for frame in frames]
    return {**_columns(times), "period_ns": float(np.median(np.diff(stamps)))}


def time_pairs(methods: Sequence[Plugin], on: Data, count: int) -> Result:
    """Times (C, N) of one registration of every pair of scans, including what is built over the target."""
    questions = [pair.question for pair in scan_pairs(load_sequence(on), count, exact=False)]
    backends = [_load_untraced(method) for method in methods]
    registrations = [backend.registrations()["s2m"] for backend in backends]

    def registration_call(number: int) -> Callable[[Any], Callable[[], Match]]:
        return lambda q: lambda: registrations[number].register(q.target, q.source, q.guess)

    calls = [registration_call(number) for number in range(len(registrations))]
    for question in questions[:WARM_UP]:
        for call in calls:
            call(question)()
    return _columns([_time_each(backends, calls, question, number) for number, question in enumerate(questions)])


def _load_untraced(method: Plugin) -> ComparedBackend:
    """A back end without a trace of its iterations, which would cost time."""
    spec = comparison.load_backend(method["name"], method["name"], method["given"]).spec
    return ComparedBackend(
        method["name"], spec, frontend.complete_parameters(method["name"], spec, method["given"])
    )  # fmt: skip


def _odometry_call(backend: ComparedBackend) -> Callable[[Frame], Callable[[], OdometryEstimate | NoAnswer]]:
    odometry = frontend.make_odometry(backend.spec, backend.parameters)
    return lambda frame: partial(answer_frame, odometry, frame)


def _time_each(
    backends: list[ComparedBackend], calls: list[Callable[[Any], Callable[[], Any]]], question: Any, number: int
) -> list[Mapping[str, int]]:
    """The times of one question for each back end, in alternating order."""
    order = range(len(calls)) if number % 2 else reversed(range(len(calls)))
    timings: dict[int, CallTiming] = {}
    for index in order:
        note_place(f"{backends[index].label}, question {number + 1}")
        answer, timing = timed(calls[index](question))
        timings[index] = timing.including(NO_COST if isinstance(answer, NoAnswer) else answer.cost)
    return [{clock: getattr(timings[index], clock) for clock in CLOCKS} for index in range(len(calls))]


def _columns(times: list[list[Mapping[str, int]]]) -> dict[str, Any]:
    return {clock: np.array([[one[clock] for one in row] for row in times]).T for clock in CLOCKS}
