"""Scoring of a run: alignment, map and scores, also for an estimate that diverged."""

from dataclasses import replace

import numpy as np
import pytest

from evalkit import metrics
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, RunResult
from evalkit.core.run_status import Cause
from evalkit.core.scan import Scan
from evalkit.core.trajectory import Trajectory
from evalkit.metrics import evaluate
from evalkit.metrics.metric import MAP_GROUPS, MissingMap
from evalkit.plugins import registry
from evalkit.plugins.parameters import resolve_parameters

SCANS = 12


class RecordingMapper:
    """Mapper that records the scans it receives, and after how many of them a map was asked for."""

    def __init__(self, made):
        self.scans, self.maps = [], []
        made.append(self)

    def update(self, scan, world_from_sensor):
        self.scans.append((scan, world_from_sensor))

    def grid(self):
        self.maps.append(len(self.scans))
        return OccupancyGrid(np.zeros((1, 1)), np.zeros((1, 1)), 0.05, 0.0, 0.0)


class RecordingMapperFactory(list):
    """Factory of recording mappers; keeps every mapper it creates."""

    def __call__(self):
        return RecordingMapper(self)


@pytest.fixture
def mapper_factory():
    return RecordingMapperFactory()


@pytest.fixture
def straight_run(strangers):
    return registry.dataset("straight").make(SCANS, 0, "", False)


def log_odds():
    spec = registry.mapper("log-odds")
    return spec.make(**resolve_parameters("mapper", spec.parameters, {}))


def run_of(x, y=0.0, cause=Cause.COMPLETED, reason=""):
    steps = np.zeros(len(x), dtype=STEP)
    steps["stamp_ns"] = np.arange(len(x)) * 100_000_000
    steps["x"], steps["y"] = x, y
    steps["wall_ns"] = steps["cpu_ns"] = 2_000_000
    return RunResult(steps, SCANS, cause, reason)


def perfect():
    return run_of(0.1 * np.arange(SCANS))


def test_a_perfect_run_is_aligned_with_the_ground_truth_and_has_no_error(straight_run):
    scored = evaluate.evaluate_run(perfect(), straight_run, log_odds, 400)
    assert np.allclose(scored.world_from_start.row, [1.0, 0.0, 0.0], atol=1e-9)
    assert np.allclose(scored.errors_m, 0.0, atol=1e-9)
    assert scored.alignment == "least squares over 12 poses; 12 equal stamps"
    assert scored.by_metric["ate_rmse_m"].value == pytest.approx(0.0, abs=1e-9)
    assert scored.by_metric["cpu_median_ms"].value == pytest.approx(2.0)
    x, y = scored.grid.centres(scored.grid.occupied()).T
    assert min(x.min(), 8.0 - x.max(), y.min() + 2.0, 2.0 - y.max()) > -0.051  # the walls of the box, within a cell


@pytest.mark.parametrize("far_m", [1e6, 1e300])
def test_an_estimate_beyond_the_map_limit_loses_only_its_map(straight_run, far_m):
    x = 0.1 * np.arange(SCANS)
    x[-3:] = far_m
    with np.errstate(all="ignore"):
        scored = evaluate.evaluate_run(run_of(x, -x), straight_run, log_odds, 400)
    assert scored.grid is None
    for name in ("map_entropy", "occupied_percent", "corners"):
        assert scored.by_metric[name].value is None
        assert scored.by_metric[name].reason.startswith("no map: the mapper failed (")
    assert scored.by_metric["cpu_median_ms"].value == pytest.approx(2.0)
    assert (scored.by_metric["ate_rmse_m"].value or np.inf) > 1e5
    assert all(score.reason or np.isfinite(score.value) for score in scored.by_metric.values())


def test_a_mapper_that_raises_loses_only_the_map(straight_run):
    def broken():
        return registry.mapper("faulty-mapper").make("raise", 1.35)

    scored = evaluate.evaluate_run(perfect(), straight_run, broken, 400)
    assert scored.grid is None
    assert scored.by_metric["map_entropy"].reason == "no map: the mapper failed (lost the plot)"
    assert scored.by_metric["ate_rmse_m"].value == pytest.approx(0.0, abs=1e-9)


