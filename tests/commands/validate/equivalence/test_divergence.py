"""The first difference of two answers, written by hand, is found at its place and named by its cause."""

import math
from dataclasses import replace

import numpy as np
import pytest

from evalkit.commands.validate.equivalence.correspondences import explain_difference
from evalkit.commands.validate.equivalence.diagnosis import best_step, find_mistake, name_cost
from evalkit.commands.validate.equivalence.divergence import first_divergence
from evalkit.commands.validate.equivalence.fields import count_equal_fields, count_fields, describe_field, wrong_fields
from evalkit.commands.validate.equivalence.lockstep import AnswerPair, Question
from evalkit.commands.validate.equivalence.margins import Margin
from evalkit.commands.validate.equivalence.other_points import written_decimals
from evalkit.core.match import Iteration, Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud

TARGET = np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0], [0.0, 2.0], [2.0, 2.0], [4.0, 2.0]])
SOURCE = TARGET + np.array([[0.10, 0.03], [0.12, -0.04], [-0.02, 0.09], [0.05, 0.06], [0.11, 0.01], [0.4, -0.05]])
QUESTION = Question(1, "s2s", Cloud(TARGET), Cloud(SOURCE), Pose())
PAIRS = np.stack([np.arange(6), np.arange(6)], axis=1)
RIGHT = Pose.of(best_step(SOURCE, TARGET))
NEAR = RIGHT @ Pose(1e-6, 0.0, 0.0)  # within rounding to float32 at 4 m, beyond that to float64
OTHER = RIGHT @ Pose(0.02, 0.013, 0.004)
ROUNDED = Pose.of(np.round(RIGHT.row, 3))
PATH = [Pose(0.3, 0.1, 0.07), OTHER, RIGHT]
"""The poses of a reference after one iteration, two and three."""


def match(pose=RIGHT, history=(), iterations=0, error=0.01, inliers=6, converged=True):
    return Match(pose, converged, iterations, error, inliers, tuple(history))


def entry(pose=RIGHT, error=0.01, inliers=6, pairs=None):
    return Iteration(error, inliers, pose, pairs)


def difference(a, b, question=QUESTION, reference=None):
    found = first_divergence(AnswerPair(question, a, b, reference=reference), Margin())
    return found and str(found)


WITHOUT_ITERATIONS = {
    "fewer pairs": (match(OTHER, inliers=5), "answer: different: 6 pairs against 5; not both report their iter"),
    "no cause": (match(OTHER), "answer: different: not both report their iterations (0.024 m and 0.004 rad)"),
    "float32": (match(NEAR), "answer: precision: within rounding to float32 (1e-06 m and 0 rad)"),
    "text": (match(ROUNDED), "answer: rounding: the numbers of the pose are written with 3 decimals: rounded"),
}


@pytest.mark.parametrize("name", WITHOUT_ITERATIONS)
def test_an_answer_without_iterations_is_told_apart_by_its_pose_and_its_pairs(name):
    b, said = WITHOUT_ITERATIONS[name]
    assert difference(match(), b).startswith(f"scan 1, s2s, {said}")


def test_too_few_pairs_and_a_forgotten_last_step_are_named():
    found = difference(Match.not_converged(Pose()), match(OTHER))
    assert found.startswith("scan 1, s2s, answer: different: with too few pairs A returns the guess, B another pose (")
    found = difference(match(history=[entry(OTHER), entry()]), match(OTHER))
    assert found == "scan 1, s2s, answer: different: the pose before the last step is returned"


def test_stops_are_compared_where_both_count_their_iterations():
    same = [entry(OTHER), entry()]
    a, b = match(history=same, iterations=2), match(OTHER, same, iterations=2, converged=False)
    said = "after 2 identical iterations A reports converged, B does not"
    assert difference(a, b) == f"scan 1, s2s, iteration 2, iterations: stop rule: {said}"
    assert difference(b, a).endswith("B reports converged, A does not")
    failed = match(OTHER, iterations=1, error=math.nan, converged=False)
    said = "scan 1, s2s, iteration 1, iterations: different: B fails after 1 iterations, A continues to 2"
    assert difference(match(iterations=2), failed) == said


class OneAtATime:
    """A reference that goes to the next pose of the path, and ends there; the last one leads nowhere."""

    def register(self, _target, _source, guess):
        at = PATH.index(guess) + 1
        return match(PATH[at], [entry(PATH[at])], iterations=1) if at < len(PATH) else Match.not_converged(guess)


