"""Designs: orthogonality, balance and resolution, counted by hand."""

from itertools import combinations

import numpy as np
import pytest

from evalkit.design.designs import (
    DesignAxis,
    Model,
    assess_design,
    make_fractional,
    make_grid,
    make_optimal,
    make_space_filling,
)


def signs(factors, resolution):
    return 2 * make_fractional(factors, resolution) - 1


@pytest.mark.parametrize(
    ("factors", "resolution", "runs"),
    [(3, 3, 4), (7, 3, 8), (4, 4, 8), (8, 4, 16), (5, 5, 16), (6, 5, 32), (8, 5, 64), (11, 5, 128)],
)
def test_a_fractional_factorial_has_the_published_size(factors, resolution, runs):
    assert len(make_fractional(factors, resolution)) == runs  # Box, Hunter and Hunter, Statistics for Experimenters


def test_every_column_of_a_fractional_factorial_is_balanced_and_orthogonal_to_all_others():
    columns = signs(8, 5)
    assert (columns.T @ columns == len(columns) * np.eye(8)).all()
    assert (columns.sum(axis=0) == 0).all()


def test_resolution_5_does_not_confound_pairs_and_resolution_4_does():
    def products(columns):
        return np.array([columns[:, a] * columns[:, b] for a, b in combinations(range(columns.shape[1]), 2)])

    five, four = products(signs(8, 5)), products(signs(8, 4))
    assert (five @ five.T == five.shape[1] * np.eye(len(five))).all()
    assert not (four @ four.T == four.shape[1] * np.eye(len(four))).all()
    assert (four @ signs(8, 4) == 0).all()  # main effects are not confounded with them


def test_an_optimal_design_for_two_levels_is_orthogonal():
    model = Model(tuple(DesignAxis(name, 2) for name in "abcd"), pairs=False)
    found = assess_design(model, make_optimal(model, 8, np.random.default_rng(0)))
    assert found.efficiency == pytest.approx(1.0)
    assert found.correlation == pytest.approx(0.0)


def test_the_full_grid_has_efficiency_1():
    model = Model((DesignAxis("a", 3, (0.0, 1.0, 2.0)), DesignAxis("b", 2), DesignAxis("c", 4)))
    found = assess_design(model, make_grid([3, 2, 4]))
    assert len(model.terms) == 1 + 2 + 1 + 3 + 1 + 3 + 3
    assert found.efficiency == pytest.approx(1.0)
    assert found.correlation == pytest.approx(0.0)


def test_a_mixed_design_is_nearly_orthogonal_with_a_fraction_of_the_grid():
    axes = (
        DesignAxis("a", 6, tuple(range(6))),
        DesignAxis("b", 2),
        DesignAxis("c", 3, (0.0, 1.0, 2.0)),
        DesignAxis("d", 3),
        DesignAxis("e", 2),
    )
    model = Model(axes)
    found = assess_design(model, make_optimal(model, 48, np.random.default_rng(0)))
    assert found.efficiency > 0.95
    assert found.correlation < 0.1


def test_the_same_seed_gives_the_same_design():
    model = Model((DesignAxis("a", 3, (0.0, 1.0, 2.0)), DesignAxis("b", 2)))
    first, second = (make_optimal(model, 12, np.random.default_rng(7)) for _ in range(2))
    assert (first == second).all()


@pytest.mark.parametrize("kind", ["sobol", "latin"])
def test_space_filling_points_lie_in_every_quarter_of_every_factor(kind):
    points = make_space_filling(5, 32, np.random.default_rng(1), kind)
    assert points.shape == (32, 5)
    for column in points.T:
        assert np.bincount((column * 4).astype(int), minlength=4).tolist() == [8, 8, 8, 8]


def test_too_few_points_for_the_model_are_rejected():
    with pytest.raises(ValueError, match="points: 3 are too few for a model of 4 columns"):
        make_optimal(Model((DesignAxis("a", 2), DesignAxis("b", 2))), 3, np.random.default_rng(0))


def test_a_design_that_cannot_be_is_refused():
    with pytest.raises(ValueError, match="a: a factor needs at least two levels, got 1"):
        DesignAxis("a", 1)
    with pytest.raises(ValueError, match="a: expected 3 scores, got 2"):
        DesignAxis("a", 3, (0.0, 1.0))
    for factors, resolution in ((0, 3), (3, 2), (3, 6)):
        with pytest.raises(ValueError, match=f"resolution 3, 4 or 5, got {factors}, {resolution}"):
            make_fractional(factors, resolution)
