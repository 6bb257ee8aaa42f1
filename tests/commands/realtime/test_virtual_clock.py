"""The virtual clock: answers worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evalkit.commands.realtime.virtual_clock import (
    POLICIES,
    CostProfile,
    Rule,
    at_hand,
    first_broken,
    headroom,
    linear_cost,
    schedule,
)
from evalkit.core import se2

PERIOD = 100


def arrivals(count):
    return PERIOD * np.arange(count)


def steady(cost):
    return lambda index, gap: cost


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_a_scan_of_up_to_one_period_drops_nothing_and_is_never_late(policy, share):
    made = schedule(arrivals(10), steady(int(share * PERIOD)), policy)
    assert made.answered.tolist() == list(range(10))
    assert not made.late.any()
    assert made.dropped_share == 0.0
    assert (made.age_ns == share * PERIOD).all()


def test_two_and_a_half_periods_answer_every_third_scan_where_waiting_scans_are_lost():
    made = schedule(arrivals(10), steady(250), "drop")
    assert made.answered.tolist() == [0, 3, 6, 9]
    assert made.begun_ns.tolist() == [0, 300, 600, 900]
    assert made.done_ns.tolist() == [250, 550, 850, 1150]
    assert made.late.all()
    assert made.dropped_share == pytest.approx(0.6)


def test_two_and_a_half_periods_answer_the_newest_scan_where_one_waits():
    # 0 works till 250: 2 has taken the place of 1; 2 works till 500: 5 comes in that moment, newer than the waiting 4
    made = schedule(arrivals(10), steady(250), "queue-of-one")
    assert made.answered.tolist() == [0, 2, 5, 7, 9]
    assert made.begun_ns.tolist() == [0, 250, 500, 750, 1000]
    assert made.age_ns.tolist() == [250, 300, 250, 300, 350]


def test_one_slow_scan_costs_the_scans_that_came_meanwhile_and_no_more():
    costs = [10, 330, 10, 10, 10, 10, 10]
    assert schedule(arrivals(7), lambda i, _: costs[i], "drop").answered.tolist() == [0, 1, 5, 6]
    queued = schedule(arrivals(7), lambda i, _: costs[i], "queue-of-one")
    assert queued.answered.tolist() == [0, 1, 4, 5, 6]
    assert queued.late.tolist() == [False, True, False, False, False]  # 4 waited till 430 and was done at 440


def test_the_cost_hears_how_many_scans_lie_since_the_last_answer():
    heard = []
    schedule(arrivals(6), lambda i, gap: heard.append((i, gap)) or 150, "drop")
    assert heard == [(0, 1), (2, 2), (4, 2)]


@given(
    st.lists(st.integers(1, 500), min_size=2, max_size=40),
    st.floats(0.01, 20.0),
    st.floats(1.0, 20.0),
    st.sampled_from(POLICIES),
)
def test_the_same_costs_drop_the_same_scans_and_a_slower_device_answers_not_more(costs, factor, slower, policy):
    profile = CostProfile(np.full(len(costs), costs[0]), np.array([1, 4]), np.array([1.0, 1.5]))
    first, again, later = (
        schedule(arrivals(len(costs)), profile.slowed(f), policy) for f in (factor, factor, factor * slower)
    )
    assert first.answered.tolist() == again.answered.tolist()
    assert first.done_ns.tolist() == again.done_ns.tolist()
    assert later.dropped_share >= first.dropped_share
    varied = schedule(arrivals(len(costs)), lambda i, _: costs[i], policy)
    assert (np.diff(varied.answered) > 0).all()
    assert (varied.begun_ns[1:] >= varied.done_ns[:-1]).all()
    assert (varied.begun_ns >= varied.arrivals_ns[varied.answered]).all()


def test_a_profile_grows_with_the_gap_between_those_measured_and_stays_beyond():
    profile = CostProfile(np.array([100, 200]), np.array([1, 2, 8]), np.array([1.0, 1.5, 2.5]))
    assert [profile.ns(1, gap) for gap in (1, 2, 4, 8, 100)] == pytest.approx([200, 300, 400, 500, 500])
    assert profile.slowed(10.0)(0, 2) == 1500


def test_the_headroom_is_set_by_the_slowest_scan():
    profile = CostProfile(np.array([10, 40, 20]), np.array([1]), np.array([1.0]))
    assert headroom(arrivals(3), profile) == 2.5
    assert not schedule(arrivals(3), profile.slowed(2.5)).late.any()
    assert schedule(arrivals(3), profile.slowed(2.6)).late.any()


def test_the_linear_cost_finds_the_line_it_was_made_of_and_says_how_far_off_others_are():
    work = np.array([0.0, 10.0, 20.0, 40.0])
    found = linear_cost(work, 500.0 + 3.0 * work, [100.0, 100.0], [1600.0, 1600.0])
    assert (found.base_ns, found.step_ns) == pytest.approx((500.0, 3.0))
    assert found.residual == pytest.approx(0.0, abs=1e-9)
    assert found.held_out == pytest.approx(0.5)
    assert linear_cost([7.0, 7.0, 7.0], [1.0, 2.0, 3.0]) is None


def test_between_answers_the_robot_goes_on_by_its_odometry():
    stamps = arrivals(5)
    made = schedule(stamps + 50, steady(200), "drop")  # 0 is done at 250, 2 at 450, 4 after the end
    assert made.answered.tolist() == [0, 2, 4]
    odometry = np.stack([np.arange(5.0), np.zeros(5), np.zeros(5)], axis=1)
    answers = np.array([[0.0, 0.0, 0.0], [10.0, 5.0, np.pi / 2], [99.0, 99.0, 0.0]])
    known = at_hand(stamps, made, answers, odometry)
    assert known == pytest.approx(odometry)  # first the odometry alone, then answer 0 and what it adds
    made = schedule(stamps + 50, steady(120), "drop")  # 0 at 170, 2 at 370, 4 too late
    assert at_hand(stamps, made, answers, odometry)[4] == pytest.approx([10.0, 7.0, np.pi / 2])  # 2 m on, turned


def test_without_odometry_the_robot_goes_on_as_between_its_last_two_answers():
    stamps = arrivals(8)
    made = schedule(stamps, steady(150), "drop")  # 0, 2, 4, 6 done at 150, 350, 550, 750
    answers = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.5], [2.0, 1.0, 1.0], [3.0, 3.0, 1.5]])
    known = at_hand(stamps, made, answers, None)
    assert known[:4] == pytest.approx(np.zeros((4, 3)))  # one answer tells no speed
    step = se2.between(answers[0], answers[1])
    assert known[4] == pytest.approx(se2.compose(answers[1], step))  # 200 ns after answer 2, which took 200 ns
    assert known[5] == pytest.approx(se2.compose(answers[1], se2.fraction(step, np.array([1.5]))[0]))


def test_broken_is_both_far_worse_than_before_and_bad_enough_to_matter():
    rule = Rule(times=2.0, floor_m=0.05)
    assert not rule.broken(0.04, 0.01)
    assert not rule.broken(0.09, 0.05)
    assert rule.broken(0.06, 0.02)
    assert rule.broken(None, 0.02)
    assert first_broken([1.0, 100.0, 10.0], [False, True, True]) == 10.0
    assert first_broken([1.0, 2.0], [False, False]) is None


@pytest.mark.parametrize("times", [[0], [0, 0, 1], [5, 3]])
def test_times_that_do_not_increase_are_refused(times):
    with pytest.raises(ValueError, match="arrivals_ns"):
        schedule(times, steady(1))


def test_an_unknown_policy_and_a_negative_cost_are_refused():
    with pytest.raises(ValueError, match="drop, queue-of-one"):
        schedule(arrivals(3), steady(1), "queue-of-two")
    with pytest.raises(ValueError, match="negative at scan 0"):
        schedule(arrivals(3), steady(-1))
