"""The timed region, on a clock that only moves when told."""

import pytest

from evalkit.core import timing
from evalkit.core.timing import Timing, conversion, timed


class Hands:
    """Wall and CPU time in ns."""

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
    made = Hands()
    monkeypatch.setattr(timing, "time", made)
    return made


def test_a_call_costs_its_wall_and_cpu_time_and_answers(hands):
    def call():
        hands.work(500, 300)
        return "answer"

    hands.work(7, 7)
    assert timed(call) == ("answer", Timing(500, 300, 0))


def test_conversions_within_the_call_are_summed_and_those_before_are_not(hands):
    def convert(cpu):
        with conversion():
            hands.work(cpu, cpu)

    def call():
        convert(10)
        hands.work(100, 100)
        convert(20)

    convert(1_000)
    assert timed(call)[1] == Timing(130, 130, 30)
    assert timed(call)[1] == Timing(130, 130, 30)


def test_a_conversion_that_fails_is_counted_and_its_error_is_told(hands):
    def convert():
        with conversion():
            hands.work(40, 40)
            raise ValueError("no such thing")

    def call():
        with pytest.raises(ValueError, match="no such thing"):
            convert()

    assert timed(call)[1].conversion_ns == 40


def test_a_failing_call_fails_as_it_is():
    with pytest.raises(ZeroDivisionError):
        timed(lambda: 1 // 0)
