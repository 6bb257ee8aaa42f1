"""Intervals, paired differences and tests, against published figures, hand calculation and coverage."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from evalkit.stats.bootstrap import (
    block_length,
    bootstrap_interval,
    draw_block_means,
    draw_block_rows,
    expanded_percentile_interval,
    paired_difference_interval,
)
from evalkit.stats.intervals import Interval, wilson_interval
from evalkit.stats.paired_tests import (
    adjust_by_holm,
    signed_rank_tests,
    smallest_detectable_difference,
    vargha_delaney_a12,
)
from evalkit.stats.ranks import FriedmanTest, NotTested, friedman_test, success_curve, success_quantiles

# Demsar, JMLR 7, 2006, table 6: AUC of C4.5, C4.5+m, C4.5+cf, C4.5+m+cf over 14 data sets. In the last but one line
# he prints 0.975 twice and ranks the first before the second: they are equal only as printed.
DEMSAR = (
    (0.763, 0.768, 0.771, 0.798), (0.599, 0.591, 0.590, 0.569), (0.954, 0.971, 0.968, 0.967),
    (0.628, 0.661, 0.654, 0.657), (0.882, 0.888, 0.886, 0.898), (0.936, 0.931, 0.916, 0.931),
    (0.661, 0.668, 0.609, 0.685), (0.583, 0.583, 0.563, 0.625), (0.775, 0.838, 0.866, 0.875),
    (1.000, 1.000, 1.000, 1.000), (0.940, 0.962, 0.965, 0.962), (0.619, 0.666, 0.614, 0.669),
    (0.972, 0.981, 0.9751, 0.975), (0.957, 0.978, 0.946, 0.970),
)  # fmt: skip


def test_wilson_gives_the_published_interval():
    """Newcombe, Stat. Med. 17, 1998, table I: 81 of 263 and 15 of 148, to four decimals."""
    assert _bounds(wilson_interval(81, 263)) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert _bounds(wilson_interval(15, 148)) == pytest.approx((0.0624, 0.1605), abs=5e-5)
    assert _bounds(wilson_interval(0, 20)) == pytest.approx((0.0, 0.1611), abs=5e-5)


@given(st.integers(1, 200).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_of_failures_is_wilson_of_successes_turned_round(case: tuple[int, int]):
    successes, trials = case
    low, high = _bounds(wilson_interval(successes, trials))
    assert _bounds(wilson_interval(trials - successes, trials)) == pytest.approx((1.0 - high, 1.0 - low))
    assert 0.0 <= low <= successes / trials <= high <= 1.0


def test_wilson_asks_for_a_trial():
    with pytest.raises(ValueError, match="at least one trial"):
        wilson_interval(0, 0)


def test_a_block_is_ten_seconds_and_never_more_than_a_fifth():
    assert block_length(1000, 0.1) == 100
    assert block_length(200, 0.1) == 40
    assert block_length(1000) == 10
    assert block_length(3, 0.1) == 1


def test_blocks_of_one_agree_with_the_interval_of_independent_values():
    """The expanded percentile of a mean is Student's t interval but for the shape of the values (Hesterberg 2015)."""
    values = np.random.default_rng(4).normal(3.0, 2.0, 12)
    found = bootstrap_interval(values, np.mean, np.random.default_rng(0), block=1, draws=20000)
    exact = stats.t.interval(0.95, 11, values.mean(), values.std(ddof=1) / math.sqrt(12))
    assert found.value == pytest.approx(values.mean())
    assert _bounds(found) == pytest.approx(exact, abs=0.12)


def test_fast_means_are_the_means_of_the_same_blocks():
    values = np.random.default_rng(1).normal(1e6, 1.0, 103)
    rows = draw_block_rows(103, 10, np.random.default_rng(7), 50)
    fast = draw_block_means(values, 10, np.random.default_rng(7), 50)
    assert fast == pytest.approx(values[rows].mean(axis=1), rel=1e-12)
    assert (np.diff(rows[:, :10], axis=1) == 1).all()


def test_dependent_values_are_covered_nineteen_times_in_twenty():
    """AR(1) with coefficient 0.9 (one part in 400 is left after 6 s at 10 Hz), 60 s a run: 95 % of 400 runs."""
    rng = np.random.default_rng(11)
    held = naive = 0
    for _ in range(400):
        series = _autoregressive(600, 0.9, rng)
        blocked = expanded_percentile_interval(0.0, draw_block_means(series, 100, rng, 500), 600, 6.0)
        single = expanded_percentile_interval(0.0, draw_block_means(series, 1, rng, 500), 600, 600.0)
        held += not blocked.excludes(0.0)
        naive += not single.excludes(0.0)
    assert 0.91 <= held / 400 <= 0.985
    assert naive / 400 < 0.5


