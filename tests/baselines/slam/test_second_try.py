from dataclasses import dataclass, field

import numpy as np
import pytest

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit_baselines import paper
from evalkit_baselines.slam.second_try import Coarse, CoarseToFine, SecondTry, take_part

CORNER = Cloud(np.concatenate([np.column_stack([np.linspace(0, 4, 80), np.zeros(80)]),
                               np.column_stack([np.zeros(80), np.linspace(0, 4, 80)])]))  # fmt: skip


@dataclass
class Answer:
    """A registration that always answers the same, and counts its calls."""

    pose: Pose
    error: float
    inliers: int = 160
    calls: list[Pose] = field(default_factory=list)
    points: list[int] = field(default_factory=list)

    def register(self, target, source, guess):
        self.calls.append(guess)
        self.points.append(len(source))
        return Match(self.pose, True, 3, self.error, self.inliers)


def test_a_good_answer_is_not_doubted():
    narrow = Answer(Pose(), 0.01)
    answer = SecondTry(Answer(Pose(0.5, 0.0, 0.0), 0.1), narrow, narrow).register(CORNER, CORNER, Pose())
    assert answer.target_from_source == Pose(0.5, 0.0, 0.0)
    assert not narrow.calls


def test_an_answer_with_pairs_for_less_than_four_fifths_of_the_points_is_doubted():
    for inliers, doubted in ((128, False), (127, True)):
        narrow = Answer(Pose(), 0.01)
        SecondTry(Answer(Pose(), 0.01, inliers), narrow, narrow).register(CORNER, CORNER, Pose())
        assert bool(narrow.calls) is doubted


@pytest.mark.parametrize(("usual_m", "limit_m"), [(0.0, 0.1), (0.01, 0.04), (0.02, 0.08), (0.05, 0.1)])
def test_an_answer_with_more_than_four_times_the_usual_error_is_doubted(usual_m, limit_m):
    for error, doubted in ((limit_m, False), (1.01 * limit_m, True)):
        narrow = Answer(Pose(), 0.01)
        tries = SecondTry(Answer(Pose(), error), narrow, narrow)
        tries.begin_scan(usual_m)
        tries.register(CORNER, CORNER, Pose())
        assert bool(narrow.calls) is doubted


def test_a_further_try_that_ends_far_from_the_guess_does_not_count():
    first = Pose(0.3, 0.3, 0.2)
    for guess, taken in ((Pose(0.4, 0.0, 0.6), Pose()), (Pose(0.6, 0.0, 0.0), first), (Pose(0.0, 0.0, 0.64), first)):
        narrow = Answer(Pose(), 0.01)
        answer = SecondTry(Answer(first, 0.2), narrow, narrow).register(CORNER, CORNER, guess)
        assert answer.target_from_source == taken


def test_of_two_poor_answers_the_one_with_more_points_on_the_target_is_taken():
    guess, right, wrong = Pose(0.1, 0.0, 0.0), Pose(), Pose(0.6, 0.4, 0.2)
    for wide, near in ((wrong, right), (right, wrong)):
        narrow, brief = Answer(near, 0.3), Answer(near, 0.3)
        answer = SecondTry(Answer(wide, 0.2), narrow, brief).register(CORNER, CORNER, guess)
        assert answer.target_from_source == right
        assert brief.calls[0] == guess
        assert {(call.x, call.y) for call in brief.calls} == {(0.1, 0.0)}
        assert narrow.calls == [near if near == right else guess]  # the wrong one is too far from the guess


def test_only_the_first_poor_answer_of_a_scan_is_tried_again():
    narrow, brief = Answer(Pose(), 0.01), Answer(Pose(), 0.01)
    tries = SecondTry(Answer(Pose(), 0.2), narrow, brief)
    for _ in range(2):
        tries.begin_scan(0.0)
        for _ in range(2):
            tries.register(CORNER, CORNER, Pose())
    assert (len(brief.calls), len(narrow.calls)) == (2 * 5, 2)


