"""The rules on the state of a Registration: nothing but its arguments may decide an answer, here, later, elsewhere."""

from __future__ import annotations

import ctypes
import mmap
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from evalkit.commands.validate.rules.elsewhere import FORKS, count_other_copies, in_another_thread, run_elsewhere
from evalkit.commands.validate.rules.endurance import BATCHES
from evalkit.commands.validate.rules.rule import RuleBroken, RuleNotApplicable, is_refusal, require_own_process
from evalkit.commands.validate.rules.scenes import CloudPair, drawn_pair
from evalkit.core.errors import format_exception
from evalkit.core.match import Match
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.plugins.protocols import Registration

if TYPE_CHECKING:
    from evalkit.commands.validate.rules.registration_fixture import RegistrationFixture

Bits = tuple[object, ...]

MemoryPlace = Literal["middle", "end", "beginning"]
"""Of clouds in their memory."""

LATER_S, PAUSES_S = 3.0, (0.0, 0.6, 0.6)
"""The first answers are asked for again after at least this time (s), and after pauses: in odd and even seconds."""


def answer_bits(registration: Registration, pair: CloudPair) -> Bits:
    """All fields of an answer, to compare to the bit, or the refusal; raises what is no refusal."""
    try:
        match = registration.register(pair.target, pair.source, pair.guess)
    except Exception as error:
        if not is_refusal(error):
            raise
        return (format_exception(error),)
    return match_bits(match)


def match_bits(match: Match) -> Bits:
    """All fields of a match and of its trace, to compare to the bit."""
    trace = [(*one.target_from_source.row.tolist(), repr(one.error), one.inliers) for one in match.history]
    return (
        *match.target_from_source.row.tolist(), match.converged, match.iterations, repr(match.error), match.inliers,
        *trace,
    )  # fmt: skip


def check_call_order(fixture: RegistrationFixture) -> str:
    """The order of calls does not matter."""
    pairs, expected = fixture.questions, fixture.first_answers
    one = fixture.make()
    for count, number in enumerate(
        np.random.default_rng(fixture.seed).permutation(np.repeat(np.arange(len(pairs)), 3))
    ):
        _require(expected[number], answer_bits(one, pairs[number]), f"as call {count + 1} in another order")
    return f"{3 * len(pairs)} calls in a drawn order answer as new objects do"


def check_many_calls(fixture: RegistrationFixture) -> str:
    """After thousands of calls the answers are the same."""
    expected, calls = fixture.first_answers, fixture.endurance.size * BATCHES
    for number, pair in enumerate(fixture.questions):
        _require(expected[number], answer_bits(fixture.worn or fixture.make(), pair), f"after {calls} calls")
    return f"{len(expected)} answers are the same to the bit after {calls} calls"


def check_buffers(fixture: RegistrationFixture) -> str:
    """The same buffers with other content, in whole or in part, give the answer to the other content."""
    groups = list(_groups_of_one_size(fixture))
    expected = [[answer_bits(fixture.make(), pair) for pair in group] for group in groups]
    one, calls = fixture.make(), 0
    for group, wanted in zip(groups, expected, strict=True):
        with shared_memory() as target, shared_memory() as source:
            for pair, bits in zip(group * 2, wanted * 2, strict=True):
                inside = CloudPair(target.cloud(pair.target), source.cloud(pair.source), pair.truth, pair.guess)
                _require(bits, answer_bits(one, inside), "from the buffers of the call before")
                calls += 1
    return f"{calls} calls with the same buffers answer as new objects do"


def _groups_of_one_size(fixture: RegistrationFixture) -> Iterator[list[CloudPair]]:
    """Questions of one size each: unrelated ones, and some whose clouds differ in the middle alone."""
    yield [pair for pair in fixture.questions if len(pair.target) == len(fixture.questions[0].target)]
    rng = np.random.default_rng([fixture.seed, 3])
    for size in (60, 1500):
        pair = drawn_pair(rng, size, 60)
        target, source = (_shift_middle(one, rng) for one in (pair.target, pair.source))
        yield [pair, replace(pair, target=target), pair, replace(pair, source=source)]


