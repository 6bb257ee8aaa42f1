"""The rule whose change leads to an observed step is named: its scale, its weights, its age, its points."""

import math
from dataclasses import replace

import numpy as np
import pytest

from evalkit.commands.validate.equivalence.diagnosis import best_step
from evalkit.commands.validate.equivalence.hypotheses import ObservedStep
from evalkit.core import se2

BEFORE = np.array([0.3, -0.2, 0.9])
TARGET = np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0], [0.0, 2.0], [2.0, 2.0], [4.0, 2.0]])
MOVED = TARGET + np.array([[0.10, 0.03], [0.12, -0.04], [-0.02, 0.09], [0.05, 0.06], [0.11, 0.01], [0.4, -0.05]])
SOURCE = se2.transform(se2.inverse(BEFORE), MOVED)
PAIRS = np.stack([np.arange(6), np.arange(6)], axis=1)
LEAST_SQUARES = best_step(MOVED, TARGET)


def step(after, pairs=PAIRS, **fields):
    """One step over the six pairs whose outcome is the motion ``after`` of the moved points."""
    right = se2.compose(best_step(MOVED[pairs[:, 0]], TARGET[pairs[:, 1]]), BEFORE)
    given = {"count": len(pairs), "first": None, "previous": None, "lever_m": 3.0, **fields}
    return ObservedStep(TARGET, SOURCE, BEFORE, BEFORE, pairs, right, se2.compose(after, BEFORE), **given)


def explained(observed):
    found = observed.explain()
    return found and (found.kind, found.what)


def about_centroid(share, angle):
    """The motion by an angle that moves the points' centroid by a share of its way to that of the targets."""
    centre = MOVED.mean(axis=0)
    goal = centre + share * (TARGET.mean(axis=0) - centre)
    turned = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]) @ centre
    return np.array([*(goal - turned), angle])


def weighted(weights):
    """The least-squares motion with weights, by the singular value decomposition of Kabsch."""
    share = weights / weights.sum()
    p_bar, q_bar = share @ MOVED, share @ TARGET
    u, _, v = np.linalg.svd((share[:, None] * (MOVED - p_bar)).T @ (TARGET - q_bar))
    rotation = v.T @ np.diag([1.0, np.linalg.det(v.T @ u.T)]) @ u.T
    return np.array([*(q_bar - rotation @ p_bar), math.atan2(rotation[1, 0], rotation[0, 0])])


DISTANCE = np.linalg.norm(MOVED - TARGET, axis=1)


@pytest.mark.parametrize(
    ("after", "said"),
    [
        (about_centroid(0.5, 0.5 * LEAST_SQUARES[2]), "the step is 0.5 times the least-squares step"),
        (about_centroid(1.7, 1.7 * LEAST_SQUARES[2]), "the step is 1.7 times the least-squares step"),
        (about_centroid(1.0, 0.5 * LEAST_SQUARES[2]), "the step's angle is 0.5 times the least-squares angle"),
        (weighted(1.0 / (1.0 + (DISTANCE / 0.2) ** 2)), "the step weighs near pairs more than far ones"),
        (weighted(DISTANCE), "the step weighs far pairs more than near ones"),
    ],
)
def test_a_scaled_or_weighted_step_is_named(after, said):
    assert explained(step(after)) == ("step", said)


@pytest.mark.parametrize("inverted", [True, False])
def test_exchanged_clouds_are_named_whether_or_not_guess_and_answer_are_inverted(inverted):
    """All points are 2 m apart, so that the partner of each is the one with its number."""
    before = np.array([0.05, -0.04, 0.03])
    source = se2.transform(se2.inverse(before), MOVED)
    right = se2.compose(best_step(MOVED, TARGET), before)
    start = se2.inverse(before) if inverted else before
    moved = se2.transform(start, TARGET)
    row = se2.compose(best_step(moved, source), start)
    observed = ObservedStep(
        TARGET, source, before, before, PAIRS, right, se2.inverse(row) if inverted else row, len(PAIRS), None, None, 3.0
    )
    assert explained(observed) == ("neighbours", "target and source are exchanged")


def test_a_sine_of_degrees_is_named_with_its_place():
    """BEFORE turns by 0.9 rad: 51.57 degrees, whose sine as of radians is 0.996 instead of 0.783."""
    c, s, wrong = math.cos(0.9), math.sin(0.9), math.sin(math.degrees(0.9))
    other = SOURCE @ np.array([[c, -s], [wrong, c]]).T + BEFORE[:2]
    nearest = np.argmin(np.linalg.norm(other[:, None] - TARGET, axis=2), axis=1)
    kept = np.unique(nearest, return_index=True)[1]
    observed = step(best_step(other[kept], TARGET[nearest[kept]]), count=len(kept))
    said = "points are turned with the sine for y of the angle in degrees"
    assert explained(observed) == ("step", said)

    theta = LEAST_SQUARES[2]
    wrong = math.sin(math.degrees(theta))
    turned = np.array([[math.cos(theta), -wrong], [wrong, math.cos(theta)]])
    shift = TARGET.mean(axis=0) + turned @ (BEFORE[:2] - MOVED.mean(axis=0))
    after = se2.compose(np.array([*shift, BEFORE[2] + theta]), se2.inverse(BEFORE))
    assert explained(step(after)) == ("units", "the step is turned with the sine of its angle in degrees")