def test_without_odometry_the_map_is_tried_from_the_prediction_where_the_scan_before_was():
    predicted, guess = Pose(0.2, 0.1, 0.3), Pose(0.1, 0.0, 0.0)
    narrow, brief = Answer(Pose(), 0.01), Answer(Pose(), 0.01)
    tries = SecondTry(Answer(Pose(), 0.2), narrow, brief)
    tries.begin_scan(0.0, predicted)
    tries.register(CORNER, CORNER, Pose())
    assert brief.calls[0] == Pose()
    assert len(brief.calls) == 5
    tries.register(CORNER, CORNER, guess)
    assert brief.calls[5] == predicted
    assert {(call.x, call.y) for call in brief.calls[5:10]} == {(0.2, 0.1)}
    assert brief.calls[10:] == [guess]


@pytest.mark.parametrize("predicted", [None, Pose()])
@pytest.mark.parametrize(("error", "again"), [(0.099, False), (0.101, True)])
def test_more_than_ten_centimetres_are_tried_again_however_usual_they_are(error, again, predicted):
    narrow, brief, wide = Answer(Pose(), 0.01), Answer(Pose(), 0.01), Answer(Pose(), 0.01)
    tries = SecondTry(wide, narrow, brief)
    tries.begin_scan(0.06, predicted)
    tries.register(CORNER, CORNER, Pose())
    wide.error = error
    tries.register(CORNER, CORNER, Pose())
    assert bool(brief.calls) is again


@pytest.mark.parametrize("first", [0.01, 0.2])
@pytest.mark.parametrize(
    ("error", "predicted", "again"),
    [(0.0199, Pose(), False), (0.0201, Pose(), True), (0.0399, None, False), (0.0401, None, True)],
)
def test_without_odometry_twice_the_usual_error_is_enough_for_the_map_instead_of_four_times(
    first, error, predicted, again
):
    narrow, brief, wide = Answer(Pose(), 0.01), Answer(Pose(), 0.01), Answer(Pose(), first)
    tries = SecondTry(wide, narrow, brief)
    tries.begin_scan(0.01, predicted)
    tries.register(CORNER, CORNER, Pose())
    tried = len(brief.calls)
    assert tried == (5 if first == 0.2 else 0)
    wide.error = error
    tries.register(CORNER, CORNER, Pose())
    if tried and predicted is None:  # one try a scan
        again = False
    assert len(brief.calls) - tried == (0 if not again else 6 if tried else 5)


def test_without_odometry_a_poor_match_with_the_map_alone_is_tried_from_its_guess():
    narrow, brief, wide = Answer(Pose(), 0.01), Answer(Pose(), 0.01), Answer(Pose(), 0.01)
    tries = SecondTry(wide, narrow, brief)
    tries.begin_scan(0.0, Pose(0.2, 0.1, 0.3))
    tries.register(CORNER, CORNER, Pose())
    wide.error = 0.2
    tries.register(CORNER, CORNER, Pose(0.1, 0.0, 0.0))
    assert {(call.x, call.y) for call in brief.calls} == {(0.1, 0.0)}
    assert len(brief.calls) == 5


@pytest.mark.parametrize(("predicted", "taken"), [(None, "shifted"), (Pose(), "right")])
def test_a_scan_half_covered_lies_more_closely_where_it_is_but_has_more_points_near_where_it_is_not(predicted, taken):
    # 60 of 160 points are 0.2 m before the walls: shifted by 0.1 m, all are within 0.1 m of a wall, and none on it
    covered = CORNER.points + np.where(np.arange(160)[:, None] % 8 < 3, 0.2, 0.0)
    answers = {"right": Pose(), "shifted": Pose(-0.1, -0.1, 0.0)}
    wide, narrow = Answer(answers["right"], 0.2), Answer(answers["shifted"], 0.2)
    tries = SecondTry(wide, narrow, narrow)
    tries.begin_scan(0.0, predicted)
    if predicted is not None:
        wide.error = 0.01
        tries.register(CORNER, Cloud(covered), Pose())
        wide.error = 0.2
    assert tries.register(CORNER, Cloud(covered), Pose()).target_from_source == answers[taken]


def test_nothing_is_tried_again_against_no_points_and_the_try_is_kept_for_the_map():
    narrow, brief = Answer(Pose(), 0.01), Answer(Pose(), 0.01)
    tries = SecondTry(Answer(Pose(), np.nan, 0), narrow, brief)
    tries.begin_scan(0.0)
    tries.register(Cloud(np.zeros((0, 2))), CORNER, Pose())
    assert not brief.calls
    tries.register(CORNER, CORNER, Pose())
    assert len(brief.calls) == 5


