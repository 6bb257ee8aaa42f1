import numpy as np
import pytest

from evalkit.core.scan import Scan
from evalkit_datasets.worlds.lidar import LidarModel


def measure(lidar, ranges, seed=0):
    noise, dropouts = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2))
    return lidar.add_errors(ranges, noise, dropouts)


@pytest.mark.parametrize(("rate_hz", "beams"), [(5.0, 1600), (10.0, 800), (15.0, 533)])
def test_a_revolution_has_the_number_of_beams_in_the_paper(rate_hz, beams):
    assert LidarModel(rate_hz).beams == len(LidarModel(rate_hz).angles()) == beams


@pytest.mark.parametrize("rate_hz", [5.0, 7.3, 15.0])
def test_beams_rotate_clockwise_through_one_revolution(rate_hz):
    lidar = LidarModel(rate_hz)
    steps = np.diff(lidar.angles())
    np.testing.assert_allclose(steps, -2.0 * np.pi * rate_hz / 8000.0, rtol=1e-9)
    gap = 2.0 * np.pi + steps.sum()  # from the last beam to the first of the next revolution
    assert -steps[0] <= gap + 1e-12 < -2.0 * steps[0]


def test_every_beam_has_its_own_time():
    lidar = LidarModel(10.0)
    stamps = lidar.stamps(1_000_000_000)
    np.testing.assert_array_equal(stamps, np.arange(10) * 100_000_000)
    beams = lidar.beam_stamps(stamps)
    assert beams.shape == (10, 800)
    assert beams[3, 5] == 300_000_000 + 5 * 125_000
    assert beams.max() <= 1_000_000_000


def test_a_revolution_that_does_not_end_in_time_is_not_started():
    lidar = LidarModel(5.0)
    assert len(lidar.stamps(1599 * 125_000)) == 1
    assert len(lidar.stamps(1599 * 125_000 - 1)) == 0
    assert len(lidar.stamps(200_000_000 + 1599 * 125_000)) == 2


def test_without_noise_and_dropouts_ranges_are_exact():
    true = np.array([0.149, 0.15, 3.0, 12.0, 12.001, np.inf])
    np.testing.assert_array_equal(
        measure(LidarModel(noise_m=0.0, dropout=0.0), true), [np.nan, 0.15, 3.0, 12.0, np.inf, np.inf]
    )


def test_range_noise_has_the_standard_deviation_of_the_paper():
    count = 200_000
    error = measure(LidarModel(dropout=0.0), np.full(count, 5.0)) - 5.0
    assert abs(error.mean()) < 4.0 * 0.0483 / np.sqrt(count)
    assert abs(error.std() - 0.0483) < 4.0 * 0.0483 / np.sqrt(2.0 * count)


def test_a_noisy_range_outside_the_limits_becomes_no_return_or_invalid():
    far, near = measure(LidarModel(dropout=0.0), np.full((2, 10_000), [[12.0], [0.15]]))
    for found, lost in ((far, np.isposinf(far)), (near, np.isnan(near))):
        assert 0.48 < lost.mean() < 0.52
        Scan(0, found, np.zeros(len(found)), 0.15, 12.0)  # the remaining ranges are within the limits


def test_dropouts_are_invalid_and_have_the_given_rate():
    count = 100_000
    lost = np.isnan(measure(LidarModel(dropout=0.01), np.full(count, 5.0)))
    assert abs(lost.mean() - 0.01) < 4.0 * np.sqrt(0.01 * 0.99 / count)


def test_noise_and_dropouts_are_independent():
    true = np.full(5000, 5.0)
    quiet, noisy = measure(LidarModel(noise_m=0.0), true), measure(LidarModel(noise_m=0.1), true)
    np.testing.assert_array_equal(np.isnan(quiet), np.isnan(noisy))
    whole, holed = measure(LidarModel(dropout=0.0), true), measure(LidarModel(dropout=0.5), true)
    np.testing.assert_array_equal(whole[np.isfinite(holed)], holed[np.isfinite(holed)])


@pytest.mark.parametrize("wrong", [{"rate_hz": 0.0}, {"noise_m": -0.1}, {"dropout": 1.5}])
def test_an_invalid_lidar_is_rejected(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        LidarModel(**wrong)
