import numpy as np
import pytest

from evalkit.core.scan import Scan
from evalkit_baselines.slam.range_noise import RangeNoise, count_beams, is_noisy, smooth_ranges


def make_scan(ranges, step_deg=0.225):
    angles = np.radians(180.0 - step_deg * np.arange(len(ranges)))
    return Scan(0, np.asarray(ranges, dtype=float), angles, 0.0, 30.0)


@pytest.mark.parametrize(
    ("step_deg", "beams"), [(0.1, 5), (0.225, 5), (0.29, 5), (0.45, 3), (0.59, 3), (0.61, 1), (1.0, 1)]
)
def test_the_median_spans_at_most_1_2_deg_and_five_beams(step_deg, beams):
    assert count_beams(np.radians(step_deg) * np.arange(100)) == beams


@pytest.mark.parametrize(("noise_m", "expected"), [(0.019, False), (0.021, True), (0.05, True)])
def test_noise_is_judged_beside_steps_and_missing_returns(noise_m, expected):
    rng = np.random.default_rng(0)
    ranges = 3.0 + noise_m * rng.standard_normal(20_000)
    ranges[::100] = np.inf
    ranges[1000:2000] += 4.0
    assert is_noisy(ranges) is expected
    assert not is_noisy(np.full(10, np.inf))
    assert not is_noisy(np.zeros(2))


def test_a_step_between_two_walls_stays_and_the_noise_becomes_smaller():
    rng = np.random.default_rng(1)
    true = np.where(np.arange(800) < 400, 2.0, 3.0)
    smooth = smooth_ranges(make_scan(true + 0.05 * rng.standard_normal(800))).ranges
    error = smooth - true
    # the variance of a median of five is 0.287 of that of one; a mean would be 0.2 m off beside the step
    assert error[2:-2].std() == pytest.approx(0.05 * np.sqrt(0.287), rel=0.1)
    assert np.abs(error[395:405]).max() < 0.12


def test_the_middle_one_of_five_beams_by_hand():
    ranges = np.tile([2.0, 2.4], 50)
    ranges[[10, 11, 12, 13, 14]] = [5.0, 1.0, 3.0, 2.0, 4.0]
    assert smooth_ranges(make_scan(ranges)).ranges[12] == 3.0
    ranges[14] = np.inf  # an incomplete window: the range stays
    assert smooth_ranges(make_scan(ranges)).ranges[12] == 3.0
    ranges[14], ranges[12] = 4.0, 9.0
    assert smooth_ranges(make_scan(ranges)).ranges[12] == 4.0


def test_scans_with_little_noise_or_wide_beams_are_the_same_object():
    rng = np.random.default_rng(2)
    quiet = make_scan(3.0 + 0.01 * rng.standard_normal(800))
    wide = make_scan(3.0 + 0.05 * rng.standard_normal(180), step_deg=1.0)
    empty = make_scan(np.full(800, np.inf))
    for scan in (quiet, wide, empty, make_scan([3.0]), make_scan([])):
        assert smooth_ranges(scan) is scan


def test_a_lidar_is_noisy_while_most_of_its_last_scans_are():
    rng = np.random.default_rng(3)
    quiet, noisy = make_scan(np.full(100, 3.0)), make_scan(3.0 + 0.05 * rng.standard_normal(100))
    lidar = RangeNoise()
    told = []
    for scan, count in ((noisy, 1), (quiet, 1), (quiet, 1), (noisy, 2), (quiet, 100)):
        for _ in range(count):
            lidar.smooth(scan)
        told.append(lidar.is_noisy)
    assert told == [True, False, False, True, False]  # 1 of 1, 1 of 2, 1 of 3, 3 of 5, 3 of 105
