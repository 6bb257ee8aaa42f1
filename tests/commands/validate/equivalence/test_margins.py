"""Intervals and the float32 margin, compared with hand calculations."""

import math

import numpy as np
import pytest

from evalkit.commands.validate import question_probes
from evalkit.commands.validate.equivalence.lockstep import Question
from evalkit.commands.validate.equivalence.margins import GeometryScale, Margin, float32_margin, interval
from evalkit.commands.validate.equivalence.questions import draw_questions
from evalkit.commands.validate.equivalence.rounding import is_ill_conditioned
from evalkit.commands.validate.question_summary import summarise_questions
from evalkit.core.match import Iteration, Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud


def test_the_float32_margin_matches_its_derivation():
    margin = float32_margin(GeometryScale(reach_m=10.0, points=300, radius_m=5.0))
    step = 2.0**-24 * 10.0 * (3.0 + 10.0)
    assert margin.metres == pytest.approx(3.0 * (step + 10.0 * step / 5.0))
    assert margin.radians == pytest.approx(3.0 * step / 5.0)


def test_small_samples_use_students_t():
    one = interval("x", "m", [1.0, 2.0, 3.0, 4.0], [1, 2, 3, 4], margin=5.0)
    half = 2.353363 * math.sqrt(5.0 / 3.0) / 2.0  # t of 95 % with 3 degrees of freedom, from a table
    assert (one.low, one.high) == pytest.approx((2.5 - half, 2.5 + half), abs=1e-5)
    assert one.inside
    assert (one.worst, one.worst_scan) == (4.0, 4)
    assert not interval("x", "m", [1.0, 2.0, 3.0, 4.0], [1, 2, 3, 4], margin=3.9).inside
    assert not interval("x", "m", [0.0], [1], margin=1.0).inside


def test_blocks_give_the_interval_of_independent_values():
    values = np.random.default_rng(4).normal(0.3, 1.0, 2000)
    one = interval("x", "m", values, range(2000), margin=1.0)
    half = 1.645 * values.std() / math.sqrt(2000)
    assert one.method == "moving blocks"
    assert (one.low, one.high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.15 * half)


IDENTITY = Pose(0.0, 0.0, 0.0)


class Amplifies:
    """Answers with the first coordinate of the source, times a gain, after one iteration; the last pose is given."""

    def __init__(self, gain, flips=False):
        self._gain, self._flips = gain, flips

    def register(self, target, source, guess):
        x = self._gain * (source.points[0, 0] - 1.0)
        pairs = 3 + (self._flips and x != 0.0)
        step = Iteration(0.0, pairs, Pose(x, 0.0, 0.0))
        return Match(guess, converged=True, iterations=1, error=0.0, inliers=pairs, history=(step,))


@pytest.mark.parametrize(("gain", "flips", "ill"), [(1e6, False, True), (1e3, False, False), (1e6, True, False)])
def test_a_question_is_ill_conditioned_if_rounding_moves_a_pose_by_a_tenth_of_the_margin(gain, flips, ill):
    """Points are moved by up to 8 eps of 1 m: 2e-15 m; times 1e6 that is 2e-9 m, times 1e3 2e-12 m, of 1e-10 m."""
    points = Cloud(np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]))
    question = Question(0, "s2m", points, points, IDENTITY)
    reference = Amplifies(gain, flips)
    right = reference.register(points, points, IDENTITY)
    assert is_ill_conditioned(reference, question, right, Margin()) is ill


@pytest.mark.thorough
def test_two_correct_implementations_answer_ill_conditioned_questions_alike_or_are_not_asked():
    """Seed 18 draws one question, with lines through 24 points, whose first step amplifies rounding."""
    sides = [question_probes.load_backend({"name": name, "given": {}}) for name in ("paper", "embedded")]
    if sides[1].spec.missing():
        pytest.skip("the compiled core is not installed")
    drawn = [one for one in draw_questions(18, *sides, False) if one.family == "parameters at once"]
    asked = question_probes._ask_all(tuple(sides), drawn)
    ill = [
        one for one in asked
        if is_ill_conditioned(one.reference, one.drawn.question, one.answers.a, Margin())
    ]  # fmt: skip
    assert [one.drawn.changes["line_neighbours"] for one in ill] == [24]
    (family,) = summarise_questions(asked, question_probes.parse_margin("exact"))["families"].values()
    assert (family["wrong"], family["fields"]) == (0, {})
