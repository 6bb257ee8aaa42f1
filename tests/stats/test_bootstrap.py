"""Moving-block bootstrap against exact intervals, coverage and slow computations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from evalkit.stats.bootstrap import (
    DRAWS,
    Series,
    block_length,
    bootstrap_interval,
    bootstrap_score,
    compute_statistic,
    draw_block_means,
    draw_block_rows,
    expanded_percentile_interval,
    paired_difference_interval,
)
from evalkit.stats.intervals import Interval


def test_a_block_is_ten_seconds_and_at_most_a_fifth():
    assert block_length(1000, 0.1) == 100
    assert block_length(200, 0.1) == 40
    assert block_length(1000) == 10
    assert block_length(3, 0.1) == 1
    assert block_length(1) == 1


@pytest.mark.parametrize(
    ("statistic", "value"), [("rms", 5.0), ("mean", 13.0 / 3.0), ("median", 5.0), ("inverse", 3.0 / 13.0)]
)
def test_each_statistic_of_a_small_series(statistic, value):
    series = Series(np.arange(3), np.array([1.0, 5.0, 7.0]), statistic, None)
    assert compute_statistic(series) == pytest.approx(value, rel=1e-12)


def test_draws_of_a_score_lie_around_it_in_its_own_unit():
    series = Series(np.arange(300), np.random.default_rng(3).normal(4.0, 1.0, 300), "inverse", None)
    plain = bootstrap_score(series, 0.25, np.random.default_rng(0))
    scaled = bootstrap_score(series, 250.0, np.random.default_rng(0))
    assert np.median(plain.values) == pytest.approx(0.25, rel=0.02)
    assert scaled.values == pytest.approx(1000.0 * plain.values)


@pytest.mark.parametrize(("score", "fits"), [(4.0, True), (4.3, True), (4.6, False), (3.4, False)])
def test_a_series_that_does_not_give_the_score_is_not_resampled(score, fits):
    series = Series(np.arange(100), np.tile([3.0, 5.0], 50), "mean", None)
    assert (bootstrap_score(series, score, np.random.default_rng(0)) is not None) == fits


def test_blocks_of_one_agree_with_the_interval_of_independent_values():
    """The expanded percentile of a mean approximates Student's t interval (Hesterberg 2015)."""
    values = np.random.default_rng(4).normal(3.0, 2.0, 12)
    found = bootstrap_interval(values, np.mean, np.random.default_rng(0), block=1, draws=20000)
    exact = stats.t.interval(0.95, 11, values.mean(), values.std(ddof=1) / math.sqrt(12))
    assert found.value == pytest.approx(values.mean())
    assert _bounds(found) == pytest.approx(exact, abs=0.12)


def test_fast_means_equal_the_means_of_the_same_blocks():
    values = np.random.default_rng(1).normal(1e6, 1.0, 103)
    rows = draw_block_rows(103, 10, np.random.default_rng(7), 50)
    fast = draw_block_means(values, 10, np.random.default_rng(7), 50)
    assert fast == pytest.approx(values[rows].mean(axis=1), rel=1e-12)
    assert (np.diff(rows[:, :10], axis=1) == 1).all()


def test_intervals_of_dependent_values_have_their_coverage():
    """AR(1) with coefficient 0.9 (correlation 1/400 after 6 s at 10 Hz), 60 s per run: 95 % of 400 runs."""
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


def _autoregressive(count: int, coefficient: float, rng: np.random.Generator) -> np.ndarray:
    series = rng.normal(size=count)
    series[0] /= math.sqrt(1.0 - coefficient**2)
    for index in range(1, count):
        series[index] += coefficient * series[index - 1]
    return series


def _bounds(interval: Interval) -> tuple[float, float]:
    return interval.low, interval.high


def test_a_block_of_all_values_begins_at_the_first():
    draws = draw_block_rows(4, 4, np.random.default_rng(0), 3)
    assert draws.tolist() == [[0, 1, 2, 3]] * 3


