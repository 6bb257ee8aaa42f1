"""Back ends on slower virtual devices, with invented costs."""

from dataclasses import replace

import numpy as np
import pytest

from evalkit.commands.realtime import simulation
from evalkit.commands.realtime.simulation import (
    LoadedSequence,
    MeasuredCosts,
    ProfiledMethod,
    measure_costs,
    simulate_devices,
    simulate_realtime,
)
from evalkit.commands.realtime.virtual_clock import CostProfile
from evalkit.core.errors import BackendFailed
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.timing import CallTiming
from evalkit.odometry import run_odometry
from evalkit.plugins import registry
from evalkit.plugins.protocols import NoAnswer


@pytest.fixture(scope="module")
def sequence():
    sequence = registry.dataset("lab").make(laps=0.1, seed=3)
    return LoadedSequence(tuple(sequence.frames()), sequence.truth())


@pytest.fixture
def make_profile(monkeypatch):
    """Calls take the costs of the list, or wall and CPU time, repeated in turn."""
    costs = []

    def make_timed(call):
        costs.append(costs.pop(0))
        wall, cpu = costs[-1] if isinstance(costs[-1], tuple) else (costs[-1], costs[-1])
        return call(), CallTiming(wall, cpu)

    monkeypatch.setattr(run_odometry, "timed", make_timed)
    return costs


def even(sequence, cost_ns):
    count = len(sequence.frames)
    result = CostProfile(np.full(count, int(cost_ns)), np.array([1]), np.array([1.0]))
    return MeasuredCosts(result, np.zeros(count, dtype=np.int64), None, np.zeros(count, dtype=np.int64))


def test_a_cost_of_half_a_period_drops_no_scan_and_of_two_and_a_half_periods_three_in_five(sequence):
    method = ProfiledMethod.load("wheel-odometry", {})
    devices = simulate_devices(method, sequence, even(sequence, 50e6), (0.0, 1.0, 5.0), "queue-of-one")
    assert [device.dropped for device in devices[:2]] == [0.0, 0.0]
    assert devices[2].dropped == pytest.approx(0.6, abs=0.02)
    assert [device.late for device in devices] == [0.0, 0.0, 1.0]
    assert devices[1].age_ms == pytest.approx((50.0, 50.0))


def test_wheel_odometry_at_hand_does_not_depend_on_the_device(sequence):
    devices = simulate_devices(
        ProfiledMethod.load("wheel-odometry", {}), sequence, even(sequence, 50e6), (0.0, 5.0, 200.0), "drop"
    )
    ates = [device.at_hand["ate_rmse_m"] for device in devices]
    assert ates == pytest.approx([ates[0]] * 3)
    assert devices[-1].lost == "fewer than two answers"


def test_the_same_profile_gives_the_same_devices(sequence):
    repeated = [
        simulate_devices(
            ProfiledMethod.load("paper", {}), sequence, even(sequence, 30e6), (0.0, 4.0, 20.0), "queue-of-one"
        )
        for _ in range(2)
    ]
    assert repeated[0] == repeated[1]
    dropped = [device.dropped for device in repeated[0]]
    assert dropped == sorted(dropped)


def test_a_profile_is_the_median_of_its_repetitions(sequence, make_profile):
    make_profile.extend([999] * 5 + [10, 20, 30, 40, 50, 60] + [10, 20, 90, 40, 55, 60] + [70, 20, 30, 10, 51, 60])
    result = measure_costs(ProfiledMethod.load("wheel-odometry", {}), sequence.frames[:6], repetitions=3)
    assert result.profile.scans_ns.tolist() == [10, 20, 30, 40, 51, 60]


def test_a_scan_that_waits_in_every_repetition_has_a_wait(sequence, make_profile, monkeypatch):
    monkeypatch.setattr(simulation, "read_waited_ns", lambda _: 0)
    make_profile.extend([(9, 9)] * 5 + [(10, 10), (410, 10), (10, 10), (99, 10), (10, 10), (10, 10)])
    make_profile.extend([(10, 10), (460, 10), (30, 10), (10, 10), (10, 10), (10, 10)])
    result = measure_costs(ProfiledMethod.load("wheel-odometry", {}), sequence.frames[:6], repetitions=2)
    assert result.profile.scans_ns.tolist() == [10] * 6
    assert result.waits_ns.tolist() == [0, 400, 0, 0, 0, 0]  # the busy machine delays others in one repetition only


