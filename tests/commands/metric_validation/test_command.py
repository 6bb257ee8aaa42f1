"""The cards of the metrics, the self-test, and a quick validation of the metrics."""

import json
from fnmatch import fnmatchcase

import numpy as np
import pytest
from typer.testing import CliRunner

from evalkit import metrics
from evalkit.commands.metric_validation import command as commands
from evalkit.commands.metric_validation import map_rebuilding
from evalkit.commands.metric_validation import measured as trust
from evalkit.commands.metric_validation.command import app
from evalkit.commands.metric_validation.fault_injection import NO_MISTAKE, PLANTS
from evalkit.commands.metric_validation.rank_agreement import reference_free
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, Cause, RunResult
from evalkit.core.trajectory import Trajectory
from evalkit.metrics import evaluate
from evalkit.metrics.table import NO_POSES, Evidence, MissingMap
from evalkit.metrics.trajectory import match_trajectories
from evalkit.report.html.blocks import render


def told(*words):
    result = CliRunner().invoke(app, [*words], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_every_own_metric_says_what_it_stands_on():
    for metric in metrics.METRICS:
        assert metric.support, metric.name
        assert metric.no_value, metric.name


def poor():
    """Evidence that lacks this or that."""
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


def test_a_reason_that_a_metric_gives_stands_on_its_card():
    for evidence in poor():
        for metric, score in zip(metrics.METRICS, metrics.compute_scores(evidence).values(), strict=True):
            if score.value is None:
                patterns = [reason.replace("...", "*") for reason in metric.no_value]
                assert any(fnmatchcase(score.reason, pattern) for pattern in patterns), (metric.name, score.reason)


def values(error):
    """Every metric one more than the error, or its inverse."""
    return {m.name: 1.0 / (1.0 + error) if m.better == "higher" else 1.0 + error for m in metrics.METRICS}


def answer(job):
    """What a job would give in a world where every metric follows the error."""
    if job.function.__name__ == "planted":
        return {"scores": values(0.0 if job.arguments["plant"] == NO_MISTAKE else 9.0)}
    sizes = job.arguments["sizes"] or [0.0]
    return {"rows": [{"size": size, **values(size), "ate_rmse_m": size} for size in sizes]}


def test_a_page_tells_ranks_and_mistakes_of_any_result():
    from evalkit.commands.metric_validation import page as metrics_page

    asked = trust.Asked(("lab", "room"), 3)
    results = {job.name: answer(job) for job in trust.jobs(asked)}
    made = {"command": "evalkit metrics validate", "made": "2026-01-01", "versions": {"numpy": "2"}}
    content = trust.record(asked, results, made)
    assert [row["overall"]["value"] for row in content["trust"]] == [1.0] * len(reference_free())
    assert [row["plant"] for row in content["planted"]] == list(PLANTS)
    assert all(row["caught"] and row["seen"][0]["factor"] == pytest.approx(10.0) for row in content["planted"])
    page = render(metrics_page.document(content))
    assert page.count('<td class="number good"') >= len(reference_free()) or "1.00" in page
    assert "axes swapped" in page
    lines = trust.as_csv(trust.rows(asked, results)).splitlines()
    assert len(lines) == 1 + 2 * (1 + 3 * 6)
    assert lines[0].startswith("world,way,size,ate_rmse_m,")


def test_sizes_reach_from_the_smallest_to_the_largest():
    assert trust.sizes("jump", 2) == (0.05, 0.8)
    assert trust.sizes("jump", 5) == (0.05, 0.1, 0.2, 0.4, 0.8)


def test_a_clean_run_of_given_poses_has_no_error():
    sequence = map_rebuilding.recording("room", 0)
    run = map_rebuilding.run_of(sequence, map_rebuilding.true_poses(sequence))
    evidence = evaluate.collect_evidence(run, sequence)
    assert metrics.compute_scores(evidence)["ate_rmse_m"].value == pytest.approx(0.0, abs=1e-9)


def test_the_self_test_fails_where_a_mistake_does_not_show(monkeypatch):
    monkeypatch.setattr(commands, "_made", lambda jobs, *_: {job.name: answer(job) for job in jobs})
    assert [row["caught"] for row in json.loads(told("selftest", "--json"))] == [True] * len(PLANTS)
    blind = {"scores": values(0.0)}
    monkeypatch.setattr(commands, "_made", lambda jobs, *_: {job.name: blind for job in jobs})
    result = CliRunner().invoke(app, ["selftest"], catch_exceptions=False)
    assert result.exit_code == 1
    assert "nothing" in result.output


def test_a_quick_validation_writes_table_page_and_values(monkeypatch, tmp_path):
    monkeypatch.setattr(commands, "_made", lambda jobs, *_: {job.name: answer(job) for job in jobs})
    output = told("validate", "--quick", "-o", str(tmp_path))
    assert "split_distance_m" in output
    content = json.loads((tmp_path / "validated.json").read_text(encoding="utf-8"))
    assert (content["worlds"], content["scans"]) == (["lab"], 40)
    assert (tmp_path / "validated.csv").is_file()
    assert (tmp_path / "index.html").is_file()