@pytest.mark.parametrize(
    ("points", "enough", "left"), [(3, 100, 3), (199, 100, 199), (200, 100, 100), (1000, 300, 334)]
)
def test_a_part_of_a_cloud_has_enough_points_and_less_than_twice_as_many(points, enough, left):
    cloud = Cloud(np.arange(2.0 * points).reshape(points, 2))
    part = take_part(cloud, enough)
    assert len(part) == left
    assert np.array_equal(part.points, cloud.points[:: round(points / left)])


def test_a_large_scan_is_matched_with_a_part_and_then_with_all_points():
    whole, coarse, fine = Answer(Pose(), 0.3), Answer(Pose(0.1, 0.2, 0.3), 0.2), Answer(Pose(), 0.01)
    icp = CoarseToFine(Coarse(whole, coarse), fine)
    large = Cloud(np.zeros((1000, 2)))
    assert icp.register(CORNER, large, Pose()).error == 0.01
    assert (coarse.points, fine.points, fine.calls) == ([200], [1000], [Pose(0.1, 0.2, 0.3)])
    assert icp.register(CORNER, CORNER, Pose()).error == 0.3
    assert (whole.points, coarse.points, fine.points) == ([160], [200], [1000])


def test_the_pairs_of_a_part_count_as_those_of_all_points():
    whole, coarse = Answer(Pose(), 0.3), Answer(Pose(), 0.2, inliers=150)
    icp = Coarse(whole, coarse)
    assert icp.register(CORNER, Cloud(np.zeros((1000, 2))), Pose()).inliers == 750  # of 200 points
    assert icp.register(CORNER, CORNER, Pose()).inliers == 160
    few = Coarse(whole, Answer(Pose(), 0.2, inliers=9))  # not 45: the front end would accept them
    assert few.register(CORNER, Cloud(np.zeros((1000, 2))), Pose()).inliers == 9


def test_the_match_with_the_scan_before_has_registrations_of_its_own():
    wide, narrow, first, first_again = (Answer(Pose(), error) for error in (0.01, 0.01, 0.2, 0.3))
    tries = SecondTry(wide, narrow, Answer(Pose(), 0.2), scan_to_scan=(first, first_again))
    for _ in range(2):
        tries.begin_scan(0.0)
        tries.register(CORNER, CORNER, Pose())  # poor, so that it is tried again
        tries.register(CORNER, CORNER, Pose())
    calls = [len(each.calls) for each in (first, first_again, wide, narrow)]
    assert calls == [2, 2, 2, 0]


@pytest.mark.parametrize("turn_deg", [-22.0, 22.0])
def test_a_heading_far_off_is_found_back(turn_deg):
    icp = paper.MAP_LINE.make
    settings = {each.name: each.default for each in paper.MAP_LINE.parameters}
    corridor = np.concatenate(
        [square(-10.0, -0.8, 20.0, 1.6), square(3.0, 0.3, 0.5, 0.5), square(-4.0, -0.8, 0.6, 0.4)]
    )
    true = Pose(0.2, 0.1, 0.3)
    target, source = Cloud(corridor), Cloud(true.inverse().transform(corridor))
    wide, narrow = icp(**settings), icp(**{**settings, "max_correspondence_m": 0.3})
    match = SecondTry(wide, narrow, narrow).register(target, source, true @ Pose(0.1, 0.05, np.radians(turn_deg)))
    gap = match.target_from_source.inverse() @ true
    assert max(np.hypot(gap.x, gap.y), abs(gap.theta)) < 0.001


def square(x: float, y: float, width: float, depth: float) -> Floats:
    """Return points (N, 2) every 2.5 cm around a rectangle."""
    along, up = np.arange(0.0, width, 0.025), np.arange(0.0, depth, 0.025)
    sides = [(along, 0 * along), (along, 0 * along + depth), (0 * up, up), (0 * up + width, up)]
    return np.concatenate([np.column_stack(side) for side in sides]) + np.array([x, y])