def test_time_without_a_core_is_no_wait(sequence, make_profile, monkeypatch):
    without_core_ns = iter(range(0, 10_000, 50))
    monkeypatch.setattr(simulation, "read_waited_ns", lambda _: next(without_core_ns))
    make_profile.extend([(9, 9)] * 5 + [(60, 10)] * 6)
    result = measure_costs(ProfiledMethod.load("wheel-odometry", {}), sequence.frames[:6], repetitions=1)
    assert result.waits_ns.tolist() == [0] * 6


@pytest.mark.parametrize(("runs_in", "wait_ns"), [("evalkit", 50), ("program", 0), ("device", 0)])
def test_what_another_process_waits_is_not_known_here(sequence, make_profile, monkeypatch, runs_in, wait_ns):
    """Whatever the scheme of its name: the spec of a back end says where it computes."""
    spec = replace(registry.backend("wheel-odometry"), runs_in=runs_in)
    monkeypatch.setattr(registry, "backend", lambda _: spec)
    monkeypatch.setattr(simulation, "read_waited_ns", lambda _: 0)
    make_profile.extend([(9, 9)] * 5 + [(60, 10)] * 6)
    result = measure_costs(ProfiledMethod.load("wheel-odometry", {}), sequence.frames[:6], repetitions=1)
    assert result.waits_ns.tolist() == [wait_ns] * 6


def test_the_warm_up_is_not_counted_and_gaps_are_compared_with_the_same_scans(sequence, make_profile):
    # 5 to warm up, 12 with every scan, then every second one at three times the cost
    make_profile.extend([999] * 5 + [10] * 12 + [30] * 6)
    result = measure_costs(ProfiledMethod.load("wheel-odometry", {}), sequence.frames[:12], repetitions=1)
    assert result.profile.scans_ns.tolist() == [10] * 12
    assert result.profile.gaps.tolist() == [1, 2]
    assert result.profile.growth.tolist() == [1.0, 3.0]
    assert result.linear is None  # wheel odometry reports no iterations


def test_costs_of_zero_are_refused(sequence, make_profile):
    make_profile.append(0)
    with pytest.raises(BackendFailed, match="no time was measured"):
        measure_costs(ProfiledMethod.load("wheel-odometry", {}), sequence.frames[:8], repetitions=1)


class AlternatingOdometry:
    """Odometry that answers every other scan only."""

    def __init__(self):
        self.calls = 0

    def update(self, frame):
        self.calls += 1
        if self.calls % 2:
            raise NoAnswer("skipped")
        return OdometryEstimate(Pose())


class FailingOdometry:
    def update(self, frame):
        raise RuntimeError("lost")


@pytest.mark.parametrize(("odometry", "why"), [(FailingOdometry, "RuntimeError: lost"), (AlternatingOdometry, "")])
def test_a_failing_back_end_is_lost_and_skipped_scans_are_left_out(sequence, monkeypatch, odometry, why):
    monkeypatch.setattr(ProfiledMethod, "make_odometry", lambda self: odometry())
    (device,) = simulate_devices(ProfiledMethod("wheel-odometry", {}), sequence, even(sequence, 1e6), (1.0,), "drop")
    assert device.lost == why
    assert (device.at_hand["ate_rmse_m"] is None) == bool(why)


def test_a_result_consists_of_json_values_and_arrays():
    import json

    result = simulate_realtime("paper", {}, "lab", {"laps": 0.05, "seed": 1}, (1.0, 1e4), ("drop", "queue-of-one"), 1)
    json.dumps({name: value for name, value in result.items() if not isinstance(value, np.ndarray)})
    assert [(device["policy"], device["factor"]) for device in result["devices"]] == [
        (policy, factor) for policy in ("drop", "queue-of-one") for factor in (0.0, 1.0, 1e4)
    ]
    assert result["linear"]["step_ns"] > 0.0
    assert result["devices"][2]["dropped"] > 0.5
    assert result["headroom"] == pytest.approx((1e8 / result["costs_ns"]).min(), rel=1e-6)
