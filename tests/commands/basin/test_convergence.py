"""Convergence basins: the spread of offsets, the criterion of success, and the counts."""

import numpy as np
import pytest

from evalkit.commands.basin.convergence import (
    Basin,
    Criterion,
    SuccessCounts,
    compute_offsets,
    draw_offsets,
    make_guesses,
    with_axes,
)
from evalkit.commands.basin.observability import observability
from evalkit.stats.intervals import wilson_interval

CRITERION = Criterion(0.1, np.radians(2.0))


def corridor():
    x = np.linspace(-5.0, 5.0, 200)
    points = np.concatenate([np.stack([x, np.full(200, y)], axis=1) for y in (1.0, -1.0)])
    return observability([(points, np.tile([0.0, 1.0], (400, 1)))], 0.05, 0.1)


def test_offsets_fill_the_ranges_of_distance_bearing_and_rotation_evenly():
    drawn = draw_offsets(1024, 2.0, 0.5, np.random.default_rng(0))
    distance, bearing = np.hypot(*drawn[:, :2].T), np.arctan2(drawn[:, 1], drawn[:, 0])
    for values, span in ((distance, (0, 2)), (bearing, (-np.pi, np.pi)), (drawn[:, 2], (-0.5, 0.5))):
        counts = np.histogram(values, 16, span)[0]
        assert counts.sum() == 1024
        assert np.abs(counts - 64).max() <= 6  # independent random numbers: about 20


def test_offsets_are_equal_only_for_equal_seeds():
    a, b, c = (draw_offsets(8, 1.0, 1.0, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert (a == b).all()
    assert (a != c).any()


def test_guesses_are_offset_along_the_axes_of_the_world():
    rng = np.random.default_rng(4)
    truths, targets, wanted = rng.uniform(-3, 3, (50, 3)), rng.uniform(-3, 3, (50, 3)), rng.uniform(-1, 1, (50, 3))
    np.testing.assert_allclose(
        compute_offsets(make_guesses(wanted, truths, targets), truths, targets), wanted, atol=1e-12
    )
    quarter = np.array([[7.0, 8.0, np.pi / 2]])
    np.testing.assert_allclose(
        make_guesses(np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 3)), quarter), [[0, -1, 0]], atol=1e-12
    )


def test_success_rates_equal_hand_counts_with_wilson_intervals():
    at = np.array([0.1, 0.2, 0.3, 1.5, 1.6, 9.0])
    success = np.array([True, True, False, False, False, True])
    found = SuccessCounts.of((at,), success, (np.array([0.0, 1.0, 2.0, 3.0]),))
    assert found.trials.tolist() == [3, 2, 0]
    assert found.successes.tolist() == [2, 0, 0]
    expected = wilson_interval(2, 3)
    assert (found.share[0], found.low[0], found.high[0]) == (expected.value, expected.low, expected.high)
    assert np.isnan(found.share[2])


@pytest.mark.parametrize(("level", "reach"), [(0.5, 3.0), (0.75, 2.0), (0.95, 1.0), (0.1, 4.0)])
def test_the_reach_ends_before_the_first_failing_cell(level, reach):
    counts = np.array([20, 17, 10, 4])
    shares = SuccessCounts.from_counts((np.arange(5.0),), counts, np.full(4, 20))
    assert shares.reach(level) == reach


def test_a_cell_without_trials_ends_the_reach():
    shares = SuccessCounts.from_counts((np.arange(4.0),), np.array([5, 0, 5]), np.array([5, 0, 5]))
    assert shares.reach(0.5) == 1.0


def test_success_requires_translation_rotation_and_an_answer():
    degree = np.radians(1.0)
    errors = np.array(
        [[0.06, 0.06, 0.0], [0.08, 0.08, 0.0], [0.0, 0.0, -1.9 * degree], [0, 0, 3 * degree], [np.nan] * 3]
    )
    assert CRITERION.met(errors).tolist() == [True, False, True, False, False]


def test_an_error_along_a_corridor_is_accepted_and_one_across_is_not():
    errors = np.array([[2.0, 0.01, 0.0], [0.0, 0.2, 0.0]])
    found = Basin.of(
        np.array([[1.0, 0.3, 0.1], [0.0, -0.4, 0.1]]), errors, np.ones(2, dtype=bool), corridor(), CRITERION
    )
    assert found.success.tolist() == [True, False]
    assert found.distance_m == pytest.approx([0.3, 0.4], abs=1e-3)
    assert (found.overall().value, found.overall().support) == (0.5, 2)


def test_failures_reported_as_converged_are_counted_among_failures():
    errors = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0], [np.nan] * 3])
    found = Basin.of(np.ones((4, 3)), errors, np.array([True, True, False, False]), corridor(), CRITERION)
    claimed = found.falsely_claimed()
    assert claimed is not None
    assert (claimed.value, claimed.support) == (pytest.approx(1 / 3), 3)


def test_accuracy_is_the_error_quantile_of_the_trials():
    errors = np.zeros((100, 3))
    errors[:, 1] = np.arange(1, 101) / 100.0
    errors[99] = np.nan
    found = Basin.of(np.ones((100, 3)), errors, np.ones(100, dtype=bool), corridor(), CRITERION)
    np.testing.assert_allclose(found.accuracy()[:, 0], [0.5, 0.75, 0.95], atol=1e-9)
    errors[50:] = np.nan
    lost = Basin.of(np.ones((100, 3)), errors, np.ones(100, dtype=bool), corridor(), CRITERION)
    assert np.isinf(lost.accuracy()[1:, 0]).all()


def test_the_worst_failure_is_the_one_with_the_best_guess():
    offs = np.array([[0.0, 0.9, 0.0], [0.0, 0.1, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.0]])
    errors = np.array([[0, 1.0, 0], [0, 1.0, 0], [0, 1.0, 0], [0, 0, 0]])
    found = Basin.of(offs, errors, np.ones(4, dtype=bool), corridor(), CRITERION)
    assert found.worst(2).tolist() == [1, 2]


@pytest.mark.parametrize(("count", "apart"), [(128, 2), (512, 3), (1024, 4)])
def test_guesses_of_a_curve_fill_all_its_bins_alike(count, apart):
    for seed in range(20):
        rows = with_axes(draw_offsets(count, 1.0, 1.0, np.random.default_rng(seed)))
        for values in (np.hypot(*rows[0::4, :2].T), np.abs(rows[1::4, 2])):
            bins = np.histogram(values, 8, (0.0, 1.0))[0]
            assert np.abs(bins - count // 32).max() <= apart


def test_curves_use_guesses_that_are_only_shifted_or_only_rotated():
    offs = with_axes(draw_offsets(64, 1.0, 0.5, np.random.default_rng(2)))
    errors = np.where((offs[:, 2:] == 0.0) | (offs[:, :1] == 0.0), 0.0, 1.0) * np.array([[0.0, 1.0, 0.0]])
    found = Basin.of(offs, errors, np.ones(64, dtype=bool), corridor(), CRITERION)
    assert found.overall().value == 0.0
    assert found.overall().support == 32
    assert (found.along([0.0, 1.0]).successes, found.along([0.0, 1.0]).trials) == ([16], [16])
    assert (found.around([0.0, 0.5]).successes, found.around([0.0, 0.5]).trials) == ([16], [16])
