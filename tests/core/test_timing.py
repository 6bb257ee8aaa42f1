"""Timing of a call, on a clock that the test advances."""

import pytest

from evalkit.core import timing
from evalkit.core.timing import CallTiming, Cost, Stopwatch, timed


class ManualClock:
    """Clock with wall and CPU time in ns."""

    def __init__(self):
        self.wall = self.cpu = 1_000

    def work(self, wall, cpu):
        self.wall += wall
        self.cpu += cpu

    def perf_counter_ns(self):
        return self.wall

    def process_time_ns(self):
        return self.cpu


@pytest.fixture
def hands(monkeypatch):
    made = ManualClock()
    monkeypatch.setattr(timing, "time", made)
    return made


def test_a_timed_call_returns_its_result_with_wall_and_cpu_time(hands):
    def call():
        hands.work(500, 300)
        return "answer"

    hands.work(7, 7)
    assert timed(call) == ("answer", CallTiming(500, 300))


def test_a_stopwatch_sums_the_cpu_time_of_its_blocks_only(hands):
    conversion = Stopwatch()
    hands.work(1_000, 1_000)
    for cpu in (10, 20):
        with conversion:
            hands.work(99, cpu)
        hands.work(100, 100)
    assert conversion.cpu_ns == 30


def test_a_stopwatch_counts_a_failing_block_and_propagates_its_error(hands):
    conversion = Stopwatch()

    def fail():
        with conversion:
            hands.work(40, 40)
            raise ValueError("no such thing")

    with pytest.raises(ValueError, match="no such thing"):
        fail()
    assert conversion.cpu_ns == 40


@pytest.mark.parametrize(
    ("cost", "timing"),
    [
        (Cost(), CallTiming(500, 300)),
        (Cost(conversion_ns=30), CallTiming(500, 300, 30)),
        (Cost(preparation_ns=40), CallTiming(500, 300, preparation_ns=40)),
        (Cost(30, program_cpu_ns=200, device_ns=80), CallTiming(500, 500, 30, 80)),
        (Cost(30, device_ns=80, withheld=frozenset({"cpu"})), CallTiming(500, 0, 30, 80)),
        (Cost(withheld=frozenset({"wall", "cpu"})), CallTiming(0, 0)),
    ],
)
def test_a_timing_includes_the_reported_cost(cost, timing):
    assert CallTiming(500, 300).including(cost) == timing


def test_costs_add_up():
    assert Cost(1, 2, 3) + Cost(10, 20, 30, frozenset({"cpu"})) == Cost(11, 22, 33, frozenset({"cpu"}))


def test_a_failing_call_raises_its_own_error():
    with pytest.raises(ZeroDivisionError):
        timed(lambda: 1 // 0)
