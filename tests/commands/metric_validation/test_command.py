"""The cards of the metrics, the self-test, and a quick validation of the metrics."""

import json
from fnmatch import fnmatchcase

import numpy as np
import pytest
from typer.testing import CliRunner

from evalkit import metrics
from evalkit.commands.metric_validation import command as commands
from evalkit.commands.metric_validation import map_rebuilding, validation
from evalkit.commands.metric_validation.command import app
from evalkit.commands.metric_validation.fault_injection import FAULTS, NO_FAULT
from evalkit.commands.metric_validation.rank_agreement import reference_free_metrics
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult
from evalkit.core.run_status import Cause
from evalkit.core.trajectory import Trajectory
from evalkit.io.output_files import format_json
from evalkit.metrics import evaluate
from evalkit.metrics.metric import NO_POSES, Evidence, MissingMap
from evalkit.metrics.trajectory import match_trajectories


def run_app(*words):
    result = CliRunner().invoke(app, [*words], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_every_metric_states_its_support_and_its_reasons():
    for metric in metrics.METRICS:
        assert metric.support, metric.name
        assert metric.no_value, metric.name


def poor_evidence():
    """Return evidence with different missing parts."""
    steps = np.zeros(3, STEP)
    steps["stamp_ns"] = np.arange(3) * 10**9
    steps["x"] = [0.0, 0.1, 0.2]
    empty = OccupancyGrid(np.zeros((2, 2), np.float32), np.zeros((2, 2), np.bool_), 0.05, 0.0, 0.0)
    stood = Trajectory(steps["stamp_ns"], np.zeros((3, 3)))
    for rows in (steps[:0], steps):
        run = RunResult(rows, 0, Cause.EXCEPTION, "it broke")
        for truth in (Truth("none"), Truth("exact", stood), Truth("exact", stood, grid=empty)):
            for grid in (MissingMap(NO_POSES), empty):
                matched = match_trajectories(run.estimate, truth.trajectory)
                yield Evidence(run, truth, matched, grid, first_half=grid, second_half=grid)


def test_every_reason_of_a_metric_is_on_its_card():
    for evidence in poor_evidence():
        for metric, score in zip(metrics.METRICS, metrics.compute_scores(evidence).values(), strict=True):
            if score.value is None:
                patterns = [reason.replace("...", "*") for reason in metric.no_value]
                assert any(fnmatchcase(score.reason, pattern) for pattern in patterns), (metric.name, score.reason)


def values(error):
    """Every metric one more than the error, or its inverse."""
    return {m.name: 1.0 / (1.0 + error) if m.better == "higher" else 1.0 + error for m in metrics.METRICS}


def make_result(task):
    """The result of a task in a world where every metric follows the error."""
    if task.function.__name__ == "score_with_fault":
        return {"scores": values(0.0 if task.arguments["fault"] == NO_FAULT else 9.0)}
    sizes = task.arguments["sizes"] or [0.0]
    return {"rows": [{"size": size, **values(size), "ate_rmse_m": size} for size in sizes]}


def test_a_metric_that_follows_the_error_agrees_and_detects_every_fault():
    plan = validation.MetricValidationPlan(("lab", "room"), "log-odds", "lab", 3)
    results = {task.name: make_result(task) for task in validation.make_tasks(plan)}
    provenance = {"command": "python -m ...", "created": "2026-01-01", "versions": {"numpy": "2"}}
    content = validation.summarize(plan, results, provenance)
    assert [row["overall"]["value"] for row in content["agreement"]] == [1.0] * len(reference_free_metrics())
    assert [row["fault"] for row in content["faults"]] == list(FAULTS)
    assert all(row["metric_count"] for row in content["faults"])
    assert all(row["strongest"][0]["factor"] == pytest.approx(10.0) for row in content["faults"])
    maps = validation.collect_maps(plan, results)
    assert content["map_count"] == len(maps)
    assert json.loads(format_json(content)) == json.loads(json.dumps(content))
    lines = validation.format_csv(maps).splitlines()
    assert len(lines) == 1 + 2 * (1 + 3 * 6)
    assert lines[0].startswith("world,perturbation,size,ate_rmse_m,")


def test_sizes_reach_from_the_smallest_to_the_largest():
    assert validation.choose_sizes("jump", 2) == (0.05, 0.8)
    assert validation.choose_sizes("jump", 5) == (0.05, 0.1, 0.2, 0.4, 0.8)


def test_a_clean_run_of_given_poses_has_no_error():
    sequence = map_rebuilding.load_world("room", 0)
    run = map_rebuilding.make_run(sequence, map_rebuilding.find_true_poses(sequence))
    evidence = evaluate.collect_evidence(run, sequence)
    assert metrics.compute_scores(evidence)["ate_rmse_m"].value == pytest.approx(0.0, abs=1e-9)


def test_the_self_test_fails_if_a_fault_is_not_detected(monkeypatch):
    monkeypatch.setattr(commands, "run_shown_tasks", lambda tasks, *_: {task.name: make_result(task) for task in tasks})
    assert [row["metric_count"] > 0 for row in json.loads(run_app("selftest", "--json"))] == [True] * len(FAULTS)
    blind = {"scores": values(0.0)}
    monkeypatch.setattr(commands, "run_shown_tasks", lambda tasks, *_: {task.name: blind for task in tasks})
    result = CliRunner().invoke(app, ["selftest"], catch_exceptions=False)
    assert result.exit_code == 1
    assert "nothing" in result.output


@pytest.mark.thorough
def test_a_quick_validation_writes_table_page_and_values(monkeypatch, tmp_path):
    monkeypatch.setattr(commands, "run_shown_tasks", lambda tasks, *_: {task.name: make_result(task) for task in tasks})
    output = run_app("validate", "--quick", "--world", "lab", "-o", str(tmp_path))
    assert "split_distance_m" in output
    content = json.loads((tmp_path / "validated.json").read_text(encoding="utf-8"))
    assert (content["worlds"], content["scans"]) == (["lab"], 40)
    assert (tmp_path / "maps.csv").is_file()
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert page.count(">1.00<") >= len(reference_free_metrics())
    assert all(fault in page for fault in FAULTS)
