"""Run-time metrics, computed from records with known times."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult, Score
from evalkit.metrics import runtime
from evalkit.metrics.metric import Evidence


def scores(cpu_ms: list[float], wall_ms: list[float], memory_bytes: int = 0, shift_ns: int = 0) -> dict[str, Score]:
    """Score a run at 10 Hz; a tenth of the CPU time is conversion."""
    steps = np.zeros(len(cpu_ms), STEP)
    steps["stamp_ns"] = np.arange(len(cpu_ms)) * 100_000_000 + shift_ns
    steps["cpu_ns"] = np.array(cpu_ms) * 1e6
    steps["wall_ns"] = np.array(wall_ms) * 1e6
    steps["conversion_ns"] = steps["cpu_ns"] // 10
    steps["preparation_ns"] = steps["cpu_ns"] // 4
    steps["harness_ns"] = 2_000_000
    run = RunResult(steps, len(steps), peak_memory_bytes=memory_bytes)
    evidence = Evidence(run, Truth("exact"))
    return {metric.name: metric.compute(evidence) for metric in runtime.METRICS}


def test_times_equal_a_hand_calculation() -> None:
    found = scores([10.0, 20.0, 30.0, 40.0, 150.0], [12.0, 22.0, 32.0, 100.0, 101.0], 256 * 2**20)
    assert found["cpu_median_ms"] == Score(30.0, 5)
    assert found["cpu_max_ms"].value == 150.0
    assert found["cpu_p95_ms"].value == pytest.approx(128.0)  # four fifths of the way from 40 to 150
    assert found["cpu_p99_ms"].value == pytest.approx(145.6)  # 0.96 of that way
    assert found["wall_median_ms"].value == 32.0
    assert found["conversion_percent"].value == pytest.approx(10.0)
    assert found["preparation_percent"].value == pytest.approx(25.0)
    assert found["real_time_factor"].value == pytest.approx(2.0)  # 100 ms over a mean of 50 ms
    assert found["late_percent"].value == 20.0  # 150 ms of CPU time; 100 ms at 10 Hz is exactly real time
    assert found["late_wall_percent"].value == 20.0  # 101 ms on the wall clock
    assert found["peak_memory_mib"].value == 256.0
    assert found["harness_median_ms"].value == 2.0


def test_the_time_origin_does_not_matter() -> None:
    times = [10.0, 20.0, 30.0]
    assert scores(times, times) == scores(times, times, shift_ns=1_700_000_000 * 10**9)


def test_one_dropped_scan_does_not_change_the_sensor_period() -> None:
    steps = np.zeros(9, STEP)
    steps["stamp_ns"] = np.delete(np.arange(10), 4) * 100_000_000
    assert runtime.period_ns(RunResult(steps, 10)) == 100_000_000


def test_skipped_scans_do_not_change_the_sensor_period() -> None:
    steps = np.zeros(10, STEP)
    steps["stamp_ns"], steps["cpu_ns"], steps["wall_ns"] = np.arange(10) * 100_000_000, 50_000_000, 101_000_000
    found = []
    for every in (1, 2):
        run = RunResult(steps[::every], len(steps[::every]), every=every)
        evidence = Evidence(run, Truth("exact"))
        found.append({metric.name: metric.compute(evidence).value for metric in runtime.METRICS})
    assert found[0]["real_time_factor"] == found[1]["real_time_factor"] == pytest.approx(2.0)
    assert found[0]["late_percent"] == found[1]["late_percent"] == 0.0  # 50 ms of CPU time
    assert found[0]["late_wall_percent"] == found[1]["late_wall_percent"] == 100.0  # 101 ms on a busy machine


def test_a_device_is_late_by_its_own_clock() -> None:
    steps = np.zeros(4, STEP)
    steps["stamp_ns"], steps["device_ns"] = np.arange(4) * 100_000_000, [90_000_000, 110_000_000, 0, 0]
    evidence = Evidence(RunResult(steps, 4), Truth("exact"))
    assert {m.name: m.compute(evidence) for m in runtime.METRICS}["late_percent"] == Score(25.0, 4)


def test_work_on_a_device_has_no_cpu_time_though_the_front_end_answers_the_first_scan() -> None:
    steps = np.zeros(5, STEP)
    steps["stamp_ns"], steps["cpu_ns"] = np.arange(5) * 100_000_000, [400_000, 0, 0, 0, 0]
    evidence = Evidence(RunResult(steps, 5), Truth("exact"))
    found = {m.name: m.compute(evidence) for m in runtime.METRICS}
    for name in ("cpu_median_ms", "cpu_max_ms", "conversion_percent", "real_time_factor", "late_percent"):
        assert found[name] == Score(None, 5, "not measured on this machine: no CPU time")
    assert not any(runtime.is_measured(RunResult(steps, 5), clock) for clock in ("cpu_ns", "wall_ns", "device_ns"))


def test_unmeasured_times_give_a_reason() -> None:
    nothing = scores([], [])
    assert nothing["cpu_median_ms"].reason == "the run has no poses"
    assert nothing["real_time_factor"].reason == "fewer than two scans have a pose"
    idle = scores([0.0, 0.0], [0.0, 0.0])
    assert idle["real_time_factor"].reason == "not measured on this machine: no CPU time"
    assert idle["peak_memory_mib"].reason == "memory was not measured"


def test_two_scans_have_a_period_and_one_has_none() -> None:
    two = scores([50.0, 100.0], [100.0, 101.0])
    assert (two["late_percent"], two["late_wall_percent"]) == (Score(0.0, 2), Score(50.0, 2))  # 100 ms is in time
    assert (two["real_time_factor"].value, two["real_time_factor"].support) == (pytest.approx(100.0 / 75.0), 2)
    one = scores([50.0], [50.0])
    for name in ("late_percent", "late_wall_percent", "real_time_factor"):
        assert one[name] == Score(None, 1, "fewer than two scans have a pose")


@pytest.mark.parametrize(("measured", "enough"), [(2, False), (3, True)])
def test_cpu_time_counts_as_measured_where_more_than_half_of_the_scans_have_it(measured, enough) -> None:
    steps = np.zeros(4, STEP)
    steps["stamp_ns"] = np.arange(4) * 100_000_000
    steps["cpu_ns"][:measured], steps["device_ns"] = 150_000_000, 7
    run = RunResult(steps, 4)
    assert runtime.is_measured(run, "cpu_ns") == enough
    assert runtime.work_ns(run).tolist() == ([150_000_000] * 3 + [0] if enough else [7] * 4)
    assert runtime.late_share(run) == (0.75 if enough else 0.0)
    assert runtime.late_share(RunResult(steps[:1], 1)) == 0.0
