"""The virtual clock: expected values calculated by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evalkit.commands.realtime.virtual_clock import (
    POLICIES,
    BreakingRule,
    CostProfile,
    compute_headroom,
    compute_live_poses,
    compute_schedule,
    find_breaking_factor,
    fit_linear_cost,
)
from evalkit.core import se2

PERIOD = 100


def arrivals(count):
    return PERIOD * np.arange(count)


def steady(cost):
    return lambda index, gap: cost


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_cost_of_up_to_one_period_drops_no_scan_and_is_never_late(policy, share):
    schedule = compute_schedule(arrivals(10), steady(int(share * PERIOD)), policy)
    assert schedule.answered.tolist() == list(range(10))
    assert not schedule.late.any()
    assert schedule.dropped_share == 0.0
    assert (schedule.age_ns == share * PERIOD).all()


def test_a_cost_of_two_and_a_half_periods_answers_every_third_scan_without_a_queue():
    schedule = compute_schedule(arrivals(10), steady(250), "drop")
    assert schedule.answered.tolist() == [0, 3, 6, 9]
    assert schedule.begun_ns.tolist() == [0, 300, 600, 900]
    assert schedule.done_ns.tolist() == [250, 550, 850, 1150]
    assert schedule.late.all()
    assert schedule.dropped_share == pytest.approx(0.6)


def test_a_cost_of_two_and_a_half_periods_answers_the_newest_scan_with_a_queue_of_one():
    # scan 0 ends at 250: 2 has replaced 1; scan 2 ends at 500: 5 arrives at that moment and replaces 4
    schedule = compute_schedule(arrivals(10), steady(250), "queue-of-one")
    assert schedule.answered.tolist() == [0, 2, 5, 7, 9]
    assert schedule.begun_ns.tolist() == [0, 250, 500, 750, 1000]
    assert schedule.age_ns.tolist() == [250, 300, 250, 300, 350]


def test_one_slow_scan_drops_only_the_scans_that_arrive_meanwhile():
    costs = [10, 330, 10, 10, 10, 10, 10]
    assert compute_schedule(arrivals(7), lambda i, _: costs[i], "drop").answered.tolist() == [0, 1, 5, 6]
    queued = compute_schedule(arrivals(7), lambda i, _: costs[i], "queue-of-one")
    assert queued.answered.tolist() == [0, 1, 4, 5, 6]
    assert queued.late.tolist() == [False, True, False, False, False]  # 4 waits until 430 and ends at 440


def test_the_cost_function_receives_the_gap_since_the_last_answer():
    calls = []
    compute_schedule(arrivals(6), lambda i, gap: calls.append((i, gap)) or 150, "drop")
    assert calls == [(0, 1), (2, 2), (4, 2)]


@given(
    st.lists(st.integers(1, 500), min_size=2, max_size=40),
    st.floats(0.01, 20.0),
    st.floats(1.0, 20.0),
    st.sampled_from(POLICIES),
)
def test_the_schedule_is_repeatable_and_a_slower_device_answers_no_more_scans(costs, factor, slower, policy):
    profile = CostProfile(np.full(len(costs), costs[0]), np.array([1, 4]), np.array([1.0, 1.5]))
    first, again, later = (
        compute_schedule(arrivals(len(costs)), profile.slow_down(f), policy) for f in (factor, factor, factor * slower)
    )
    assert first.answered.tolist() == again.answered.tolist()
    assert first.done_ns.tolist() == again.done_ns.tolist()
    assert later.dropped_share >= first.dropped_share
    varied = compute_schedule(arrivals(len(costs)), lambda i, _: costs[i], policy)
    assert (np.diff(varied.answered) > 0).all()
    assert (varied.begun_ns[1:] >= varied.done_ns[:-1]).all()
    assert (varied.begun_ns >= varied.arrivals_ns[varied.answered]).all()


def test_the_growth_is_interpolated_between_gaps_and_constant_beyond():
    profile = CostProfile(np.array([100, 200]), np.array([1, 2, 8]), np.array([1.0, 1.5, 2.5]))
    assert [profile.ns(1, gap) for gap in (1, 2, 4, 8, 100)] == pytest.approx([200, 300, 400, 500, 500])
    assert profile.slow_down(10.0)(0, 2) == 1500


def test_the_headroom_is_set_by_the_slowest_scan():
    profile = CostProfile(np.array([10, 40, 20]), np.array([1]), np.array([1.0]))
    assert compute_headroom(arrivals(3), profile) == (2.5, 1, 100.0)
    assert not compute_schedule(arrivals(3), profile.slow_down(2.5)).late.any()
    assert compute_schedule(arrivals(3), profile.slow_down(2.6)).late.any()


def test_the_linear_fit_recovers_its_line_and_reports_the_held_out_error():
    work = np.array([0.0, 10.0, 20.0, 40.0])
    fit = fit_linear_cost(work, 500.0 + 3.0 * work, [100.0, 100.0], [1600.0, 1600.0])
    assert (fit.base_ns, fit.step_ns) == pytest.approx((500.0, 3.0))
    assert fit.residual == pytest.approx(0.0, abs=1e-9)
    assert fit.held_out == pytest.approx(0.5)
    assert fit_linear_cost([7.0, 7.0, 7.0], [1.0, 2.0, 3.0]) is None


def test_poses_between_answers_follow_the_odometry():
    stamps = arrivals(5)
    schedule = compute_schedule(stamps + 50, steady(200), "drop")  # 0 is done at 250, 2 at 450, 4 after the end
    assert schedule.answered.tolist() == [0, 2, 4]
    odometry = np.stack([np.arange(5.0), np.zeros(5), np.zeros(5)], axis=1)
    answers = np.array([[0.0, 0.0, 0.0], [10.0, 5.0, np.pi / 2], [99.0, 99.0, 0.0]])
    known = compute_live_poses(stamps, schedule, answers, odometry)
    assert known == pytest.approx(odometry)  # first the odometry alone, then answer 0 and the odometry since
    schedule = compute_schedule(stamps + 50, steady(120), "drop")  # 0 at 170, 2 at 370, 4 too late
    assert compute_live_poses(stamps, schedule, answers, odometry)[4] == pytest.approx(
        [10.0, 7.0, np.pi / 2]
    )  # 2 m on, turned


def test_without_odometry_poses_continue_at_the_last_speed():
    stamps = arrivals(8)
    schedule = compute_schedule(stamps, steady(150), "drop")  # 0, 2, 4, 6 done at 150, 350, 550, 750
    answers = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [2.0, 1.0, 1.0], [3.0, 3.0, 1.5]])
    known = compute_live_poses(stamps, schedule, answers, None)
    assert known[:4] == pytest.approx(np.zeros((4, 3)))  # one answer gives no speed
    step = se2.between(answers[0], answers[1])
    assert known[4] == pytest.approx(se2.compose(answers[1], step))  # 200 ns after answer 2, which took 200 ns
    assert known[5] == pytest.approx(se2.compose(answers[1], se2.fraction(step, np.array([1.5]))[0]))


def test_a_run_is_broken_if_its_error_is_relatively_and_absolutely_large():
    rule = BreakingRule(times=2.0, floor_m=0.05)
    assert not rule.is_broken(0.04, 0.01)
    assert not rule.is_broken(0.09, 0.05)
    assert rule.is_broken(0.06, 0.02)
    assert rule.is_broken(None, 0.02)
    assert find_breaking_factor([1.0, 100.0, 10.0], [False, True, True]) == 10.0
    assert find_breaking_factor([1.0, 2.0], [False, False]) is None


@pytest.mark.parametrize("times", [[0], [0, 0, 1], [5, 3]])
def test_arrivals_that_do_not_increase_are_refused(times):
    with pytest.raises(ValueError, match="arrivals_ns"):
        compute_schedule(times, steady(1))


def test_an_unknown_policy_and_a_negative_cost_are_rejected():
    with pytest.raises(ValueError, match="drop, queue-of-one"):
        compute_schedule(arrivals(3), steady(1), "queue-of-two")
    with pytest.raises(ValueError, match="negative at scan 0"):
        compute_schedule(arrivals(3), steady(-1))


@pytest.mark.parametrize("fields", [([5], [1], [1.0]), ([5, 0], [1], [1.0])])
def test_costs_of_scans_are_two_or_more_and_positive(fields):
    with pytest.raises(ValueError, match="scans_ns: expected two or more positive costs"):
        CostProfile(*map(np.array, fields))


@pytest.mark.parametrize(("gaps", "growth"), [([1, 2], [1.0]), ([2, 3], [1.0, 1.1]), ([1, 1], [1.0, 1.1])])
def test_the_growth_of_a_cost_belongs_to_rising_gaps_from_1(gaps, growth):
    with pytest.raises(ValueError, match="gaps: expected 1 and increasing whole numbers"):
        CostProfile(np.array([5, 6]), np.array(gaps), np.array(growth))