FAR = OTHER @ Pose(0.01, 0.02, 0.03)
STOPS = {  # the length of the first answer, the second one, without iterations, and what is said
    "earlier": (3, match(PATH[1], iterations=2), "stop rule: B stops after 2 iterations, A continues to 3"),
    "capped": (3, match(PATH[1], iterations=2, converged=False), "iteration cap: B ends unconverged after 2 iter"),
    "later": (1, match(PATH[2], iterations=3), "stop rule: A stops after 1 iterations, B continues to 3"),
    "elsewhere": (3, match(FAR, iterations=2), "different: 3 iterations against 2; not both report"),
    "elsewhere, later": (1, match(FAR, iterations=3), "different: 1 iterations against 3; not both report"),
    "later than known": (2, match(FAR, iterations=5), "different: 2 iterations against 5; not both report"),
    "elsewhere, unconverged": (3, match(FAR, iterations=3, converged=False), "different: not both report"),
    "counted wrongly": (3, match(PATH[2], iterations=2), "field: the pose is equal, but not iterations: 2, expected 3"),
}  # fmt: skip


@pytest.mark.parametrize("name", STOPS)
def test_a_stop_is_the_cause_only_where_the_reference_had_the_other_pose_after_as_many_iterations(name):
    length, b, said = STOPS[name]
    question = replace(QUESTION, guess=Pose(0.5, 0.4, 0.3))  # no pose of the path
    a = match(PATH[length - 1], [entry(pose) for pose in PATH[:length]], iterations=length)
    found = difference(a, b, question, OneAtATime())
    assert found.partition(": ")[2].startswith(said), found


def test_without_the_poses_of_the_reference_no_stop_is_named():
    found = difference(match(iterations=3), match(OTHER, iterations=2))
    assert found.startswith("scan 1, s2s, answer: different: 3 iterations against 2; not both report their iterations")


def test_few_decimals_of_a_pose_that_rounding_does_not_lead_to_are_not_its_cause():
    """An ICP that ends before it is exact, against one that finds the true motion, and against a far one."""
    true = Pose(0.2, -0.15, -0.2)
    question = replace(QUESTION, source=Cloud(true.inverse().transform(TARGET)))
    near = true @ Pose(3e-3, -2e-3, 1e-3)
    assert "not both report their iterations" in difference(match(near), match(true), question)
    assert "3 decimals: rounded" in difference(match(near), match(Pose.of(np.round(near.row, 3))), question)
    assert "not both report their iterations" in difference(match(), match(Pose(0.5, 0.0, 0.0)))
    cut = match(Pose.of(np.trunc(RIGHT.row * 1e3) / 1e3))
    assert "written with 3 decimals: rounded" in difference(match(), cut)


def test_the_error_of_an_equal_answer_is_compared_where_one_counts_no_iterations():
    a = match(history=[entry()], iterations=2)
    assert difference(a, match()) is None
    assert difference(a, match(error=0.02)) == "scan 1, s2s, cost: cost: 0.01 m against 0.02 m for the same answer"
    assert difference(a, match(error=0.010001)).startswith("scan 1, s2s, cost: precision: 0.01 m against 0.010001 m")
    assert difference(a, match(error=math.nan)) is None  # an unknown error is no difference


def test_a_trace_that_only_one_reports_is_no_difference_and_hides_none():
    path = [entry(OTHER), entry()]
    a, b = match(history=path, iterations=2), match(iterations=2)
    assert difference(a, b) is difference(b, a) is None
    assert wrong_fields(a, b, Margin()) == []
    assert wrong_fields(a, match(history=path[1:], iterations=2), Margin())[0] == "trace length"
    assert difference(a, replace(b, inliers=5)).endswith("the pose is equal, but not inliers: 5, expected 6")


def test_a_wrong_field_is_described_by_both_values_and_one_of_a_trace_by_its_iteration():
    path = [entry(OTHER), entry()]
    a = match(history=path, iterations=2)
    b = match(history=[path[0], replace(entry(), inliers=4, error=0.5)], iterations=3)
    said = {name: describe_field(name, a, b, Margin()) for name in wrong_fields(a, b, Margin())}
    assert said["iterations"] == "3, expected 2"
    assert said["trace inliers"] == f"iteration 2: 4, expected {entry().inliers}"
    assert said["trace error"].startswith("iteration 2: 0.5 m, expected ")
    moved = match(history=[entry(), entry()], iterations=2)
    assert describe_field("trace pose", a, moved, Margin()).startswith("iteration 1: ")


