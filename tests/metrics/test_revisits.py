"""Relations derived from a true trajectory: hand calculations on circles and lines."""

import numpy as np
import pytest

from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult
from evalkit.core.trajectory import Trajectory
from evalkit.metrics import revisits
from evalkit.metrics.metric import Evidence


def trajectory(x, y, theta):
    stamps = np.arange(len(x)) * 100_000_000
    return Trajectory(stamps, np.stack([x, y, np.broadcast_to(theta, np.shape(x))], axis=1))


def laps(count, radius_m=3.0, steps=400):
    angle = np.linspace(0.0, 2.0 * np.pi * count, round(steps * count), endpoint=False)
    return trajectory(radius_m * np.cos(angle), radius_m * np.sin(angle), angle + np.pi / 2.0)


def scores(estimate, truth):
    steps = np.zeros(len(estimate), STEP)
    steps["stamp_ns"] = estimate.stamps_ns
    steps["x"], steps["y"], steps["theta"] = estimate.poses.T
    run = RunResult(steps, len(steps))
    evidence = Evidence(run, Truth("exact", truth))
    return {metric.name: metric.compute(evidence) for metric in revisits.METRICS}


def test_two_laps_of_a_circle_have_one_revisit_per_place_of_the_first_lap() -> None:
    found = revisits.find_revisits(laps(1.9), near_m=0.5)
    assert len(found) == pytest.approx(0.9 * 2.0 * np.pi * 3.0 / 0.2, abs=4)
    same_place = found.second_ns - found.first_ns == 40_000_000_000
    assert (
        same_place.mean() > 0.95
    )  # except for the last half metre, which approaches the next start without reaching it
    assert np.allclose(found.first_from_second[same_place], 0.0, atol=1e-9)


def test_each_later_pass_counts_once_and_the_recent_past_is_ignored() -> None:
    three = revisits.find_revisits(laps(2.9), near_m=0.5, covered_m=10.0)
    gaps = np.unique(np.round((three.second_ns - three.first_ns) / 4e10).astype(int), return_counts=True)
    assert gaps[0].tolist() == [1, 2]
    assert gaps[1].tolist() == pytest.approx([1.9 * 94.2, 0.9 * 94.2], abs=5)


def test_a_straight_line_has_no_revisits() -> None:
    x = np.linspace(0.0, 30.0, 300)
    found = scores(trajectory(x, 0.0 * x, 0.0), trajectory(x, 0.0 * x, 0.0))
    assert found["revisit_mean_m"].reason == "the true path does not revisit a place"
    two = trajectory(np.array([0.0, 5.0]), np.zeros(2), 0.0)
    assert scores(two, two)["revisit_mean_m"].reason == "the true path does not revisit a place"


@pytest.mark.parametrize("metres", [0.06, 1.2, 3.0, 7.9])
def test_a_short_drive_straight_on_has_no_revisits_and_one_out_and_back_has(metres) -> None:
    x = np.linspace(0.0, metres, 100)
    assert len(revisits.find_revisits(trajectory(x, 0.0 * x, 0.0))) == 0
    back = np.concatenate([x, x[::-1]])
    found = revisits.find_revisits(trajectory(back, 0.0 * back, 0.0))
    assert (len(found) > 0) == (2.0 * metres > 2.0)


def test_a_shifted_second_lap_has_the_shift_as_error() -> None:
    truth = laps(1.9)
    shifted = np.array(truth.poses)
    shifted[400:, 0] += 0.25
    shifted[400:, 2] += np.radians(3.0)
    found = scores(Trajectory(truth.stamps_ns, shifted), truth)
    assert found["revisit_mean_m"].value == pytest.approx(0.25, abs=0.01)
    assert found["revisit_mean_deg"].value == pytest.approx(3.0)
    assert scores(truth, truth)["revisit_mean_m"].value == pytest.approx(0.0, abs=1e-9)


def test_an_estimate_that_ends_before_the_revisit_has_no_answers() -> None:
    truth = laps(2)
    found = scores(Trajectory(truth.stamps_ns[:50], truth.poses[:50]), truth)
    assert found["revisit_mean_m"].reason.startswith("the estimate covers none of ")
    assert scores(truth, None)["revisit_mean_m"].reason == "no ground-truth trajectory"


def test_revisits_beyond_either_limit_are_outliers() -> None:
    errors = np.array([[0.15, 0.02], [0.16, 0.0], [0.0, 0.021], [0.0, 0.0]])
    assert revisits.within_limits(errors).tolist() == [True, False, False, True]
    truth = laps(1.9)
    assert scores(truth, truth)["revisit_within_percent"].value == 100.0
    for off, share in (
        (np.array([0.1, 0.0, 0.0]), 100.0),
        (np.array([0.3, 0.0, 0.0]), 0.0),
        (np.array([0, 0, 0.03]), 0.0),
    ):
        drawn = np.array(truth.poses)
        drawn[400:] += off
        found = scores(Trajectory(truth.stamps_ns, drawn), truth)["revisit_within_percent"]
        assert found.value == pytest.approx(share, abs=6.0)  # the first lap ends where the second begins


def test_visits_are_those_that_brute_force_finds() -> None:
    rng = np.random.default_rng(4)
    heading = np.cumsum(rng.normal(0.0, 0.2, 600))
    path = trajectory(*np.round(np.cumsum([np.cos(heading), np.sin(heading)], axis=1) * 0.15, 1), heading)
    positions = path.poses[:, :2]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
    expected = []
    for place in np.unique(np.searchsorted(along, np.arange(0.0, along[-1], revisits.EVERY_M))).tolist():
        stretch = []
        for other in range(len(path) + 1):
            near = other < len(path) and along[other] >= along[place] + 8.0
            near = near and np.linalg.norm(positions[other] - positions[place]) <= 1.0
            if near:
                stretch.append(other)
            elif stretch:
                best = min(stretch, key=lambda one: np.linalg.norm(positions[one] - positions[place]))
                expected.append((path.stamps_ns[place], path.stamps_ns[best]))
                stretch = []
    found = revisits.find_revisits(path, covered_m=8.0)
    assert len(expected) > 50
    assert list(zip(found.first_ns, found.second_ns, strict=True)) == expected


def test_on_a_path_of_more_than_400_m_a_place_is_revisited_after_100_m() -> None:
    """Five laps of 100.5 m: each of 503 places a lap is met again a lap later, but for those of the last one."""
    found = revisits.find_revisits(laps(4.9, radius_m=100.5 / (2.0 * np.pi), steps=600), near_m=0.3)
    gaps = {lap: int((found.second_ns - found.first_ns == lap * 60_000_000_000).sum()) for lap in (1, 2, 3, 4)}
    share = len(found) / (503 * (3.9 + 2.9 + 1.9 + 0.9))  # at most 2,000 are kept
    assert share == pytest.approx(2000 / 4829, rel=0.01)
    assert [gaps[lap] / share for lap in gaps] == pytest.approx([503 * laps for laps in (3.9, 2.9, 1.9, 0.9)], rel=0.03)


def test_at_most_two_thousand_revisits_are_kept_evenly_spaced() -> None:
    """Each of 2,827 places of the first lap of 565 m is revisited once."""
    found = revisits.find_revisits(laps(2.0, radius_m=90.0, steps=5655), near_m=0.3)
    assert len(found) == revisits.MAX_REVISITS == 2000
    spacing = np.diff(np.unique(found.first_ns))
    assert spacing.max() <= 3.0 * np.median(spacing)
    assert found.first_ns[0] == 0