def test_a_step_of_no_known_rule_is_not_named():
    assert step(np.array([0.9, -0.7, 0.6])).explain() is None
    moved_only = MOVED - MOVED.mean(axis=0) + TARGET.mean(axis=0)  # its centroids agree ...
    turned = best_step(moved_only, TARGET)[2]
    straight = se2.transform(np.array([0.0, 0.0, turned]), MOVED)  # ... and now its turns do: a gain has no meaning
    source = se2.transform(se2.inverse(BEFORE), straight)
    right = se2.compose(best_step(straight, TARGET), BEFORE)
    observed = se2.compose(np.array([0.5, 0.4, 0.7]), BEFORE)
    assert abs(best_step(straight, TARGET)[2]) < 1e-12
    assert ObservedStep(TARGET, source, BEFORE, BEFORE, PAIRS, right, observed, 6, None, None, 3.0).explain() is None


def test_pairs_of_an_earlier_iteration_are_named_by_their_age():
    old = np.array([[0, 1], [1, 0], [2, 2], [3, 4], [4, 3], [5, 5]])
    after = best_step(MOVED[old[:, 0]], TARGET[old[:, 1]])
    assert explained(step(after, previous=old)) == ("stale pairs", "stale pairs: those of the iteration before")
    found = explained(step(after, previous=PAIRS, first=old))
    assert found == ("stale pairs", "stale pairs: those of the first iteration")


SCATTERED, HITS = np.random.default_rng(2).uniform(-3.0, 3.0, (2, 20, 2))
"""A target and moved points without any order, on both sides of zero: each rule gives other neighbours."""
GUESS = np.array([-0.4, 0.5, 0.2])


def find_neighbours(points, rule):
    """The neighbours of points by a rule, from the distances to every target."""
    apart = np.abs(points[:, None] - SCATTERED)
    same = (points[:, None] < 0.0) == (SCATTERED < 0.0)
    lengths = np.linalg.norm(apart, axis=2)
    others = {
        "nearest by the sum of x and y": apart.sum(axis=2),
        "nearest by the larger of x and y": apart.max(axis=2),
        "nearest by x alone": apart[..., 0],
        "nearest by y alone": apart[..., 1],
        "across x = 0 are not found": np.where(same[..., 0], lengths, np.inf),
        "across y = 0 are not found": np.where(same[..., 1], lengths, np.inf),
        "across zero are not found": np.where(same.all(axis=2), lengths, np.inf),
    }
    used = next((other for words, other in others.items() if rule.endswith(words)), lengths)
    return np.argsort(used, axis=1)[:, int(rule.startswith("the second"))]


@pytest.mark.parametrize(
    "rule",
    [
        "the second nearest neighbour is taken",
        *(f"neighbours are nearest by {by}" for by in ("the sum of x and y", "the larger of x and y")),
        *(f"neighbours are nearest by {axis} alone" for axis in "xy"),
        *(f"neighbours across {line} are not found" for line in ("x = 0", "y = 0", "zero")),
        "stale pairs: neighbours from the guess",
        "stale pairs: neighbours from the identity",
    ],
)
def test_other_neighbours_are_named_with_their_rule(rule):
    source = se2.transform(se2.inverse(BEFORE), HITS)
    stale = {"the guess": se2.transform(GUESS, source), "the identity": source}.get(rule.rpartition("from ")[2], HITS)
    right, other = find_neighbours(HITS, ""), find_neighbours(stale, rule)
    assert (right != other).any()
    pairs = np.stack([np.arange(len(HITS)), right], axis=1)
    rows = [se2.compose(best_step(HITS, SCATTERED[onto]), BEFORE) for onto in (right, other)]
    observed = ObservedStep(SCATTERED, source, BEFORE, GUESS, pairs, *rows, len(HITS), pairs, pairs, 3.0)
    assert explained(observed) == ("stale pairs" if "stale" in rule else "neighbours", rule)


def test_dropped_points_near_the_sensor_are_named_with_their_range():
    order = np.argsort(np.linalg.norm(SOURCE, axis=1))
    kept = np.sort(order[2:])
    after = best_step(MOVED[kept], TARGET[kept])
    nearest = np.linalg.norm(SOURCE[order[2]])
    found = explained(step(after, count=4))
    assert found == ("outlier rule", f"source points nearer to the origin than {nearest:.3g} m are dropped")
    kept = np.sort(order[:4])
    farthest = np.linalg.norm(SOURCE[order[3]])
    found = explained(step(best_step(MOVED[kept], TARGET[kept]), count=4))
    assert found == ("outlier rule", f"source points farther from the origin than {farthest:.3g} m are dropped")


@pytest.mark.parametrize(("beyond_m", "said"), [(0.02, "0.32 m"), (2e-6, "0.300002 m")])
def test_a_limit_that_is_a_little_too_large_is_named_with_the_digits_that_differ(beyond_m, said):
    """Five pairs are up to 0.3 m long; a sixth, beyond the limit, is kept."""
    moved = TARGET + np.outer([0.1, 0.2, 0.1, 0.2, 0.3, 0.3 + beyond_m], [1.0, 0.0])
    one = replace(step(LEAST_SQUARES, pairs=PAIRS[:5]), count=6)
    names = [what for _, what, _ in one._by_length(moved, np.arange(6), np.linalg.norm(moved - TARGET, axis=1))]
    assert names[-1] == f"maximum distance: pairs up to {said} are kept instead of 0.3 m"


def test_fewer_pairs_than_a_step_needs_explain_nothing():
    one = replace(step(np.array([0.2, 0.1, 0.1])), count=1)
    assert list(one._by_range(PAIRS)) == []
    assert [kind for kind, _, _ in one._by_length(MOVED, np.arange(6), DISTANCE)] == ["outlier rule"]  # no limit
    single = replace(one, target=TARGET[:1], pairs=PAIRS[:1])
    names = [what for _, what, _ in single._by_neighbours(MOVED)]
    assert "the second nearest neighbour is taken" not in names
    points = [what for _, what, _ in single._by_points(MOVED)]
    assert "the first target point is not used" not in points  # it is the only one
    assert "only every second target point is used" in points
