import numpy as np
import pytest

from evalkit.core.pose import Pose
from evalkit.core.scan import Scan
from evalkit.plugins import registry
from evalkit_baselines.slam.companions import FREE_M, MOVED_M, Companions

ANGLES = np.radians(np.arange(-180.0, 180.0))
DEGREES = np.arange(-180, 180)
BEHIND = np.abs(DEGREES) >= 168
AHEAD = np.abs(DEGREES) <= 12


def corridor(x_m: float = 0.0, half_m: float = 1.0, end_m: float = 20.0) -> np.ndarray:
    """Return the ranges from a place on the axis of a corridor with ends, along x."""
    cos, sin = np.cos(ANGLES), np.sin(ANGLES)
    to_side = half_m / np.maximum(np.abs(sin), 1e-9)
    to_end = np.where(cos > 0.0, end_m - x_m, end_m + x_m) / np.maximum(np.abs(cos), 1e-9)
    return np.minimum(to_side, to_end)


def scan(ranges: np.ndarray) -> Scan:
    return Scan(0, np.where(ranges < 12.0, ranges, np.inf), ANGLES, 0.1, 12.0)


def drive(make_ranges, companions=None, begin=0) -> list[np.ndarray]:
    """Return which hits were left out of each of 40 scans along x; ``make_ranges`` (x) gives their ranges."""
    companions = companions or Companions()
    dropped = []
    for at in range(begin, begin + 40):
        given = scan(make_ranges(at * 0.1))
        dropped.append(given.hits & ~companions.drop(given, Pose(at * 0.1, 0.0, 0.0)).hits)
    return dropped


@pytest.mark.parametrize("where", [BEHIND, AHEAD], ids=["behind", "ahead"])
@pytest.mark.parametrize("away_m", [0.3, 1.2, 2.5])
def test_a_companion_is_left_out_from_half_a_metre_on_and_the_walls_of_the_corridor_stay(where, away_m):
    dropped = drive(lambda x: np.where(where, np.minimum(corridor(x), away_m), corridor(x)))
    assert not np.any(dropped[: round(MOVED_M / 0.1)])
    for one in dropped[round(MOVED_M / 0.1) + 1 :]:
        np.testing.assert_array_equal(one, where)


def test_a_body_is_left_out_while_the_robot_turns_on_the_spot():
    def room(at_deg):
        return np.roll(corridor(end_m=4.0), -round(at_deg))

    companions, dropped = Companions(), []
    for at in range(0, 360, 5):
        given = scan(np.where(BEHIND, 0.3, room(at)))
        kept = companions.drop(given, Pose(0.0, 0.0, np.radians(at)))
        dropped.append(given.hits & ~kept.hits)
    assert not np.any(dropped[:4])
    for one in dropped[5:]:
        np.testing.assert_array_equal(one, BEHIND)


@pytest.mark.parametrize(
    "ranges",
    [
        lambda _: np.minimum(corridor(0.0, 4.0, 5.0), 3.1),  # wheels that slip: nothing is within 3 m
        lambda _: corridor(0.0, 1.0, 1.0),  # a small room: more than 30 % move along
        lambda x: np.where(BEHIND, 1.2 + 0.5 * x, corridor(x)),  # falls behind, by 0.25 m in 0.5 m
        lambda x: np.where(DEGREES == -180, 0.3, corridor(x)),  # a sector of three beams is 1 % of the hits
        corridor,
    ],
    ids=["far walls", "most", "another speed", "few", "nothing"],
)
def test_what_is_far_or_most_or_little_or_moves_otherwise_stays(ranges):
    assert not np.any(drive(ranges))


def test_hits_farther_behind_a_companion_than_the_free_space_before_it_stay():
    """Its sector at -180 deg has two beams: one meets its edge, the other a wall behind it."""

    def ranges(x, behind_m):
        seen = np.where(BEHIND, 1.2, corridor(x))
        return np.where(DEGREES == -169, 1.2 + behind_m, seen)

    for behind_m, is_own in ((FREE_M - 0.01, True), (FREE_M + 0.01, False)):
        assert drive(lambda x, by=behind_m: ranges(x, by))[-1][DEGREES == -169] == is_own


def test_a_companion_that_comes_later_is_left_out_once_the_mean_of_the_last_scans_is_0_7():
    """A mean of ten scans, 0 before: 1 - 0.9^k reaches 0.7 with the twelfth."""
    companions = Companions()
    drive(corridor, companions=companions)

    def with_company(x):
        return np.where(BEHIND, 1.2, corridor(x))

    dropped = [np.any(one) for one in drive(with_company, companions, begin=40)]
    first = dropped.index(True)
    assert first == 11 + round(MOVED_M / 0.1)
    assert all(dropped[first:])


def test_without_odometry_nothing_is_left_out_and_the_comparison_begins_anew():
    companions, given = Companions(), scan(np.where(BEHIND, 1.2, corridor()))
    assert companions.drop(given, Pose()) is given
    assert companions.drop(given, None) is given
    assert companions.drop(given, Pose(5.0, 0.0, 0.0)) is given  # the first one again
    assert not companions.drop(given, Pose(5.6, 0.0, 0.0)).hits[BEHIND].any()
    empty = scan(np.full(360, np.inf))
    assert companions.drop(empty, Pose(6.5, 0.0, 0.0)) is empty


@pytest.mark.parametrize("world", ["loop", "doors", "symmetric-office"])
@pytest.mark.parametrize("rate_hz", [5.0, 10.0])
def test_no_hit_of_an_undisturbed_drive_is_left_out(world, rate_hz):
    companions = Companions()
    for frame in registry.dataset(world).make(seed=0, rate_hz=rate_hz).frames():
        assert companions.drop(frame.scan, frame.odom_from_base @ frame.base_from_sensor) is frame.scan
