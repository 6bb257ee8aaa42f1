"""Back ends on slower and slower virtual devices, with costs that are made up."""

import numpy as np
import pytest

from evalkit.commands.realtime.simulation import LoadedSequence, Measured, Method, ladder, paced, profile
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
def invented(monkeypatch):
    """Calls cost what the list says, in turn and over again."""
    costs = []

    def timed(call):
        costs.append(costs.pop(0))
        return call(), CallTiming(costs[-1], costs[-1])

    monkeypatch.setattr(run_odometry, "timed", timed)
    return costs


def even(sequence, cost_ns):
    count = len(sequence.frames)
    found = CostProfile(np.full(count, int(cost_ns)), np.array([1]), np.array([1.0]))
    return Measured(found, np.zeros(count, dtype=np.int64), None)


def test_half_a_period_drops_nothing_and_five_halves_three_in_five(sequence):
    method = Method.of("wheel-odometry", {})
    rungs = ladder(method, sequence, even(sequence, 50e6), (0.0, 1.0, 5.0), "queue-of-one")
    assert [rung.dropped for rung in rungs[:2]] == [0.0, 0.0]
    assert rungs[2].dropped == pytest.approx(0.6, abs=0.02)
    assert [rung.late for rung in rungs] == [0.0, 0.0, 1.0]
    assert rungs[1].age_ms == pytest.approx((50.0, 50.0))


def test_the_wheels_alone_are_as_good_at_hand_however_slow_the_device(sequence):
    rungs = ladder(Method.of("wheel-odometry", {}), sequence, even(sequence, 50e6), (0.0, 5.0, 200.0), "drop")
    ates = [rung.at_hand["ate_rmse_m"] for rung in rungs]
    assert ates == pytest.approx([ates[0]] * 3)
    assert rungs[-1].lost == "fewer than two answers"


def test_the_same_profile_gives_the_same_ladder(sequence):
    ladders = [
        ladder(Method.of("paper", {}), sequence, even(sequence, 30e6), (0.0, 4.0, 20.0), "queue-of-one")
        for _ in range(2)
    ]
    assert ladders[0] == ladders[1]
    dropped = [rung.dropped for rung in ladders[0]]
    assert dropped == sorted(dropped)


def test_a_profile_is_the_median_of_its_repetitions(sequence, invented):
    invented.extend([999] * 5 + [10, 20, 30, 40, 50, 60] + [10, 20, 90, 40, 55, 60] + [70, 20, 30, 10, 51, 60])
    found = profile(Method.of("wheel-odometry", {}), sequence.frames[:6], repetitions=3)
    assert found.profile.scans_ns.tolist() == [10, 20, 30, 40, 51, 60]


def test_the_warm_up_is_in_no_number_and_gaps_are_held_against_the_same_scans(sequence, invented):
    # 5 to warm up, 12 of every scan, then every second one at three times the cost
    invented.extend([999] * 5 + [10] * 12 + [30] * 6)
    found = profile(Method.of("wheel-odometry", {}), sequence.frames[:12], repetitions=1)
    assert found.profile.scans_ns.tolist() == [10] * 12
    assert found.profile.gaps.tolist() == [1, 2]
    assert found.profile.growth.tolist() == [1.0, 3.0]
    assert found.linear is None  # the wheels tell of no iterations


def test_costs_that_nobody_measured_are_refused(sequence, invented):
    invented.append(0)
    with pytest.raises(BackendFailed, match="no time was measured"):
        profile(Method.of("wheel-odometry", {}), sequence.frames[:8], repetitions=1)


class Shy:
    """Answers every other scan only."""

    def __init__(self):
        self.asked = 0

    def update(self, frame):
        self.asked += 1
        if self.asked % 2:
            raise NoAnswer("not this one")
        return OdometryEstimate(Pose())


class Lost:
    def update(self, frame):
        raise RuntimeError("lost")


@pytest.mark.parametrize(("odometry", "why"), [(Lost, "RuntimeError: lost"), (Shy, "")])
def test_who_fails_is_lost_and_who_leaves_scans_out_is_measured_on_the_others(sequence, monkeypatch, odometry, why):
    monkeypatch.setattr(Method, "fresh", lambda self: odometry())
    (rung,) = ladder(Method("shy", {}), sequence, even(sequence, 1e6), (1.0,), "drop")
    assert rung.lost == why
    assert (rung.at_hand["ate_rmse_m"] is None) == bool(why)


def test_a_measured_run_is_made_of_json_values_and_arrays():
    import json

    found = paced("paper", {}, "lab", {"laps": 0.05, "seed": 1}, (1.0, 1e4), ("drop", "queue-of-one"), 1)
    json.dumps({name: value for name, value in found.items() if not isinstance(value, np.ndarray)})
    assert [(rung["policy"], rung["factor"]) for rung in found["rungs"]] == [
        (policy, factor) for policy in ("drop", "queue-of-one") for factor in (0.0, 1.0, 1e4)
    ]
    assert found["linear"]["step_ns"] > 0.0
    assert found["rungs"][2]["dropped"] > 0.5
    assert found["headroom"] == pytest.approx((1e8 / found["costs_ns"]).min(), rel=1e-6)
