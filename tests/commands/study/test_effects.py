"""Effects of made-up responses with known results."""

import numpy as np
import pytest

from evalkit.commands.study.effects import ModelFit
from evalkit.design.designs import DesignAxis, Model, make_fractional, make_grid, make_optimal

TWO = (DesignAxis("a", 2), DesignAxis("b", 2), DesignAxis("c", 2))


def fit(model, positions, response):
    return ModelFit(model, np.asarray(positions, dtype=float), np.asarray(response, dtype=float))


def test_effects_of_a_linear_response_are_exact():
    rows = make_grid([2, 2, 2])
    found = fit(
        Model(TWO), rows, 10.0 + 3.0 * rows[:, 0] - 2.0 * rows[:, 1]
    )  # a adds 3, b subtracts 2, c has no effect
    a, b, c = (found.factor(k) for k in range(3))
    assert found.mean.value == pytest.approx(10.5)
    assert [level.value for level in a.levels] == pytest.approx([-1.5, 1.5])
    assert a.largest.value.value == pytest.approx(3.0)
    assert (b.largest.against, b.largest.level) == (1, 0)
    assert b.largest.value.value == pytest.approx(2.0)
    assert c.largest.value.value == pytest.approx(0.0, abs=1e-12)
    assert (a.share, b.share) == pytest.approx((9.0 / 13.0, 4.0 / 13.0))
    assert a.largest.value.high - a.largest.value.low == pytest.approx(0.0, abs=1e-9)  # no residual
    assert found.explained == pytest.approx(1.0)


def test_an_interaction_is_the_difference_of_differences():
    rows = make_grid([2, 2, 2])
    response = 5.0 + 4.0 * rows[:, 0] * rows[:, 1]  # a adds 4 if b is on, nothing if it is off
    first, *others = fit(Model(TWO), rows, response).interactions()
    assert (first.a, first.b) == ("a", "b")
    assert first.value.value == pytest.approx(4.0)
    assert [other.value.value for other in others] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_only_the_true_interaction_is_significant_in_noise():
    axes = (DesignAxis("a", 4, (0.0, 1.0, 2.0, 3.0)), *(DesignAxis(name, 2) for name in "bcde"))
    model = Model(axes)
    rng = np.random.default_rng(3)
    rows = make_optimal(model, 64, rng)
    response = 0.3 * rows[:, 4] + 0.5 * rows[:, 0] * rows[:, 2] + rng.normal(0.0, 0.1, 64)
    found = fit(model, rows, response)
    pairs = found.interactions()
    assert [(pair.a, pair.b) for pair in pairs if pair.significant] == [("a", "c")]
    assert pairs[0].value.low < 1.5 < pairs[0].value.high  # three steps of 0.5
    effect = found.factor(4).largest.value
    assert effect.low < 0.3 < effect.high


def test_intervals_have_their_nominal_coverage():
    model = Model(tuple(DesignAxis(name, 2) for name in "abcde"), pairs=False)
    rows, rng = make_fractional(5, 5), np.random.default_rng(0)
    held = 0
    for _ in range(400):
        value = fit(model, rows, 2.0 * rows[:, 0] + rng.normal(0.0, 1.0, len(rows))).factor(0).levels[1]
        held += value.low <= 1.0 <= value.high  # half the difference of the two levels
    assert 0.92 <= held / 400 <= 0.99


@pytest.mark.parametrize(("levels", "scores"), [(4, None), (6, (0.0, 1.0, 2.0, 3.0, 4.0, 5.0))])
def test_noise_alone_shows_an_effect_in_at_most_a_twentieth_of_studies(levels, scores):
    # the largest of many differences is looked at: unadjusted, a third of these studies and more would show one
    model = Model(tuple(DesignAxis(name, levels, scores) for name in "abc"))
    rng = np.random.default_rng(5)
    rows, shown = make_optimal(model, 128, rng), np.zeros(2)
    for _ in range(200):
        found = fit(model, rows, rng.normal(0.0, 1.0, len(rows)))
        main = [factor.largest.value.excludes(0.0) for factor in found.effects]
        shown += any(main), any(pair.significant for pair in found.interactions())
    assert (shown <= 20).all()  # 10 are expected at most; 20 or more have a probability of 0.003


def test_an_effect_of_two_standard_deviations_is_shown_among_many():
    model = Model(tuple(DesignAxis(name, 4) for name in "abc"), pairs=False)
    rng = np.random.default_rng(6)
    rows = make_optimal(model, 64, rng)
    found = fit(model, rows, 2.0 * (rows[:, 1] == 3) + rng.normal(0.0, 1.0, len(rows)))
    assert [factor.factor for factor in found.effects if factor.largest.value.excludes(0.0)] == ["b"]


def test_every_unordered_level_has_its_own_effect():
    rows = make_grid([3, 2])
    response = np.array([1.0, 5.0, 3.0])[rows[:, 0]] + np.array([0.0, 1.0])[rows[:, 1]]
    found = fit(Model((DesignAxis("stages", 3), DesignAxis("b", 2)), pairs=False), rows, response)
    assert [level.value for level in found.factor(0).levels] == pytest.approx([-2.0, 2.0, 0.0])
    assert found.factor(0).largest.value.value == pytest.approx(4.0)
    assert found.expected({0: 1, 1: 1}).value == pytest.approx(6.0)


def test_a_model_predicts_points_between_its_levels():
    rows = make_grid([3, 2, 2])
    model = Model((DesignAxis("a", 3, (0.0, 1.0, 2.0)), DesignAxis("b", 2), DesignAxis("c", 2)))
    found = fit(model, rows, 2.0 * rows[:, 0] + rows[:, 0] * rows[:, 1])
    assert found.predict(np.array([[0.5, 0.0, 1.0], [1.5, 1.0, 0.0]])).tolist() == pytest.approx([1.0, 4.5])


def test_fewer_points_than_effects_are_rejected():
    with pytest.raises(ValueError, match="7 points are too few for the 7 columns"):
        fit(Model(TWO), make_grid([2, 2, 2])[:7], np.zeros(7))
    with pytest.raises(ValueError, match="model's columns are not independent in these points"):
        fit(Model(TWO), np.repeat(make_grid([2, 2, 2])[:4], 3, axis=0), np.zeros(12))
