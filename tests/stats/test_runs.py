"""Intervals over runs: coverage on known distributions, hand calculations, and the number of runs that settles."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import pytest

from evalkit.stats.intervals import Interval
from evalkit.stats.paired_tests import compute_power, detectable_standard_errors
from evalkit.stats.runs import MAX_RUNS, PairedRuns, paired_confidence, paired_runs, runs_interval

TRIALS = 1500


def _samples(kind, runs, rng):
    """Errors with median 1: multiplicative noise, or the length of a random walk (chi distribution, two dimensions)."""
    if kind == "lognormal":
        return np.exp(rng.normal(0.0, 0.7, (TRIALS, runs)))
    if kind == "normal":
        return rng.normal(1.0, 0.1, (TRIALS, runs))
    return np.hypot(*rng.normal(0.0, 1.0, (2, TRIALS, runs))) / math.sqrt(2.0 * math.log(2.0))


@pytest.mark.parametrize("kind", ["lognormal", "normal", "walk"])
@pytest.mark.parametrize("runs", [3, 5, 8])
def test_intervals_of_three_and_more_runs_hold_the_median_as_often_as_stated(kind, runs):
    """A binomial share of 0.95 in 1,500 trials has a standard error of 0.006."""
    rows = _samples(kind, runs, np.random.default_rng(runs))
    held = [not interval.excludes(1.0) for row in rows if (interval := runs_interval(row)) is not None]
    assert len(held) == TRIALS
    assert 0.90 <= np.mean(held) <= 0.97


@pytest.mark.parametrize(
    ("bad", "runs", "stated"), [(0.30, 6, 0.91), (0.30, 8, 0.86), (0.30, 20, 0.55), (0.15, 8, 0.96), (0.15, 20, 0.82)]
)
def test_of_a_method_that_fails_now_and_then_intervals_hold_the_median_as_rarely_as_the_page_states(bad, runs, stated):
    """Of the good runs, of spread 0.2, a share of 0.5 / (1 - bad) lies below the median of all."""
    rng = np.random.default_rng(runs)
    median = math.exp(0.2 * NormalDist().inv_cdf(0.5 / (1.0 - bad)))
    rows = np.exp(rng.normal(0.0, 0.2, (2 * TRIALS, runs))) * np.where(rng.random((2 * TRIALS, runs)) < bad, 10.0, 1.0)
    held = [not interval.excludes(median) for row in rows if (interval := runs_interval(row)) is not None]
    assert np.mean(held) == pytest.approx(stated, abs=0.03)


@pytest.mark.parametrize("kind", ["lognormal", "walk"])
@pytest.mark.parametrize("runs", [2, 3, 8])
def test_equal_methods_differ_in_at_most_five_percent(kind, runs):
    rng = np.random.default_rng(runs)
    pairs = zip(_samples(kind, runs, rng), _samples(kind, runs, rng), strict=True)
    shown = [paired_runs(one, other).interval.excludes(0.0) for one, other in pairs]
    assert np.mean(shown) <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / TRIALS)


@pytest.mark.parametrize("runs", [3, 4, 5, 8])
def test_exchanged_labels_of_unlike_methods_give_few_verdicts(runs):
    """One method has three times the error of the other, with a spread of 50 %; labels are exchanged in each run."""
    rng = np.random.default_rng(runs)
    ratios = (np.log(3.0) + rng.normal(0.0, 0.5, (TRIALS, runs))) * rng.choice([-1.0, 1.0], (TRIALS, runs))
    shown = [paired_runs(np.exp(row), np.ones(runs)).interval.excludes(0.0) for row in ratios]
    assert np.mean(shown) <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / TRIALS)


def test_a_lead_over_every_one_of_five_equal_methods_is_rarer_than_five_percent():
    """The best of five must lead each of the others: choosing it after the fact adds no false leads."""
    rng = np.random.default_rng(0)
    leads = 0
    for _ in range(400):
        errors = np.exp(rng.normal(0.0, 0.5, (5, 4)))
        first, *others = errors[np.argsort(np.median(errors, axis=1))]
        leads += all(paired_runs(other, first).interval.low > 0.0 for other in others)
    assert leads / 400 <= 0.05


def test_fewer_than_three_runs_have_no_interval_and_one_pair_no_difference():
    assert runs_interval([0.1, 0.2]) is None
    assert paired_runs([0.1], [0.2]) is None
    assert paired_runs([], []) is None


def test_the_interval_of_three_runs_by_hand():
    """Logarithms 0, ln 2, ln 4: mean ln 2, standard error ln 2 / sqrt(3), t(0.975, 2) = 4.30265."""
    found = runs_interval([4.0, 1.0, 2.0])
    half = 4.30265 * math.log(2.0) / math.sqrt(3.0)
    assert (found.value, found.support) == (2.0, 3)
    assert (found.low, found.high) == pytest.approx((2.0 * math.exp(-half), 2.0 * math.exp(half)), rel=1e-5)


def test_values_that_are_not_all_positive_are_compared_by_differences():
    """Differences 0.1, 0.2, 0.3: mean 0.2, standard error 0.1 / sqrt(3)."""
    found = paired_runs([0.1, 0.2, 0.3], [0.0, 0.0, 0.0])
    half = 9.92484 * 0.1 / math.sqrt(3.0)
    assert (found.interval.low, found.interval.high) == pytest.approx((0.2 - half, 0.2 + half), abs=1e-6)
    moved = paired_runs([0.0, 0.1, 0.2], [-0.1, -0.1, -0.1]).interval
    assert (moved.low, moved.high) == pytest.approx((found.interval.low, found.interval.high))


def test_the_difference_does_not_depend_on_the_unit():
    one, other = np.array([0.2, 0.3, 0.25]), np.array([0.1, 0.2, 0.2])
    metres, millimetres = paired_runs(one, other), paired_runs(1000.0 * one, 1000.0 * other)
    assert millimetres.interval.low == pytest.approx(1000.0 * metres.interval.low)
    assert millimetres.runs_needed() == metres.runs_needed()


def test_twice_the_noise_makes_the_detectable_difference_twice_as_large():
    noise = np.random.default_rng(5).normal(0.0, 0.001, 8)
    noise -= noise.mean()
    small, large = (paired_runs(np.exp(0.1 + factor * noise), np.ones(8)).detectable for factor in (1.0, 2.0))
    assert large / small == pytest.approx(2.0, rel=0.01)
    assert 0.0005 < small < 0.005  # of the size of the noise, in the unit of the values


def test_the_number_of_runs_that_settles_is_the_first_with_the_power():
    found = paired_runs(np.exp([0.0, 0.3, 0.5]), [1.0, 1.0, 1.0])
    needed = found.runs_needed()
    effect = np.mean([0.0, 0.3, 0.5]) / np.std([0.0, 0.3, 0.5], ddof=1)
    power = [
        compute_power(effect * math.sqrt(runs), runs - 1, 1.0 - paired_confidence(runs, perturbed=False))
        for runs in (needed - 1, needed)
    ]
    assert power[0] < 0.8 <= power[1]
    assert paired_runs([1.0, 1.0], [1.0, 1.0]).runs_needed() is None
    assert paired_runs([2.0, 2.0001, 2.0002], [1.0, 1.0, 1.0]).runs_needed() == 2
    assert paired_runs([1.0, 1.02, 0.97], [1.0, 1.0, 1.0]).runs_needed() is None  # more than MAX_RUNS
    assert MAX_RUNS == 200


@pytest.mark.parametrize("runs", [6, 7, 8])
def test_perturbed_runs_that_hardly_change_get_no_verdict_from_their_signs_in_more_than_five_percent(runs):
    """Differences of two values with a random sign: only equal signs are clear, 2 in 2^runs cases."""
    shown = 0
    for pattern in range(2**runs):
        signs = np.array([1.0 if pattern >> bit & 1 else -1.0 for bit in range(runs)])
        found = paired_runs(np.exp(signs * np.linspace(1.0, 1.001, runs)), np.ones(runs), perturbed=True)
        shown += found.interval.excludes(0.0)
    assert shown == 2
    assert shown / 2**runs <= 0.05
    assert found.runs_needed() >= 6


def test_few_and_perturbed_pairs_are_compared_with_more_confidence():
    assert [paired_confidence(runs, False) for runs in (5, 6)] == [0.99, 0.97]
    assert paired_confidence(6, True) == 0.99


def test_a_difference_without_any_spread_needs_no_further_run_and_none_no_number():
    constant = paired_runs([1.0, 0.0, 3.0], [0.0, -1.0, 2.0])
    assert constant.runs_needed() == 3
    assert paired_runs([1.0, 0.0, 3.0], [1.0, 0.0, 3.0]).runs_needed() is None


@pytest.mark.parametrize("perturbed", [False, True])
@pytest.mark.parametrize("runs", [2, 5, 6, 7, 50, 199, 200, 201])
def test_a_difference_that_so_many_runs_just_detect_needs_so_many(runs, perturbed):
    """A difference of standard deviation 1 over four pairs; at most 200 runs, and at least 6 that are perturbed."""
    errors = detectable_standard_errors(runs - 1, alpha=1.0 - paired_confidence(runs, perturbed))
    for side, expected in ((1.0 + 1e-6, runs), (1.0 - 1e-6, runs + 1)):
        mean = -side * errors / math.sqrt(runs)
        found = PairedRuns(Interval(mean, -9.0, 9.0, 4, 0.99), mean, 0.5, math.nan, perturbed).runs_needed()
        assert found == (None if expected > 200 else max(expected, 6) if perturbed else expected)


def test_values_with_a_zero_have_an_interval_without_logarithms_that_holds_their_median():
    """Of 0, 1, 5: mean 2, standard error sqrt(7 / 3), t(0.975, 2) = 4.30265."""
    half = 4.30265 * math.sqrt(7.0 / 3.0)
    found = runs_interval([5.0, 0.0, 1.0])
    assert (found.value, found.low, found.high) == pytest.approx((1.0, 2.0 - half, 2.0 + half), abs=1e-4)
    skewed = runs_interval([1.0] * 30 + [1e6] * 29)
    assert skewed.low == skewed.value == 1.0


def test_two_pairs_are_compared_and_the_detectable_difference_has_its_unit():
    """Ratios e^0.1 and e^0.3 of 2.0: mean 0.2, standard error 0.1, t(0.995, 1) = 63.657; differences 1 and 3 of 0."""
    found = paired_runs(2.0 * np.exp([0.1, 0.3]), [2.0, 2.0])
    assert found.interval.value == pytest.approx(2.0 * math.expm1(0.2))
    assert found.interval.high == pytest.approx(2.0 * math.expm1(0.2 + 6.3657), rel=1e-4)
    assert (found.interval.support, found.interval.confidence, found.perturbed) == (2, 0.99, False)
    errors = detectable_standard_errors(1, alpha=0.01)
    assert found.detectable == pytest.approx(2.0 * math.expm1(0.1 * errors))
    assert paired_runs([1.0, 3.0], [0.0, 0.0]).detectable == pytest.approx(errors)


def test_a_detectable_improvement_is_a_part_of_the_value_and_a_detectable_loss_may_be_a_multiple():
    """Log-ratios 0.9 and 1.1, or -0.9 and -1.1, of 2.0: standard error 0.1; the same factor, up or down."""
    factor = math.exp(0.1 * detectable_standard_errors(1, alpha=0.01))
    worse, better = (paired_runs(2.0 * np.exp([sign * 0.9, sign * 1.1]), [2.0, 2.0]) for sign in (1.0, -1.0))
    assert worse.detectable == pytest.approx(2.0 * (factor - 1.0))
    assert factor > 2.0
    assert better.detectable == pytest.approx(2.0 * (1.0 - 1.0 / factor))


def test_factors_beyond_e_to_the_50_are_given_as_that():
    """Ratios e^49.9 and e^50.1 and their inverses: neither bound nor detectable difference overflows."""
    apart = paired_runs(np.exp([400.0, 500.0]), [3.0, 3.0])
    assert apart.interval.value == apart.interval.high == apart.detectable == 3.0 * math.expm1(50.0)
    assert paired_runs(np.exp([49.0, 49.0]), [1.0, 1.0]).interval.high == pytest.approx(math.expm1(49.0), rel=1e-6)
