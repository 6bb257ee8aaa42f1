"""Mistakes in headings, in sine and cosine, and exchanged clouds are named by the pose that they lead to."""

import math
from dataclasses import replace

import numpy as np
import pytest

from evalkit.commands.validate.equivalence.diagnosis import (
    best_step,
    find_mistake,
    mistakes_in_answer,
    motion_distance_m,
)
from evalkit.commands.validate.equivalence.hypotheses import ObservedStep
from evalkit.commands.validate.equivalence.margins import Margin
from evalkit.core import se2
from evalkit.core.pose import Pose

BEFORE = np.array([0.3, -0.2, 0.9])
NEAR = np.array([0.02, -0.01, 0.01])


@pytest.mark.parametrize(
    ("theta", "observed", "said"),
    [
        (2.5, math.pi - 2.5, "within a quarter turn, as by asin"),
        (2.5, 2.5 - math.pi, "half a turn off, as by atan of a quotient"),
        (-0.7, 0.7, "wrong sign"),
    ],
)
def test_a_folded_heading_is_named_by_its_fold(theta, observed, said):
    answer, guess = np.array([1.0, 2.0, theta]), np.array([0.9, 2.1, theta + 0.01])
    found = find_mistake(mistakes_in_answer(answer, guess), answer, np.array([1.0, 2.0, observed]), 4.0)
    assert found is not None
    assert said in found.what


def observed_step(observed, target, source, pairs):
    right = se2.compose(best_step(se2.transform(BEFORE, source[pairs[:, 0]]), target[pairs[:, 1]]), BEFORE)
    return ObservedStep(target, source, BEFORE, BEFORE, pairs, right, observed, len(pairs), None, None, 4.0)


def scene():
    """Six targets 2 m apart; a source point beside each, and a second one farther from the last target."""
    rng = np.random.default_rng(1)
    target = np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0], [0.0, 2.0], [2.0, 2.0], [4.0, 2.0]])
    moved = np.concatenate([target + rng.uniform(-0.1, 0.1, target.shape), [[4.5, 2.4]]])
    return target, se2.transform(se2.inverse(BEFORE), moved), np.stack([np.arange(6), np.arange(6)], axis=1)


def test_the_step_of_the_target_onto_the_source_is_named():
    target, source, pairs = scene()
    pairs = np.concatenate([pairs, [[6, 5]]])  # several sources may have one target: exchanged, they may not
    back = se2.inverse(BEFORE)
    step = best_step(se2.transform(back, target), source[:6])
    found = observed_step(se2.inverse(se2.compose(step, back)), target, source, pairs).explain()
    assert found is not None
    assert found.what == "target and source are exchanged"


def test_sine_and_cosine_of_two_terms_are_named():
    target, source, pairs = scene()
    sine, cosine = 0.9 - 0.9**3 / 6.0, 1.0 - 0.9**2 / 2.0
    moved = source @ np.array([[cosine, -sine], [sine, cosine]]).T + BEFORE[:2]
    step = best_step(moved[pairs[:, 0]], target[pairs[:, 1]])
    found = observed_step(se2.compose(step, BEFORE), target, source, pairs).explain()
    assert found is not None
    assert found.what == "points are moved by sine and cosine as series of 2 terms: the rotation is inexact"


def test_dropped_pairs_are_no_other_start():
    target, source, pairs = scene()  # BEFORE, the guess, lies within a quarter turn: folded, it is the same start
    distance = np.linalg.norm(se2.transform(BEFORE, source[:6]) - target, axis=1)
    kept = pairs[np.argsort(distance)[:4]]
    step = best_step(se2.transform(BEFORE, source[kept[:, 0]]), target[kept[:, 1]])
    observed = replace(observed_step(se2.compose(step, BEFORE), target, source, pairs), count=4)
    found = observed.explain()
    assert found is not None
    assert found.what.startswith("the longest 2 of 6 pairs are dropped, beyond ")
    explaining = [one.kind for one in observed._simple() if motion_distance_m(one.row, observed.observed, 4.0) < 1e-9]
    assert explaining
    assert "start" not in explaining


def test_a_margin_holds_by_distance_and_by_turn_across_half_a_turn():
    margin = Margin(0.05, 0.02)
    assert margin.holds(Pose(1.0, 2.0, math.pi - 0.005), Pose(1.03, 2.03, -math.pi + 0.005))  # 4.2 cm, 0.01 rad
    assert not margin.holds(Pose(1.0, 2.0, 0.0), Pose(1.04, 2.04, 0.0))  # 5.7 cm
    assert not margin.holds(Pose(1.0, 2.0, math.pi - 0.015), Pose(1.0, 2.0, -math.pi + 0.015))