def test_equal_fields_are_counted_where_the_pose_is_equal_and_others_are_excused():
    """Of five answers two are equal, two have other pairs at the same pose, one has another pose."""
    answers = [match(), match(), match(inliers=5), match(inliers=4), match(OTHER, inliers=3)]
    answered = [(AnswerPair(QUESTION, match(), b), Margin()) for b in answers]
    assert count_fields(answered, "float32") == {}  # no more than two
    assert count_equal_fields(answered, {}) == (2, 2)
    assert count_equal_fields(answered, count_fields(answered, Margin())) == (2, 0)


def traced(pose=RIGHT, **fields):
    one = entry(pose, **fields)
    return match(pose, [one], iterations=1, error=one.error, inliers=one.inliers)


IN_ITERATIONS = {
    "another number, rounded": (traced(), traced(NEAR, inliers=5), "pairs: precision: another number of pairs, within"),
    "another number": (traced(), traced(OTHER, inliers=5), "pairs: different: 6 pairs against 5; not both report"),
    "text": (traced(), traced(ROUNDED), "pose: rounding: the numbers of the pose are written with 3 decimals"),
    "no pairs": (traced(), traced(OTHER), "pose: different: different poses (0.024 m and 0.004 rad)"),
    "as many": (traced(pairs=PAIRS), traced(OTHER), "pose: different: different steps from as many pairs; that of A"),
    "error": (traced(), traced(error=0.02), "cost: cost: an error of 0.01 m against 0.02 m for the same pairs"),
    "error, rounded": (traced(), traced(error=0.010001), "cost: precision: an error of 0.01 m against 0.010001 m"),
}  # fmt: skip


@pytest.mark.parametrize("name", IN_ITERATIONS)
def test_the_first_iteration_that_differs_is_named(name):
    a, b, said = IN_ITERATIONS[name]
    assert difference(a, b).startswith(f"scan 1, s2s, iteration 1, {said}")


def test_dropped_pairs_are_named_from_the_reference_s_pairs_alone():
    distance = np.linalg.norm(SOURCE - TARGET, axis=1)
    kept = np.sort(np.argsort(distance)[:4])
    pose = Pose.of(best_step(SOURCE[kept], TARGET[kept]))
    found = difference(traced(pairs=PAIRS), traced(pose, inliers=4))
    assert found.startswith(
        "scan 1, s2s, iteration 1, pairs: outlier rule: the longest 2 of 6 pairs are dropped, beyond"
    )
    unexplained = first_divergence(AnswerPair(QUESTION, traced(pairs=PAIRS), traced(pose, inliers=4)), Margin(), False)
    assert unexplained.what == "6 pairs against 4; not both report their pairs"


def explain(b, a=PAIRS, question=QUESTION, tolerance_m=1e-6):
    return explain_difference(question, Pose(), a, np.asarray(b, dtype=np.int64).reshape(-1, 2), tolerance_m, True)


def test_pairs_that_cannot_be_are_named_before_all_else():
    assert explain([[0, 6]]) == ("different", "its pairs contain indices out of range")
    assert explain([[0, -1]]) == ("different", "its pairs contain indices out of range")
    assert explain([[0, 0], [0, 1]]) == ("different", "a source point has several partners")


def test_kept_pairs_that_no_filter_explains_are_counted():
    kind, what = explain(PAIRS[[0, 2, 4]], a=PAIRS[[0, 1, 4]])  # as many, of lengths between the others
    assert (kind, what) == ("outlier rule", "different pairs are kept, nearest neighbours agree (3 pairs against 3)")
    kind, what = explain([], a=PAIRS)
    assert (kind, what) == ("outlier rule", "maximum distance: longest pair 0.4031 m against 0 m (6 pairs against 0)")


def test_numbers_written_as_text_are_known_by_their_decimals():
    assert written_decimals(np.array([0.12, 0.0, -3.4567])) == 4
    assert written_decimals(np.array([0.12, 0.0, math.pi])) is None
    assert written_decimals(np.zeros(3)) is None
    assert written_decimals(np.array([1.0, math.nan, 0.0])) is None


def test_no_mistakes_and_no_cost_explain_nothing():
    assert find_mistake([], RIGHT.row, OTHER.row, 4.0) is None
    lengths = np.array([0.1, 0.3])
    assert name_cost(0.2, lengths, lengths + 1.0) == "the mean distance before the step"
    assert name_cost(0.23, lengths, lengths + 1.0) == ""
