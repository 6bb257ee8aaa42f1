"""Ranks against the published example of Demsar, and success with failed trials."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from evalkit.stats.ranks import (
    FriedmanTest,
    NotTested,
    compute_ranks,
    friedman_test,
    rank_values,
    spearman_correlation,
    success_quantiles,
)

# Demsar, JMLR 7, 2006, table 6: AUC of C4.5, C4.5+m, C4.5+cf, C4.5+m+cf over 14 data sets. The last but one row prints
# 0.975 twice and ranks the first before the second: they are equal only as printed.
DEMSAR = (
    (0.763, 0.768, 0.771, 0.798), (0.599, 0.591, 0.590, 0.569), (0.954, 0.971, 0.968, 0.967),
    (0.628, 0.661, 0.654, 0.657), (0.882, 0.888, 0.886, 0.898), (0.936, 0.931, 0.916, 0.931),
    (0.661, 0.668, 0.609, 0.685), (0.583, 0.583, 0.563, 0.625), (0.775, 0.838, 0.866, 0.875),
    (1.000, 1.000, 1.000, 1.000), (0.940, 0.962, 0.965, 0.962), (0.619, 0.666, 0.614, 0.669),
    (0.972, 0.981, 0.9751, 0.975), (0.957, 0.978, 0.946, 0.970),
)  # fmt: skip


def test_friedman_and_the_critical_difference_equal_demsars():
    """Example of Demsar: mean ranks 3.143, 2.000, 2.893, 1.964, chi-square 9.28, critical difference 1.25."""
    found = friedman_test(-np.array(DEMSAR))
    assert isinstance(found, FriedmanTest)
    assert found.mean_ranks == pytest.approx((3.143, 2.000, 2.893, 1.964), abs=5e-4)
    uncorrected = 12 * 14 / (4 * 5) * (sum(rank**2 for rank in found.mean_ranks) - 4 * 25 / 4)
    assert uncorrected == pytest.approx(9.28, abs=5e-3)
    tied = 3 * (2**3 - 2) + (4**3 - 4)  # three pairs and one group of four, which Demsar's procedure excludes
    assert found.statistic == pytest.approx(uncorrected / (1 - tied / (14 * 4 * (4**2 - 1))))
    assert found.critical_difference == pytest.approx(1.25, abs=5e-3)
    assert found.p == pytest.approx(stats.chi2.sf(found.statistic, 3))
    assert found.data_sets == 14


def test_seven_sequences_and_two_methods_are_not_tested_and_eight_of_three_alike_differ_in_nothing():
    """Demsar, table 5: q(0.05) of three methods is 2.343; 2.343 sqrt(3 4 / (6 8)) = 1.1715."""
    assert friedman_test(np.ones((7, 3))) == NotTested(
        "ranks with a critical difference need at least 8 data sets, found 7"
    )
    assert friedman_test(np.ones((8, 2))) == NotTested("a test of ranks needs at least 3 methods, found 2")
    alike = friedman_test(np.ones((8, 3)))
    assert isinstance(alike, FriedmanTest)
    assert (alike.mean_ranks, alike.statistic, alike.p, alike.data_sets) == ((2.0, 2.0, 2.0), 0.0, 1.0, 8)
    assert alike.critical_difference == pytest.approx(1.1715, abs=5e-4)


def test_ranks_begin_at_one_and_ties_and_failures_share_the_mean():
    errors = [[0.3, 0.1, 0.2], [0.1, 0.1, 0.2], [math.inf, 0.1, math.inf], [5.0, 5.0, 5.0]]
    assert compute_ranks(errors).tolist() == [[3.0, 1.0, 2.0], [1.5, 1.5, 3.0], [2.5, 1.0, 2.5], [2.0, 2.0, 2.0]]


def test_failed_trials_lower_success():
    errors = [0.01, 0.02, 0.03, math.inf]
    assert success_quantiles(errors) == (0.02, 0.03, math.inf)


def test_the_correlation_equals_scipys_including_ties() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.integers(0, 5, (7, 30)), rng.normal(size=(7, 30))
    expected = [stats.spearmanr(x, y).statistic for x, y in zip(a, b, strict=True)]
    assert spearman_correlation(a.astype(float), b) == pytest.approx(expected)
    assert np.isnan(spearman_correlation(np.ones(5), np.arange(5.0)))
    assert spearman_correlation(np.array([[1.0, 2.0], [2.0, 1.0]]), np.array([3.0, 9.0])) == pytest.approx([1.0, -1.0])


def test_the_least_share_of_all_trials_is_the_best_one():
    assert success_quantiles([3.0, 1.0, 2.0], (0.0, 1.0 / 3.0, 1.0)) == (1.0, 1.0, 3.0)


def test_quantiles_need_a_trial():
    with pytest.raises(ValueError, match="success_quantiles: there is no trial"):
        success_quantiles([], (0.5,))


def test_equal_values_share_the_mean_rank_on_every_axis():
    """By hand, and as SciPy ranks tables with many ties and infinite values."""
    assert rank_values([3.0, 1.0, 3.0, math.inf, 1.0, 3.0]).tolist() == [4.0, 1.5, 4.0, 6.0, 1.5, 4.0]
    assert rank_values([]).tolist() == []
    table = np.random.default_rng(3).integers(0, 6, (4, 5, 30)).astype(np.float64)
    table[table == 5.0] = math.inf
    assert np.array_equal(rank_values(table), stats.rankdata(table, axis=-1))