def test_a_mapper_that_returns_no_grid_loses_only_the_map(straight_run, monkeypatch):
    mapper = log_odds()
    monkeypatch.setattr(type(mapper), "grid", lambda _: np.zeros((3, 3)))
    scored = evaluate.evaluate_run(perfect(), straight_run, lambda: mapper, 400)
    what = "grid() returned a ndarray, expected an evalkit.OccupancyGrid"
    assert (scored.grid, scored.by_metric["map_entropy"].reason) == (None, f"no map: the mapper failed ({what})")
    assert scored.by_metric["ate_rmse_m"].value == pytest.approx(0.0, abs=1e-9)


def test_the_map_of_a_slam_is_drawn_from_its_corrected_poses_and_its_track_is_that_of_its_answers(straight_run):
    lost = np.where(np.arange(SCANS) < 6, 0.1 * np.arange(SCANS), 30.0 + 0.1 * np.arange(SCANS))
    found = perfect().estimate
    run = replace(run_of(lost), final=Trajectory(found.stamps_ns, found.poses, "start", "base"))
    scored = evaluate.evaluate_run(run, straight_run, log_odds, 400)
    alone = evaluate.evaluate_run(run_of(lost), straight_run, log_odds, 400)
    corrected = evaluate.evaluate_run(perfect(), straight_run, log_odds, 400)
    assert scored.grid.log_odds.tobytes() == corrected.grid.log_odds.tobytes()
    assert (scored.lost, scored.alignment) == (alone.lost, alone.alignment)
    assert alone.lost is not None
    assert scored.world_from_start == alone.world_from_start
    assert scored.errors_m.tobytes() == alone.errors_m.tobytes()
    assert np.allclose(scored.final.world_from_start.row, [1.0, 0.0, 0.0], atol=1e-9)
    assert np.allclose(scored.final.errors_m, 0.0, atol=1e-9)
    groups = {metric.name: metric.group for metric in metrics.METRICS if not metric.slam_only}
    of_map = {name for name, group in groups.items() if group in MAP_GROUPS}
    assert {name: scored.by_metric[name] for name in groups} == {
        name: (corrected if name in of_map else alone).by_metric[name] for name in groups
    }
    assert scored.by_metric["final_pair_error"] == corrected.by_metric["pair_error"]


def test_the_mapper_gets_the_given_number_of_evenly_spaced_scans_and_each_half_again(straight_run, mapper_factory):
    evaluate.evaluate_run(perfect(), straight_run, mapper_factory, 5)
    whole, second = ([pose.x for _, pose in mapper.scans] for mapper in mapper_factory)
    assert whole == pytest.approx([1.0, 1.2, 1.5, 1.8, 2.1])  # scans 0, 2, 5, 8, 11 of 12
    assert second == whole[2:]
    assert [mapper.maps for mapper in mapper_factory] == [[2, 5], [3]]  # first half and whole, second half


@pytest.mark.thorough
def test_free_space_violations_are_rare_with_true_poses_and_common_with_wheel_odometry():
    spec = registry.dataset("lab")
    lab = spec.make(**resolve_parameters("lab", spec.parameters, {"laps": 0.5, "seed": 1, "rate_hz": 5.0}))
    wheels = [frame.odom_from_base.row for frame in lab.frames()]
    violations = []
    for poses in (lab.truth().trajectory.poses, np.array(wheels)):
        steps = np.zeros(len(lab), dtype=STEP)
        steps["stamp_ns"] = lab.truth().trajectory.stamps_ns
        steps["x"], steps["y"], steps["theta"] = poses.T
        scored = evaluate.evaluate_run(RunResult(steps, len(lab)), lab, log_odds, 100)
        violations.append(scored.by_metric["cleared_percent"].value)
    assert violations[0] < 5.0
    assert violations[1] > 4.0 * violations[0]


def test_a_scan_without_an_answer_is_not_mapped_and_does_not_shift_others(straight_run, mapper_factory):
    run = perfect()
    answered = np.delete(run.steps, 4)
    evaluate.evaluate_run(RunResult(answered, SCANS), straight_run, mapper_factory, 400)
    assert [scan.stamp_ns for scan, _ in mapper_factory[0].scans] == answered["stamp_ns"].tolist()
    assert [pose.x for _, pose in mapper_factory[0].scans] == pytest.approx((1.0 + answered["x"]).tolist())