def _shift_middle(cloud: Cloud, rng: np.random.Generator) -> Cloud:
    """The cloud with its middle half moved by some centimetres; the first and the last points stay."""
    points, count = cloud.points.copy(), len(cloud)
    points[count // 4 : 3 * count // 4] += rng.uniform(0.03, 0.08, 2)
    return Cloud(points)


BOUNDS_STEPS: Mapping[MemoryPlace, str] = {
    "middle": "a call whose clouds are read-only: does it write to them, or keep those of an earlier call?",
    "end": "a call with no memory behind its clouds: does it access what is behind them?",
    "beginning": "a call with no memory before its clouds: does it access what is before them?",
}
"""By the place of clouds in their memory: what a process that ends there was asked."""


def check_bounds(fixture: RegistrationFixture) -> str:
    """It reads its arguments within their bounds, does not write to them, and does not keep them."""
    require_own_process(fixture.runs_in)
    one = fixture.make()
    for pair in fixture.questions[:3]:
        for place, step in BOUNDS_STEPS.items():
            with shared_memory(place) as target, shared_memory(place) as source:
                inside = CloudPair(target.cloud(pair.target), source.cloud(pair.source), pair.truth, pair.guess)
                target.protect()
                source.protect()
                expected = answer_bits(fixture.make(), pair)
                fixture.note_progress(step)
                _require(expected, answer_bits(one, inside), "beside protected memory")
            # both regions are inaccessible from here on
    return "no access beside the buffers, no write, none after the call"


def check_instances(fixture: RegistrationFixture) -> str:
    """Several instances, with other parameters, do not disturb each other."""
    expected, pairs = fixture.first_answers, fixture.questions
    one, others = fixture.make(), [fixture.make()]
    for changes in ({}, *fixture.variants()):
        others.append(fixture.make_with(**changes))
        what = ", ".join(f"{name} = {value}" for name, value in changes.items()) or "the same parameters"
        for number, pair in enumerate(pairs):
            _require(expected[number], answer_bits(one, pair), f"beside a later instance with {what}")
            answer_bits(others[number % len(others)], pairs[-1 - number])
    return f"{len(pairs)} answers unchanged beside {len(others)} other instances"


def check_thread(fixture: RegistrationFixture) -> str:
    """A second thread gets the same answers."""
    one = fixture.make()
    for number, pair in enumerate(fixture.questions):
        found = in_another_thread(partial(answer_bits, one, pair))
        _require(fixture.first_answers[number], found, "in a second thread")
        _require(fixture.first_answers[number], answer_bits(one, pair), "in the first thread after a second one")
    return f"{len(fixture.questions)} answers in a second thread are the same to the bit"


def check_process(fixture: RegistrationFixture) -> str:
    """Another process, with other addresses and other values in fresh memory, gets the same answers."""
    if not fixture.elsewhere:
        raise RuleNotApplicable("it has no address by which another process finds it")
    found = run_elsewhere(answers_elsewhere, fixture.elsewhere)
    for expected, other in zip(fixture.first_answers, found["answers"], strict=True):
        _require(_plain(expected), other, "in another process")
    if found["copies"]:
        raise RuleBroken(f"{found['copies']} of {FORKS} copies of a process, with other numbers, have other answers")
    return f"{len(found['answers'])} answers in another process are the same to the bit"


def check_later(fixture: RegistrationFixture) -> str:
    """The answers are the same seconds later."""
    expected = fixture.first_answers
    time.sleep(max(0.0, LATER_S - (time.monotonic() - fixture.asked_s)))
    for pause_s in PAUSES_S:
        time.sleep(pause_s)
        for number, pair in enumerate(fixture.questions):
            when = f"{time.monotonic() - fixture.asked_s:.1f} s later"
            _require(expected[number], answer_bits(fixture.make(), pair), when)
    return f"{len(expected)} answers are the same {time.monotonic() - fixture.asked_s:.0f} s later"


STATE_RULES = (
    check_many_calls, check_call_order, check_buffers, check_bounds, check_instances, check_thread, check_process,
    check_later,
)  # fmt: skip


def answers_elsewhere(*, address: dict[str, str], parameters: dict[str, Any], seed: int) -> dict[str, Any]:
    """The answers to the questions of a seed, in this process."""
    from evalkit.commands.validate.rules import runner  # noqa: PLC0415 - which imports the rules

    fixture = runner.load_fixture(address, parameters, seed)
    answers = [_plain(one) for one in fixture.first_answers]
    return {"answers": answers, "copies": _count_other_copies(fixture)}


def _count_other_copies(fixture: RegistrationFixture) -> int:
    expected = fixture.first_answers
    return count_other_copies(
        lambda: all(
            answer_bits(fixture.make(), one) == bits for one, bits in zip(fixture.questions, expected, strict=True)
        )
    )


def _plain(bits: Bits) -> list[object]:
    return [list(one) if isinstance(one, tuple) else one for one in bits]


def _require(expected: Any, found: Any, when: str) -> None:
    if expected == found:
        return
    if len(expected) < 3 or len(found) < 3:
        raise RuleBroken(f"the same question has another outcome {when}: {found[0]}, before {expected[0]}")
    names = ("x", "y", "theta", "converged", "iterations", "error", "inliers", *(["trace"] * 999))
    name, before, after = next(
        (name, a, b) for name, a, b in zip(names, [*expected, None], [*found, None], strict=False) if a != b
    )
    raise RuleBroken(f"the same question has another answer {when}: {name} {after}, before {before}")


class Region:
    """Pages of memory between two inaccessible ones, and the place of clouds in it."""

    PAGES = 16

    def __init__(self, place: MemoryPlace) -> None:
        self._size = self.PAGES * mmap.PAGESIZE
        self._map = mmap.mmap(-1, self._size + 2 * mmap.PAGESIZE)
        self._base = ctypes.addressof(ctypes.c_char.from_buffer(self._map))
        self._place = place
        self._set(self._base, mmap.PAGESIZE, 0)
        self._set(self._base + mmap.PAGESIZE + self._size, mmap.PAGESIZE, 0)

    def cloud(self, cloud: Cloud) -> Cloud:
        """The same points in this memory."""
        size = cloud.points.nbytes
        if size > self._size:
            raise ValueError(f"region: {size} bytes do not fit into {self._size}")
        free = self._size - size
        start = mmap.PAGESIZE + {"middle": free // 16 * 8, "end": free, "beginning": 0}[self._place]
        points: Floats = np.frombuffer(self._map, dtype=np.float64, count=size // 8, offset=start).reshape(-1, 2)
        points[:] = cloud.points
        points.flags.writeable = False
        moved = Cloud(np.zeros((0, 2)), cloud.frame)
        object.__setattr__(moved, "points", points)  # a Cloud copies; here the memory is the question
        return moved

    def protect(self) -> None:
        """Make the memory read-only."""
        self._set(self._base + mmap.PAGESIZE, self._size, 1)

    def close(self) -> None:
        """Make the memory inaccessible; it is never returned to the system, so no later access finds other data."""
        self._set(self._base + mmap.PAGESIZE, self._size, 0)

    @staticmethod
    def _set(address: int, size: int, protection: int) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mprotect(ctypes.c_void_p(address), ctypes.c_size_t(size), protection):
            raise OSError(ctypes.get_errno(), "mprotect")


_KEPT: list[Region] = []


@contextmanager
def shared_memory(place: MemoryPlace = "end") -> Iterator[Region]:
    """Memory for a cloud that becomes inaccessible at the end."""
    region = Region(place)
    _KEPT.append(region)
    try:
        yield region
    finally:
        region.close()
