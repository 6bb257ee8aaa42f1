"""Intervals against published figures."""

from __future__ import annotations

import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from evalkit.stats.intervals import Interval, student_quantile, wilson_interval


def test_wilson_gives_the_published_interval():
    """Newcombe, Stat. Med. 17, 1998, table I: 81 of 263 and 15 of 148, to four decimals."""
    assert _bounds(wilson_interval(81, 263)) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert _bounds(wilson_interval(15, 148)) == pytest.approx((0.0624, 0.1605), abs=5e-5)
    assert _bounds(wilson_interval(0, 20)) == pytest.approx((0.0, 0.1611), abs=5e-5)


def test_intervals_need_no_scipy_stats_which_takes_as_long_to_import_as_a_small_comparison_computes():
    code = (
        "import sys\n"
        "import numpy as np\n"
        "from evalkit.stats import bootstrap, intervals, ranks, runs\n"
        "intervals.wilson_interval(1, 3)\n"
        "bootstrap.expanded_percentile_interval(0.0, np.arange(9.0), 9, 9)\n"
        "runs.runs_interval([1.0, 2.0, 4.0])\n"
        "ranks.compute_ranks([[1.0, 2.0]])\n"
        "print('scipy.stats' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


@given(st.integers(1, 200).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_of_failures_mirrors_wilson_of_successes(case: tuple[int, int]):
    successes, trials = case
    low, high = _bounds(wilson_interval(successes, trials))
    assert _bounds(wilson_interval(trials - successes, trials)) == pytest.approx((1.0 - high, 1.0 - low))
    assert 0.0 <= low <= successes / trials <= high <= 1.0


@pytest.mark.parametrize(("successes", "trials"), [(0, 0), (-1, 3), (4, 3)])
def test_wilson_needs_a_trial_and_no_more_successes_than_trials(successes, trials):
    with pytest.raises(ValueError, match=f"expected 0 to {trials} of at least one trial, got {successes}"):
        wilson_interval(successes, trials)


def test_the_quantiles_of_student_are_those_of_the_printed_table():
    """Two-sided, 95 %: 12.706, 4.303 and 2.042 for 1, 2 and 30 degrees of freedom; 99 %: 63.657 for one."""
    assert [student_quantile(freedom) for freedom in (1, 2, 30)] == pytest.approx([12.706, 4.303, 2.042], abs=5e-4)
    assert student_quantile(1, 0.99) == pytest.approx(63.657, abs=5e-4)


def test_an_interval_excludes_values_outside_its_bounds():
    assert Interval(0.5, 0.1, 0.9, 5).excludes(0.0)
    assert not Interval(0.5, -0.1, 0.9, 5).excludes(0.0)
    assert [Interval(0.5, 0.5, 0.5, 1).excludes(value) for value in (0.4, 0.5, 0.6)] == [True, False, True]
    assert not Interval(0.5, 0.0, 0.9, 5).excludes()
    assert Interval(0.5, 0.1, 0.9, 5).confidence == 0.95
    with pytest.raises(ValueError, match="low"):
        Interval(0.0, 1.0, 0.0, 5)


def _bounds(interval: Interval) -> tuple[float, float]:
    return interval.low, interval.high


@pytest.mark.parametrize("confidence", [0.0, 1.0, float("nan")])
def test_a_confidence_lies_between_0_and_1(confidence):
    with pytest.raises(ValueError, match="confidence: expected a number between 0 and 1"):
        Interval(1.0, 0.0, 2.0, 5, confidence)