def test_a_shared_disturbance_cancels_in_paired_differences():
    rng = np.random.default_rng(3)
    shared = np.abs(_autoregressive(600, 0.95, rng))
    a, b = shared + 0.010 + rng.normal(0.0, 0.001, 600), shared + rng.normal(0.0, 0.001, 600)
    paired = paired_difference_interval(a, b, rng, 100)
    alone = bootstrap_interval(a, np.mean, rng, 100)
    assert paired.excludes(0.0)
    assert paired.value == pytest.approx(0.010, abs=2e-4)
    assert paired.high - paired.low < 0.01 * (alone.high - alone.low)


def test_the_same_seed_gives_the_same_interval():
    values = np.random.default_rng(0).normal(size=100)
    once, twice = (bootstrap_interval(values, np.median, np.random.default_rng(5)) for _ in range(2))
    assert once == twice


def test_holm_steps_down_and_never_turns_round():
    """Worked by hand: 0.01 x 4, 0.02 x 3, 0.03 x 2 raised to 0.06, 0.04 x 1 raised to 0.06."""
    assert adjust_by_holm([0.04, 0.01, 0.03, 0.02]) == pytest.approx((0.06, 0.04, 0.06, 0.06))
    assert adjust_by_holm([0.9, 0.8]) == (1.0, 1.0)


def test_wilcoxon_counts_signs_exactly_and_a_failure_as_the_worst():
    """Better in all of 6: p = 2 / 2^6. A failure on one side is the largest rank: 2 P(W <= 6) = 2 * 14 / 64."""
    better = np.arange(6) + 1.0
    failed = np.array([0.5, 1.0, 1.5, 2.0, 2.5, math.inf])
    found = signed_rank_tests({
        "six better": (better - 0.1 * np.arange(1, 7), better),
        "one failed": (failed, np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])),
        "alike": ([1.0, math.inf], [1.0, math.inf]),
    })  # fmt: skip
    assert found["six better"].p == pytest.approx(2 / 64)
    assert found["one failed"].p == pytest.approx(28 / 64)
    assert found["one failed"].p_holm == pytest.approx(56 / 64)
    assert (found["alike"].pairs, found["alike"].p) == (0, 1.0)


def test_vargha_delaney_counts_by_hand():
    """Of 3 x 3 pairs, 2 are larger and 2 are ties: (2 + 1) / 9; turned round it is the rest."""
    a, b = [1.0, 2.0, 4.0], [2.0, 3.0, 4.0]
    assert vargha_delaney_a12(a, b) == pytest.approx(3 / 9)
    assert vargha_delaney_a12(b, a) == pytest.approx(6 / 9)
    assert vargha_delaney_a12([math.inf], [math.inf]) == 0.5


def test_half_a_standard_deviation_takes_thirty_four_pairs():
    """The textbook sample size for d = 0.5, 80 % power, 5 %, two-sided, paired (Cohen 1988): 34, not 33."""

    def detectable(pairs: int) -> float:
        series = np.arange(pairs, dtype=np.float64)
        return smallest_detectable_difference(series / series.std(ddof=1))

    assert detectable(34) <= 0.5 < detectable(33)
    assert smallest_detectable_difference([0.1]) == math.inf


def test_friedman_and_the_critical_difference_are_demsars():
    """His example: mean ranks 3.143, 2.000, 2.893, 1.964, chi-square 9.28, critical difference 1.25."""
    found = friedman_test(-np.array(DEMSAR))
    assert isinstance(found, FriedmanTest)
    assert found.mean_ranks == pytest.approx((3.143, 2.000, 2.893, 1.964), abs=5e-4)
    uncorrected = 12 * 14 / (4 * 5) * (sum(rank**2 for rank in found.mean_ranks) - 4 * 25 / 4)
    assert uncorrected == pytest.approx(9.28, abs=5e-3)
    tied = 3 * (2**3 - 2) + (4**3 - 4)  # three pairs and a line of four, which he did not allow for
    assert found.statistic == pytest.approx(uncorrected / (1 - tied / (14 * 4 * (4**2 - 1))))
    assert found.critical_difference == pytest.approx(1.25, abs=5e-3)


def test_seven_sequences_are_too_few_for_ranks():
    assert friedman_test(np.ones((7, 3))) == NotTested(
        "ranks with a critical difference need at least 8 sequences, found 7"
    )


def test_failed_trials_hold_every_curve_down():
    errors = [0.01, 0.02, 0.03, math.inf]
    assert success_curve(errors, [0.0, 0.02, 1.0]) == pytest.approx([0.0, 0.5, 0.75])
    assert success_quantiles(errors) == (0.02, 0.03, math.inf)


def test_an_interval_tells_what_it_excludes():
    assert Interval(0.5, 0.1, 0.9, 5).excludes(0.0)
    assert not Interval(0.5, -0.1, 0.9, 5).excludes(0.0)
    with pytest.raises(ValueError, match="low"):
        Interval(0.0, 1.0, 0.0, 5)


def _bounds(interval: Interval) -> tuple[float, float]:
    return interval.low, interval.high


def _autoregressive(count: int, coefficient: float, rng: np.random.Generator) -> np.ndarray:
    series = rng.normal(size=count)
    series[0] /= math.sqrt(1.0 - coefficient**2)
    for index in range(1, count):
        series[index] += coefficient * series[index - 1]
    return series