def test_every_method_is_mapped_with_the_same_scans(straight_run, mapper_factory):
    whole = perfect()
    for missing in ((), (2, 3), (0,), range(6, SCANS)):
        steps = np.delete(whole.steps, missing)
        evaluate.evaluate_run(RunResult(steps, SCANS), straight_run, mapper_factory, 5)
        drawn = [scan.stamp_ns // 100_000_000 for scan, _ in mapper_factory[-2].scans]
        assert drawn == [scan for scan in (0, 2, 5, 8, 11) if scan not in missing]


def test_scan_to_scan_residuals_use_consecutive_scans_even_if_few_are_mapped(straight_run, monkeypatch):
    seen = []
    monkeypatch.setattr(evaluate.metrics, "compute_scores", lambda evidence, _: seen.append(evidence) or {})
    run = perfect()
    evaluate.evaluate_run(RunResult(np.delete(run.steps, 4), SCANS), straight_run, log_odds, 3)
    pairs = [(a.stamp_ns // 100_000_000, b.stamp_ns // 100_000_000) for (a, _), (b, _) in seen[0].successive]
    assert pairs == [(k, k + 1) for k in range(SCANS - 1) if k not in (3, 4)]
    for (_, earlier), (_, later) in seen[0].successive:
        assert np.allclose(later - earlier, [0.1, 0.0, 0.0])


def test_an_incomplete_run_is_scored_up_to_its_last_answer(straight_run, mapper_factory):
    x = 0.1 * np.arange(4)
    scored = evaluate.evaluate_run(run_of(x, cause=Cause.SIGNAL, reason="signal"), straight_run, mapper_factory, 400)
    assert len(mapper_factory[0].scans) == len(scored.errors_m) == 4


def test_a_run_without_answers_gets_reasons_instead_of_values(straight_run, mapper_factory):
    scored = evaluate.evaluate_run(
        run_of(np.zeros(0), cause=Cause.TIME_LIMIT, reason="slow"), straight_run, mapper_factory, 400
    )
    assert scored.grid is None
    assert mapper_factory == []
    assert scored.by_metric["map_entropy"].reason == "no map: the run has no poses"
    assert scored.by_metric["ate_rmse_m"].value is None
    assert scored.alignment == "the run has no poses"


def test_without_ground_truth_nothing_is_aligned(straight_run, monkeypatch):
    monkeypatch.setattr(straight_run, "truth", lambda: Truth("none"))
    scored = evaluate.evaluate_run(perfect(), straight_run, log_odds, 400)
    assert scored.world_from_start == Pose()
    assert scored.errors_m is None
    assert scored.alignment == ""
    assert scored.grid is not None


def test_motion_within_a_scan_is_corrected_with_the_estimated_velocity(straight_run, mapper_factory, monkeypatch):
    ahead = np.zeros(3)  # three beams straight ahead, 50 ms from first to last: 5 cm at 1 m/s

    def frames(original=straight_run.frames):
        for frame in original():
            scan = Scan(frame.scan.stamp_ns, [4.0, 4.0, 4.0], ahead, 0.1, 20.0, 25_000_000)
            yield type(frame)(scan)

    monkeypatch.setattr(straight_run, "frames", frames)
    evaluate.evaluate_run(perfect(), straight_run, mapper_factory, 3)
    for scan, _ in mapper_factory[0].scans:
        assert scan.ranges.tolist() == pytest.approx([4.0, 4.025, 4.05])


def test_a_map_of_a_file_has_the_scores_of_its_walls_and_reasons_for_all_others(straight_run):
    whole = evaluate.evaluate_run(perfect(), straight_run, log_odds, 400).grid
    found = evaluate.evaluate_map(perfect(), whole, straight_run).by_metric
    assert list(found) == [metric.name for metric in metrics.all_metrics()]
    for name in evaluate.OF_THE_MAP_ALONE:
        assert found[name].value is not None
    for name in evaluate.OF_PROBABILITIES:
        assert found[name].reason == evaluate.NO_PROBABILITIES
    table = {metric.name: metric for metric in metrics.all_metrics()}
    for name in found.keys() - {*evaluate.OF_THE_MAP_ALONE, *evaluate.OF_PROBABILITIES}:
        if table[name].group != "map against truth":
            assert (found[name].value, found[name].support, found[name].reason) == (None, 0, evaluate.NO_TRAJECTORY)
        else:
            assert found[name].reason != evaluate.NO_TRAJECTORY


def test_a_run_without_the_maps_of_halves_has_the_whole_map_alone(straight_run, mapper_factory):
    evidence = evaluate.collect_evidence(perfect(), straight_run)
    found = evaluate.add_map(evidence, straight_run, mapper_factory, 400, halves=False)
    assert [(len(mapper.scans), mapper.maps) for mapper in mapper_factory] == [(SCANS, [SCANS])]
    assert isinstance(found.grid, OccupancyGrid)
    assert isinstance(found.first_half, MissingMap)
