"""The conditions of a run: hand calculations from planted counters, and this machine."""

import threading
import time
from pathlib import Path

import pytest

from evalkit.core.run_result import RunConditions
from evalkit.execution import conditions
from evalkit.execution.conditions import ConditionsMeter, WaitingMeter, measure_own_threads


def test_foreign_and_stolen_time_equal_a_hand_calculation(monkeypatch):
    """Of 10 s, the core was busy for 9 s, of which the run used 7 s, and 0.5 s were stolen."""
    clock = [100.0]
    counters = [conditions._Counters(1000.0, 5.0)]
    monkeypatch.setattr(conditions.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(conditions, "_read_counters", lambda core: counters[0])
    monkeypatch.setattr(conditions, "_read_mhz", lambda: [2000.0 + clock[0]])
    loads = iter([1.0, 3.0])
    monkeypatch.setattr(conditions.os, "getloadavg", lambda: (next(loads), 0.0, 0.0))
    meter = ConditionsMeter(0)
    clock[0], counters[0] = 110.0, conditions._Counters(1009.0, 5.5)
    meter.update(7.0)
    clock[0] = 110.3
    meter.update(99.0)  # too early: the counters are read every half second
    found = meter.conclude({"waited_percent": 3.0, "busy_threads": 1})
    assert (found.load, found.mhz, found.waited_percent) == (2.0, pytest.approx(2110.15), 3.0)
    assert (found.other_percent, found.steal_percent) == (pytest.approx(20.0), pytest.approx(5.0))
    assert found.disturbed


@pytest.mark.parametrize(
    ("values", "disturbed"),
    [
        ({}, False),
        ({"other_percent": 5.0, "steal_percent": 2.0, "waited_percent": 5.0, "load": 90.0}, False),
        ({"other_percent": 5.1}, True),
        ({"steal_percent": 2.1}, True),
        ({"waited_percent": 5.1, "busy_threads": 1}, True),
        ({"waited_percent": 80.0, "busy_threads": 4}, False),  # its own threads wait for each other
    ],
)
def test_a_run_is_disturbed_beyond_a_limit(values, disturbed):
    assert RunConditions(**values).disturbed is disturbed
    assert RunConditions(**values).as_dict()["disturbed"] is disturbed


@pytest.mark.parametrize("reported", [{"load": "much"}, {"threads": -1}, {"unknown": 1}, {"mhz": float("inf")}])
def test_what_a_back_end_writes_about_itself_is_not_trusted(reported):
    assert ConditionsMeter(None).conclude(reported).threads is None


@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="no such counter here")
def test_waiting_is_at_most_the_time_that_passed():
    meter = WaitingMeter()
    until = time.monotonic() + 0.05
    while time.monotonic() < until:
        pass
    assert 0.0 <= meter.percent() < 100.0


def test_threads_that_compute_are_counted_and_idle_ones_are_not():
    stop, started = threading.Event(), threading.Barrier(4)

    def idle():
        started.wait()
        stop.wait()

    before = measure_own_threads(None)
    idlers = [threading.Thread(target=idle) for _ in range(3)]
    for thread in idlers:
        thread.start()
    started.wait()
    found = measure_own_threads(1.5)
    stop.set()
    assert found.threads == before.threads + 3
    assert found.busy_threads == before.busy_threads
    assert found.waited_percent == 1.5


@pytest.mark.skipif(not Path("/proc/stat").exists(), reason="no such counter here")
def test_a_reading_takes_no_more_calls_than_its_file_has_lines(call_count):
    """A reading every 0.5 s must stay under 1 %: 5 ms. It opens one file and splits each line, and lists no process."""
    lines = Path("/proc/stat").read_text().count("\n")
    conditions._read_counters(0)
    with call_count.counting():
        conditions._read_counters(0)
    assert 0 < call_count.calls < lines + 200
