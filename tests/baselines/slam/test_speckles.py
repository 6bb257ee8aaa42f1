import numpy as np
import pytest

from evalkit.core.scan import Scan
from evalkit_baselines.slam.speckles import Speckles, find_speckles


def make_scan(ranges, step_deg=0.5):
    angles = np.radians(step_deg * np.arange(len(ranges)))
    return Scan(0, np.asarray(ranges, dtype=float), angles, 0.0, 30.0)


def find(ranges, step_deg=0.5):
    return [*np.flatnonzero(find_speckles(np.asarray(ranges), np.radians(step_deg * np.arange(len(ranges)))))]


def test_a_single_beam_before_or_behind_a_wall_is_a_speckle():
    ranges = np.full(100, 2.0)
    ranges[[20, 40, 60, 61]] = 1.6, 9.0, 1.0, 1.0  # two beside each other are a thing
    assert find(ranges) == [20, 40]


def test_the_limit_by_hand():
    """At 2 m the next beam, 0.5 deg away, may be 0.2 m + 5 x 2 m x 0.00873 = 0.287 m farther, the second 0.375 m."""
    for farther, expected in ((0.37, []), (0.38, [50])):
        ranges = np.full(100, 2.0 + farther)
        ranges[50] = 2.0
        assert find(ranges) == expected


@pytest.mark.parametrize("mirrored", [1, -1])
def test_the_walls_of_a_corridor_stay_but_for_their_ends(mirrored):
    angles = mirrored * np.radians(np.arange(-180.0, 180.0, 0.5))
    with np.errstate(divide="ignore"):
        ranges = np.abs(np.where(np.sin(angles) > 0.0, 1.2, 0.8) / np.sin(angles))
    seen = ranges <= 30.0
    ranges, angles = ranges[seen], angles[seen]
    assert (ranges[find_speckles(ranges, angles)] > 20.0).all()
    ranges[100::100] = 0.3
    assert find_speckles(ranges, angles)[100::100].all()


def test_the_first_beam_follows_the_last():
    ranges = np.full(360, 2.0)
    ranges[[0, 359]] = 1.0
    assert find(ranges, 1.0) == []
    ranges[359] = 2.0
    assert find(ranges, 1.0) == [0]


def test_speckles_are_left_out_while_their_mean_share_is_1_5_percent():
    """Six of 100 hits: after k scans, as if 50 without had gone before, 6 % of k / (50 + k); 1.5 % from the 17th on."""
    ranges = np.full(120, 2.0)
    ranges[20:40] = np.inf
    clean = make_scan(ranges)
    ranges[[5, 45, 65, 75, 85, 105]] = 9.0
    dirty, speckles = make_scan(ranges), Speckles()
    for number in range(1, 60):
        cleaned = speckles.drop(dirty)
        assert (cleaned is dirty) == (number < 17) == (not speckles.is_dirty)
    assert [*np.flatnonzero(np.isnan(cleaned.ranges))] == [5, 45, 65, 75, 85, 105]
    assert np.array_equal(cleaned.ranges[cleaned.hits], dirty.ranges[cleaned.hits])
    assert np.isinf(cleaned.ranges[20:40]).all()
    share, scans = speckles.share, speckles.scans
    assert speckles.drop(make_scan(np.full(10, np.inf))).ranges[0] == np.inf  # without a hit nothing is counted
    assert (speckles.share, speckles.scans) == (share, scans)
    for _ in range(600):
        assert speckles.drop(clean) is clean
    assert speckles.scans == 200
    assert speckles.drop(dirty) is dirty  # clean again


def test_short_scans_have_no_speckles():
    assert find([]) == find([1.0, 9.0, 1.0, 1.0]) == []
    assert find([1.0, 9.0, 1.0, 1.0, 1.0]) == [1]