def test_blocks_of_nothing_are_refused():
    with pytest.raises(ValueError, match="scans: expected at least one, got 0"):
        block_length(0)
    with pytest.raises(ValueError, match="block: expected 1 to 3 values, got 4"):
        bootstrap_interval([1.0, 2.0, 3.0], np.mean, np.random.default_rng(0), 4)


STATISTICS = {
    "mean": np.mean,
    "rms": lambda values: math.sqrt(np.mean(values**2)),
    "median": np.median,
    "inverse": lambda values: 1.0 / np.mean(values) if values.any() else 0.0,
}


@pytest.mark.parametrize("statistic", STATISTICS)
@pytest.mark.parametrize("period_s", [None, 2.5])
def test_draws_of_a_score_are_its_statistic_of_the_resampled_series_by_its_own_factor(statistic, period_s):
    """In millimetres with many zeros, 5 % above the statistic; a median of 251 values and more takes every second."""
    plain = STATISTICS[statistic]
    for count in (20, 250, 251):
        values = np.zeros(count)
        values[::3] = np.random.default_rng(count).uniform(0.001, 0.002, len(values[::3]))
        values += 0.0005 * (statistic == "median")
        thin = 2 if statistic == "median" and count == 251 else 1
        block = block_length(len(values[::thin]), None if period_s is None else thin * period_s)
        found = bootstrap_score(
            Series(np.arange(count), values, statistic, period_s), 1.05 * plain(values), np.random.default_rng(0)
        )
        assert found is not None
        rows = draw_block_rows(len(values[::thin]), block, np.random.default_rng(0), 2000)
        assert found.values == pytest.approx([1.05 * plain(values[::thin][row]) for row in rows], rel=1e-9, abs=1e-9)
        assert found.blocks == len(values[::thin]) / block


def test_resampled_inverse_means_of_nothing_are_zero():
    """One value of twenty, in blocks of two: drawn n times it gives 1 / n of the score, and never drawn 0."""
    series = Series(np.arange(20), np.eye(1, 20, 10)[0], "inverse", 5.0)
    found = bootstrap_score(series, 20.0, np.random.default_rng(0))
    assert found is not None
    assert {0.0, 20.0, 10.0} <= set(np.round(found.values, 9)) <= {0.0, *np.round(20.0 / np.arange(1, 11), 9)}


def test_a_series_is_resampled_from_twenty_values_on_and_only_where_its_statistic_is_not_zero():
    for values, fits in ((np.ones(19), False), (np.ones(20), True), (np.zeros(20), False)):
        for statistic in STATISTICS:
            series = Series(np.arange(len(values)), values, statistic, None)
            found = bootstrap_score(series, 1.0, np.random.default_rng(0))
            assert (found is not None) == fits
            assert found is None or (found.values.shape, DRAWS) == ((2000,), 2000)


@pytest.mark.parametrize(("blocks", "freedom"), [(1.0, 1.0), (1.5, 1.0), (2.0, 1.0), (4.0, 3.0), (31.0, 30.0)])
@pytest.mark.parametrize("confidence", [0.5, 0.95])
def test_the_expanded_percentile_is_that_of_students_t_with_the_factor_of_few_blocks(blocks, freedom, confidence):
    """Hesterberg 2015: Phi(sqrt(n / (n - 1)) t((1 - c) / 2, n - 1)), n = 2 at least; draws evenly over 0 to 1."""
    tail = stats.norm.cdf(math.sqrt((freedom + 1.0) / freedom) * stats.t.ppf(0.5 - confidence / 2.0, freedom))
    found = expanded_percentile_interval(0.5, np.linspace(0.0, 1.0, 1001), 9, blocks, confidence)
    assert _bounds(found) == pytest.approx((tail, 1.0 - tail), abs=1e-9)
    assert (found.value, found.support, found.confidence) == (0.5, 9, confidence)
