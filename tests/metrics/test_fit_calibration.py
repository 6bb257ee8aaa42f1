"""The probability of a wrong position by the fit of a scan: pools and steps by hand, the range, the shipped values."""

import json
import math
import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from scipy import optimize

from evalkit.metrics.fit_calibration import (
    LIMITS_M,
    FitCalibration,
    describe_calibration,
    learn_bins,
    load_calibration,
    pool_adjacent_violators,
)

BINS = len(LIMITS_M) + 1


@pytest.mark.parametrize(
    ("values", "weights", "pooled"),
    [
        ([1, 3, 2, 4, 3, 5], [1, 1, 1, 1, 1, 1], [1, 2.5, 2.5, 3.5, 3.5, 5]),
        ([0.5, 0.1], [1, 3], [0.2, 0.2]),  # (1 * 0.5 + 3 * 0.1) / 4
        ([3, 2, 1], [1, 1, 1], [2, 2, 2]),
        ([2, 4, 1], [1, 1, 4], [10 / 6, 10 / 6, 10 / 6]),  # 4 and 1 make 1.6, below 2: all three pool
        ([1, 2, 3], [5, 1, 2], [1, 2, 3]),
    ],
)
def test_falling_neighbours_become_their_weighted_mean(values, weights, pooled):
    found = pool_adjacent_violators(np.array(values, dtype=float), np.array(weights, dtype=float))
    assert found.tolist() == pytest.approx(pooled)


@pytest.mark.skipif(not hasattr(optimize, "isotonic_regression"), reason="SciPy before 1.12")
def test_pools_are_those_of_scipy():
    rng = np.random.default_rng(0)
    for size in (1, 2, 30):
        values, weights = rng.normal(size=size), rng.uniform(0.1, 3.0, size)
        expected = optimize.isotonic_regression(values, weights=weights).x
        assert pool_adjacent_violators(values, weights) == pytest.approx(expected)


def test_a_step_is_the_share_of_wrong_positions_with_one_wrong_and_one_right_added():
    """Bin 0 (below 1 cm): 0 of 8 wrong: 1/10. Last bin (0.5 m and more): 3 of 3: 4/5. Between: 1/2, of none at all."""
    fit_m = np.array([0.0] * 8 + [0.5, 0.6, 9.0] + [math.nan] * 4)
    wrong = [False] * 8 + [True] * 3 + [True, True, True, False]
    steps, misfit = learn_bins(fit_m, wrong)
    assert steps == pytest.approx([0.1] + [0.5] * (BINS - 2) + [0.8])
    assert misfit == pytest.approx(4 / 6)


def test_a_bin_with_more_wrong_positions_than_the_next_shares_with_it():
    """2 of 2 wrong (3/4 of 4) before 0 of 4 (1/6 of 6): both 4/10; the empty bins after them keep 1/2."""
    steps, _ = learn_bins(np.array([0.0, 0.0, *[LIMITS_M[0]] * 4]), [True, True, *[False] * 4])
    assert steps == pytest.approx([0.4, 0.4] + [0.5] * (BINS - 2))


def test_the_order_of_the_scans_does_not_matter():
    rng = np.random.default_rng(1)
    fit_m, wrong = rng.exponential(0.1, 200), rng.random(200) < 0.3
    order = rng.permutation(200)
    assert learn_bins(fit_m, wrong) == learn_bins(fit_m[order], wrong[order])


CALIBRATION = FitCalibration(tuple(np.arange(BINS) / 100.0), 0.9, (0.05, 0.1), 50, ("lab",), {})


def test_a_limit_belongs_to_the_bin_above_and_a_misfit_has_its_own_probability():
    below = np.nextafter(LIMITS_M[0], 0.0)
    found = CALIBRATION.predict([below, LIMITS_M[0], LIMITS_M[-1], 7.0, math.nan], 50, 0.05)
    assert found.tolist() == [0.0, 0.01, (BINS - 1) / 100.0, (BINS - 1) / 100.0, 0.9]


@pytest.mark.parametrize(("points", "cell_m", "known"), [(50, 0.05, True), (50, 0.1, True), (49, 0.05, False),
                                                         (50, 0.049, False), (50, 0.11, False)])  # fmt: skip
def test_outside_the_range_that_was_learnt_there_is_no_number(points, cell_m, known):
    assert np.isfinite(CALIBRATION.predict([0.01, math.nan], points, cell_m)).tolist() == [known, known]


def test_the_shipped_probabilities_rise_and_hold_on_worlds_they_were_not_learnt_on():
    shipped = load_calibration()
    assert list(shipped.probabilities) == sorted(shipped.probabilities)
    assert 0.0 < shipped.probabilities[0] < 0.02
    assert 0.9 < shipped.probabilities[-1] < 1.0
    check = shipped.check
    assert check["auc"] > 0.9
    assert check["brier"] < 0.3 * check["brier_constant"]
    assert sum(row["scans"] for row in check["reliability"]) == check["scans"]
    assert set(check["by_world"]) == set(shipped.worlds)
    assert describe_calibration().count(", ") >= len(shipped.worlds) - 1


def test_the_shipped_steps_are_those_of_the_counts_beside_them():
    content = json.loads(files("evalkit.metrics").joinpath("fit_calibration.json").read_text(encoding="utf-8"))
    rows = content["bins"]
    wrongs = [round(row["wrong_share"] * row["scans"]) if row["scans"] else 0 for row in rows]
    counts = np.array([row["scans"] + 2.0 for row in rows])
    expected = pool_adjacent_violators((np.array(wrongs) + 1.0) / counts, counts)
    assert [row["probability"] for row in rows] == pytest.approx(expected)
    assert [row["below_m"] for row in rows] == [*LIMITS_M, None]


@pytest.mark.checkout
def test_the_documentation_converts_a_probability_to_another_share_of_wrong_positions():
    """Bayes' rule: a likelihood ratio is what the odds after the fit are of those before it."""
    page = Path(__file__).parents[2] / "docs" / "pages" / "known-map.md"
    text = " ".join(page.read_text(encoding="utf-8").split())
    becomes = r"(\d+) % becomes ([\d.]+) %"
    found = re.search(rf"multiplied by `([\d.]+) s .*?With `s` = (\d+) %, {becomes}, and {becomes}", text)
    assert found is not None
    factor, *percents = map(float, found.groups())
    known = load_calibration().check["wrong_share"]
    assert factor == pytest.approx((1 - known) / known, abs=0.05)
    share, *pairs = (percent / 100 for percent in percents)
    for before, after in (pairs[:2], pairs[2:]):
        ratio = before / (1 - before) / (known / (1 - known))
        right, wrong = (1 - share) / (1 + ratio), share * ratio / (1 + ratio)
        assert after == pytest.approx(wrong / (wrong + right), rel=0.5 if after < 0.01 else 0.02)
