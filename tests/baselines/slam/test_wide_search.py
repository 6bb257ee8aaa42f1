import numpy as np
import pytest

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit_baselines.slam.second_try import SecondTry
from evalkit_baselines.slam.wide_search import WideSearch

ALONG = np.arange(0.0, 4.0, 0.05)
ROOM = Cloud(
    np.concatenate(
        [
            np.column_stack([ALONG, 0.0 * ALONG]),
            np.column_stack([0.0 * ALONG, 0.6 * ALONG]),
            np.column_stack([ALONG, 2.4 + 0.3 * ALONG]),
        ]
    )
    - np.array([1.5, 1.0])
)
CIRCLE = Cloud(2.0 * np.column_stack([np.cos(ALONG * np.pi / 2.0), np.sin(ALONG * np.pi / 2.0)]))
TRUE = Pose(0.6, -0.5, np.radians(50.0))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_scan_50_deg_and_80_cm_from_its_prediction_is_found(side):
    true = Pose(TRUE.x, TRUE.y, side * TRUE.theta)
    place = WideSearch().find(ROOM, true.inverse().transform(ROOM.points), Pose())
    gap = place.pose.inverse() @ true
    assert np.hypot(gap.x, gap.y) < 0.1
    assert abs(gap.theta) < np.radians(3.0)
    assert place.alone


def test_in_a_round_room_no_heading_is_alone():
    assert not WideSearch().find(CIRCLE, CIRCLE.points, Pose()).alone


def test_along_a_bare_corridor_the_heading_is_alone_and_the_position_is_that_of_the_prediction():
    along = np.arange(-10.0, 10.0, 0.05)
    corridor = np.concatenate([np.column_stack([along, side + 0.0 * along]) for side in (-1.0, 1.0)])
    seen = corridor[np.abs(corridor[:, 0]) < 5.0]
    place = WideSearch().find(Cloud(corridor), Pose(0.0, 0.0, np.radians(30.0)).inverse().transform(seen), Pose())
    assert place.alone
    assert abs(place.pose.x) < 0.15
    assert abs(np.degrees(place.pose.theta) - 30.0) < 3.0


def test_another_map_is_searched_anew():
    search, moved = WideSearch(), Cloud(ROOM.points + np.array([0.4, 0.0]))
    assert search.find(ROOM, ROOM.points, Pose()).pose.x == pytest.approx(0.0, abs=0.06)
    assert search.find(moved, ROOM.points, Pose()).pose.x == pytest.approx(0.4, abs=0.11)


class Stay:
    """A registration that answers its guess: near the truth it fits, elsewhere it does not."""

    def __init__(self, true, inliers=1.0):
        self.true, self.inliers = true, inliers

    def register(self, target, source, guess):
        gap = guess.inverse() @ self.true
        fits = np.hypot(gap.x, gap.y) < 0.15
        return Match(guess, True, 3, 0.01 if fits else 0.2, int(self.inliers * len(source)))


@pytest.mark.parametrize("predicted", [None, Pose()])
def test_the_search_finds_a_doubted_scan_on_the_map_without_odometry_alone(predicted):
    tries = SecondTry(Stay(TRUE), Stay(TRUE), Stay(TRUE), search=WideSearch())
    tries.begin_scan(0.01, predicted)
    source = Cloud(TRUE.inverse().transform(ROOM.points))
    tries.register(ROOM, source, Pose())
    gap = tries.register(ROOM, source, Pose()).target_from_source.inverse() @ TRUE
    assert (np.hypot(gap.x, gap.y) < 0.15) == (predicted is not None)


@pytest.mark.parametrize(("inliers", "taken"), [(0.79, False), (0.81, True)])
def test_a_place_that_is_not_alone_counts_where_the_match_fits_as_usual(inliers, taken):
    true, guess = Pose(0.6, -0.5, 0.0), Pose(5.0, 0.0, 0.0)
    tries = SecondTry(Stay(true), Stay(true, inliers), Stay(true), search=WideSearch())
    source = Cloud(true.inverse().transform(CIRCLE.points))
    tries.begin_scan(0.01, Pose())
    for _ in range(2):
        gap = tries.register(CIRCLE, source, guess).target_from_source.inverse() @ true
    assert (np.hypot(gap.x, gap.y) < 0.15) == taken
