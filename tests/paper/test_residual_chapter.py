"""The chapter of Figure 9: spikes, error definitions, and the page of a short drive."""

import numpy as np
import pytest

from evalkit.plugins import registry
from evalkit_paper import lab_drives, residual_chapter, spike_causes, spikes, stage_errors
from evalkit_paper.spikes import Band

S = 1.0
CALM = Band(1.0, 0.1)  # a spike starts above 1.5 and ends below 1.2


def test_a_band_is_the_median_and_robust_spread_of_the_calm_scans():
    values = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 900.0, np.nan])
    calm = np.array([True, True, True, True, True, False, True])
    found = spikes.compute_band(values, calm)
    assert (found.median, found.sigma) == (3.0, pytest.approx(1.4826))


def test_a_spike_lasts_from_the_first_scan_above_the_band_to_the_last():
    values = np.array([1.0, 1.3, 1.8, 1.6, 1.25, 1.1, 1.4, 1.0])
    (found,) = spikes.find_spikes(values, CALM)  # 1.4 leaves the band but is not a spike
    assert (found.first, found.last, found.peak, found.height, found.ended) == (1, 4, 2, 1.8, True)
    assert spikes.duration_s(found, np.arange(8.0)) == 4.0


def test_a_spike_at_the_end_of_a_drive_has_not_ended():
    (found,) = spikes.find_spikes(np.array([np.nan, 1.0, 1.7, 1.9]), CALM)
    assert not found.ended
    assert spikes.duration_s(found, np.arange(4.0)) == 1.0


def test_a_spike_belongs_to_the_event_at_or_shortly_before_its_peak():
    times = np.arange(0.0, 10.0, 0.1)
    (found,) = spikes.find_spikes(np.where(np.arange(100) == 50, 2.0, 1.0), CALM)  # at 5.0 s
    assert spikes.belongs_to(found, times, (4.2, 4.5))
    assert spikes.belongs_to(found, times, (5.05, 5.5))
    assert not spikes.belongs_to(found, times, (3.0, 3.5))
    assert not spikes.belongs_to(found, times, (5.3, 5.5))


def test_events_are_the_runs_of_marked_scans():
    marked = np.array([True, False, True, True, False, True])
    assert spikes.find_events(np.arange(6.0), marked) == [(0.0, 0.0), (2.0, 3.0), (5.0, 5.0)]


def test_the_three_error_definitions_of_known_distances():
    assert stage_errors.compute_readings(np.array([3.0, 4.0])) == (3.5, pytest.approx(np.sqrt(12.5)), 12.5)


def test_recorded_errors_and_poses_equal_those_of_the_front_end():
    lab = registry.dataset("lab").make(laps=0.03, rate_hz=5.0, noise_m=0.01)
    found = stage_errors.run_with_errors(lab, "paper", {}, every_pair=True)
    spec = registry.backend("paper")
    plain = stage_errors.frontend.make_odometry(
        spec,
        stage_errors.frontend.complete_parameters("paper", spec, {}),
    )
    estimates = [plain.update(frame) for frame in lab.frames()]
    np.testing.assert_array_equal(found.poses, [estimate.pose.row for estimate in estimates])
    for stage in stage_errors.STAGES:
        errors = [estimate.stages[stage].residual_m for estimate in estimates[1:]]
        np.testing.assert_allclose(found.errors[stage][1:, 0], errors, atol=1e-12)
        assert np.isnan(found.errors[stage][0]).all()
        assert (found.errors[stage][1:, 3] >= found.errors[stage][1:, 0]).all()  # the filter keeps the closest pair


def test_yaw_rates_are_those_of_the_faster_step():
    poses = np.array([[0, 0, 0.0], [0, 0, 0.1], [0, 0, 0.4], [0, 0, 0.4]])
    stamps = np.arange(4) * 500_000_000
    np.testing.assert_allclose(stage_errors.yaw_rates_dps(stamps, poses), np.degrees([0.2, 0.6, 0.6, 0.0]))


def test_lost_scans_are_found_from_gaps_and_slips_from_their_schedule():
    times = np.array([0.0, 0.1, 0.2, 0.7, 0.8])
    assert lab_drives._events("gaps", times, np.zeros(5), None, {"rate_hz": 10.0}) == [(0.2, 0.7)]
    assert lab_drives._events("gaps in turns", times, np.zeros(5), None, {"rate_hz": 10.0}) == []
    slips = lab_drives._events("slips", times, np.zeros(5), None, {"slip_every_s": 1.0, "slip_s": 0.2})
    assert slips == [(0.5, 0.7)]


QUICK = {
    "speed_mps": 0.3,
    "rates_hz": "10",
    "yaw_dps": "20 90",
    "laps": 0.3,
    "turn_laps": 0.3,
    "yaw_laps": 0.28,
    "speeds_mps": "0.1 0.29",
    "speed_laps": 0.05,
    "people": 1,
}


@pytest.mark.slow
@pytest.mark.thorough
def test_fast_turns_cause_spikes_and_deskewing_removes_them():
    settings = residual_chapter.CHAPTER.settings("test", QUICK)
    results = {task.name: task.run()[0] for task in residual_chapter.CHAPTER.tasks(settings)}
    rows = {row.cause.name: row for row in spike_causes.cause_spikes(settings, results, "s2s")}
    assert rows["quick turns"].hit == rows["quick turns"].count == 1
    assert rows["quick turns, deskewed"].hit == rows["slow turns"].hit == 0
    steady, slow, low, spiking = residual_chapter.CHAPTER.findings(settings, results)
    found = [finding.judgement.verdict for finding in (steady, slow, low, spiking)]
    assert found == ["reproduced with a correction"] * 2 + ["reproduced"] * 2
    (section,) = residual_chapter.CHAPTER.sections(settings, results)
    assert section.anchor == steady.anchor
