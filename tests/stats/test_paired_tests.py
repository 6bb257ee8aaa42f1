"""Paired tests and effect sizes against hand calculation and published figures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from evalkit.stats.paired_tests import (
    adjust_by_holm,
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
    assert smallest_detectable_difference([0.1]) == math.inf


def test_the_smallest_detectable_difference_of_three_has_the_power_of_the_noncentral_t():
    error = 1.0 / math.sqrt(3.0)  # of 0, 1, 2
    shift = smallest_detectable_difference([0.0, 1.0, 2.0]) / error
    limit = stats.t.ppf(0.975, 2)
    assert stats.nct.sf(limit, 2, shift) + stats.nct.cdf(-limit, 2, shift) == pytest.approx(0.8, abs=1e-3)


def test_an_effect_size_needs_both_series():
    assert vargha_delaney_a12([1.0, 3.0], [2.0]) == 0.5
    with pytest.raises(ValueError, match="both series need a value"):
        vargha_delaney_a12([1.0], [])
