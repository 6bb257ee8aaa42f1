"""Paired tests and effect sizes against hand calculation and published figures."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy import integrate, stats

from evalkit.stats.paired_tests import (
    adjust_by_holm,
    compute_power,
    detectable_standard_errors,
    signed_rank_tests,
    smallest_detectable_difference,
    vargha_delaney_a12,
)


def test_holm_adjusts_step_by_step_and_keeps_the_order():
    """Calculated by hand: 0.01 x 4, 0.02 x 3, 0.03 x 2 raised to 0.06, 0.04 x 1 raised to 0.06."""
    assert adjust_by_holm([0.04, 0.01, 0.03, 0.02]) == pytest.approx((0.06, 0.04, 0.06, 0.06))
    assert adjust_by_holm([0.9, 0.8]) == (1.0, 1.0)


def test_wilcoxon_is_exact_and_a_failure_has_the_worst_rank():
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


@pytest.mark.parametrize("count", [1, 2, 5, 10, 50, 51, 200])
@pytest.mark.parametrize("steps", [3, 10**9])
def test_signed_ranks_are_exact_for_few_pairs_else_normal(count, steps):
    """Against SciPy without ties, all signs of few pairs, and else the variance of a sum with random signs."""
    rng = np.random.default_rng(count)
    a, b = (rng.integers(1, steps, count + 3) / steps for _ in range(2))
    a[:2], b[2] = b[:2], math.inf
    differences = a - b
    nonzero = differences[differences != 0.0]
    ranks = stats.rankdata(np.abs(nonzero))
    positive, mean = ranks[nonzero > 0.0].sum(), 0.5 * ranks.sum()
    if len(nonzero) <= 13:
        sums = np.array(list(itertools.product((0.0, 1.0), repeat=len(nonzero)))) @ ranks
        expected = min(2.0 * min((sums <= positive).mean(), (sums >= positive).mean()), 1.0)
    elif len(nonzero) <= 50 and steps > 3:
        expected = float(stats.wilcoxon(np.sign(nonzero) * ranks).pvalue)
    else:
        expected = 2.0 * stats.norm.sf(abs(positive - mean) / np.sqrt((ranks**2).sum() / 4.0))
    found = signed_rank_tests({"pair": (a, b)})["pair"]
    assert (found.pairs, found.p) == (len(nonzero), pytest.approx(expected, rel=1e-9))


def test_vargha_delaney_equals_hand_counts():
    """Of 3 x 3 pairs, 2 are larger and 2 are ties: (2 + 1) / 9; with exchanged arguments the complement."""
    a, b = [1.0, 2.0, 4.0], [2.0, 3.0, 4.0]
    assert vargha_delaney_a12(a, b) == pytest.approx(3 / 9)
    assert vargha_delaney_a12(b, a) == pytest.approx(6 / 9)
    assert vargha_delaney_a12([math.inf], [math.inf]) == 0.5


def test_an_effect_of_half_a_standard_deviation_needs_thirty_four_pairs():
    """The textbook sample size for d = 0.5, 80 % power, 5 %, two-sided, paired (Cohen 1988): 34, not 33."""

    def detectable(pairs: int) -> float:
        series = np.arange(pairs, dtype=np.float64)
        return smallest_detectable_difference(series / series.std(ddof=1))

    assert detectable(34) <= 0.5 < detectable(33)
    assert smallest_detectable_difference([0.1]) == smallest_detectable_difference([0.1, 0.2, math.inf]) == math.inf
    assert smallest_detectable_difference([0.1, 0.3]) == pytest.approx(0.1 * detectable_standard_errors(1))


@pytest.mark.parametrize("freedom", [2, 30, 1000])
@pytest.mark.parametrize(("power", "alpha"), [(0.8, 0.05), (0.9, 0.2), (0.5, 0.01)])
def test_power_and_detectable_shift_are_those_of_the_noncentral_t(freedom, power, alpha):
    shift, limit = detectable_standard_errors(freedom, power, alpha), stats.t.ppf(1.0 - alpha / 2.0, freedom)
    exact = stats.nct.sf(limit, freedom, shift) + stats.nct.cdf(-limit, freedom, shift)
    assert exact == pytest.approx(power, abs=1e-3)
    assert compute_power(shift, freedom, alpha) == pytest.approx(power, abs=1e-9)
    assert compute_power(0.0, freedom, alpha) == pytest.approx(alpha, abs=1e-3)


def test_two_pairs_detect_what_the_integral_over_their_standard_deviation_says():
    """With one degree of freedom it is that of |Z|; the printed limit of t is 12.706."""

    def density(z: float) -> float:
        return 2.0 * stats.norm.pdf(z) * (stats.norm.cdf(shift - 12.706 * z) + stats.norm.cdf(-shift - 12.706 * z))

    shift = detectable_standard_errors(1)
    assert integrate.quad(density, 0.0, 9.0, points=[shift / 12.706])[0] == pytest.approx(0.8, abs=1e-3)


def test_the_power_is_80_percent_at_5_percent_unless_stated():
    assert detectable_standard_errors(2) == detectable_standard_errors(2, 0.8, 0.05)
    assert compute_power(3.0, 2) == compute_power(3.0, 2, 0.05)
    differences = [0.0, 1.0, 2.0]  # with the standard error 1 / sqrt(3)
    assert smallest_detectable_difference(differences) == detectable_standard_errors(2) / math.sqrt(3.0)


def test_an_effect_size_needs_both_series():
    assert vargha_delaney_a12([1.0, 3.0], [2.0]) == 0.5
    with pytest.raises(ValueError, match="both series need a value"):
        vargha_delaney_a12([1.0], [])
