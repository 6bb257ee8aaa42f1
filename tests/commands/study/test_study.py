"""The study command: its page, its JSON output, points that can be repeated, and a killed run."""

import csv
import importlib
import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from evalkit.cli import app
from evalkit.commands.study.config import study_from_tables
from evalkit.commands.study.effect_tables import build_effect_blocks
from evalkit.commands.study.page import build_document
from evalkit.commands.study.plan import format_task_name
from evalkit.commands.study.result import StudyResult
from evalkit.commands.study.results_json import make_effect_rows, study_as_json
from evalkit.design.run_points import evaluate, run_points
from evalkit.execution.task import make_task
from evalkit.plugins import registry
from evalkit.plugins.parameters import resolve_parameters
from evalkit.report.html.blocks import Text, render

STUDY = """
title = "A small study"
seeds = [0, 1]
method.use = "wheel-odometry"
sequence = { use = "lab", laps = 0.05, speed_mps = 0.5 }
mapper.scans = 5
response = [{ metric = "ate_rmse_m", scale = "log", lost = 0.5 }, { metric = "map_f1", lost = 0.0 }]
envelope = [{ design = "driven", x = "speed", y = "rate", metric = "ate_rmse_m", limit = 0.05 }]

[[factor]]
name = "speed"
sets = "sequence.speed_mps"
levels = [0.5, 1.0]
unit = "m/s"

[[factor]]
name = "rate"
sets = "sequence.rate_hz"
levels = [10.0, 15.0]
unit = "Hz"

[[factor]]
name = "wheels"
sets = "sequence.odometry_scale"
levels = [0.01, 0.1]

[[design]]
name = "driven"
kind = "grid"
factors = ["speed", "rate"]

[[design]]
name = "array"
kind = "fractional"
factors = ["speed", "rate", "wheels"]
resolution = 4
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(STUDY)
    return path


def run(*words):
    return CliRunner().invoke(app, ["study", *map(str, words)])


def test_a_study_writes_page_and_numbers_and_every_point_can_be_repeated(file, tmp_path):
    done = run(file, "--out", tmp_path / "out", "--jobs", "1")
    assert done.exit_code == 0, done.output
    page = (tmp_path / "out" / "index.html").read_text()
    assert "A small study" in page
    assert "ATE RMSE depends most on wheels: 0.01 → 0.1" in page
    assert "Operating envelope" in page
    rows = list(csv.DictReader((tmp_path / "out" / "points.csv").open()))
    whole = json.loads((tmp_path / "out" / "study.json").read_text())
    assert len(rows) == len(whole["runs"]) == 2 * (4 + 8)
    effects = list(csv.DictReader((tmp_path / "out" / "effects.csv").open()))
    assert {row["factor"] for row in effects} == {"speed", "rate", "wheels"}
    assert "estimates effects" not in page

    again = run(file, "--point", rows[0]["key"], "--json")
    assert again.exit_code == 0, again.output
    computed = json.loads(again.output)[f"{rows[0]['key']} seed 0"]["scores"]
    assert repr(computed["ate_rmse_m"]) == rows[0]["ate_rmse_m"]
    assert repr(computed["map_f1"]) == rows[0]["map_f1"]

    told = run(file, "--point", rows[0]["key"]).output
    experiment = tmp_path / "one.toml"
    experiment.write_text(told[told.index("title = ") :])
    report = CliRunner().invoke(
        app, ["compare", "--no-page", str(experiment), "--out", str(tmp_path / "one"), "--json"]
    )
    assert report.exit_code == 0, report.output
    scores = json.loads(report.output[report.output.index("{\n") :])["runs"][0]["scores"]
    assert scores["ate_rmse_m"] == computed["ate_rmse_m"]
    assert scores["map_f1"] == computed["map_f1"]


def test_a_study_whose_designs_estimate_no_effects_says_so(tmp_path):
    (tmp_path / "grid.toml").write_text(STUDY[: STUDY.index('[[design]]\nname = "array"')].replace("[0, 1]", "[0]"))
    done = run(tmp_path / "grid.toml", "--out", tmp_path / "out", "--jobs", "1")
    assert done.exit_code == 0, done.output
    assert (
        "No design here estimates effects: that takes kind optimal or fractional."
        in (tmp_path / "out" / "index.html").read_text()
    )
    effects = (tmp_path / "out" / "effects.csv").read_text()
    assert effects == "design,metric,scale,kind,factor,level,value,low,high,support,confidence,share\n"


def test_an_unknown_point_is_rejected_and_the_known_ones_are_listed(file):
    refused = run(file, "--point", "00000000")
    assert refused.exit_code != 0
    assert "no point named '00000000'" in str(refused.exception)


def test_a_back_end_that_fails_is_a_result_with_its_reason(strangers):
    made = study_from_tables(tomllib.loads(STUDY), "s.toml", "")
    found = evaluate(**{**made.tasks()[0].arguments, "backend": "faulty", "parameters": {"fault": "raise", "at": 3}})
    assert found["status"] == "failed"
    assert found["reason"].startswith("RuntimeError: lost the plot")
    assert found["answered"] == 3
    outcome = StudyResult(made, {job.name: found for job in made.tasks()})
    design, response = made.designs[0], made.responses[0]
    assert outcome.counts(design) == (8, 8)
    assert (outcome.table(design, response) == 0.5).all()


def test_a_design_without_effects_is_named_with_the_reason(strangers):
    # the response has no bound: a failed run has no value; 4 of 8 points are left for 4 columns
    content = STUDY.replace('{ metric = "map_f1", lost = 0.0 }', '{ metric = "map_f1" }')
    made = study_from_tables(tomllib.loads(content), "s.toml", "")
    array, map_f1 = made.designs[1], made.responses[1]
    failed = {format_task_name(point.key, seed) for point in array.points[:4] for seed in array.runs(point)}
    scores = {"ate_rmse_m": 0.1, "map_f1": 0.9}
    complete = {"status": "complete", "reason": "", "scores": scores, "cpu_s": 1.0}
    none = {"status": "failed", "reason": "lost", "scores": dict.fromkeys(scores), "cpu_s": 1.0}
    tasks = made.tasks()
    outcome = StudyResult(made, {task.name: none if task.name in failed else complete for task in tasks})
    assert [design.name for design, _ in outcome.fits(made.responses[0])] == ["array"]
    assert outcome.fits(map_f1) == []
    reason = "4 of 8 points have a value, and 4 points are too few for the 4 columns of the model"
    assert study_as_json(outcome)["missing_effects"] == [{"design": "array", "metric": "map_f1", "reason": reason}]
    assert {row["metric"] for row in make_effect_rows(outcome)} == {"ate_rmse_m"}
    texts = [block.body for block in build_effect_blocks(outcome) if isinstance(block, Text)]
    assert f"array: the effects on {map_f1.metric.label} cannot be computed: {reason}." in texts


def test_a_page_with_failed_runs_has_no_nan_and_says_how_they_count():
    content = STUDY.replace('scale = "log", lost = 0.5 }', 'scale = "log" }')
    content += """
[[design]]
name = "between"
kind = "sobol"
factors = ["speed", "rate", "wheels"]
points = 4
"""
    made = study_from_tables(tomllib.loads(content), "s.toml", "evalkit study s.toml")
    ate = made.responses[0]
    scores = [{"ate_rmse_m": 0.1 * 4.0**seed, "map_f1": 0.9} for seed in (0, 1)]
    complete = [{"status": "complete", "reason": "", "scores": each, "why": {}, "cpu_s": 1.0} for each in scores]
    failed = {"status": "failed", "reason": "broke", "scores": dict.fromkeys(scores[0]), "why": {}, "cpu_s": 1.0}
    between = {format_task_name(point.key, seed) for point in made.designs[2].points for seed in (0, 1)}
    results = {task.name: complete[int(task.name[-1])] for task in made.tasks() if task.name not in between}
    page = render(build_document(StudyResult(made, results | dict.fromkeys(between, failed)), {}))
    assert ">nan<" not in page
    assert "0.200 (0.100 to 0.400)" in page  # the geometric mean of 0.1 and 0.4, as in the effects
    assert page.count(">no value<") == 4
    assert "A run is lost if it fails or ends with map F1 at 10 cm of 0 or less. " in page
    assert f"Effects on {ate.metric.label}, without a bound, leave out the runs that have no value." in page


def test_a_point_of_a_slam_scores_its_corrected_poses_and_a_wrong_end_is_a_failure(strangers):
    mapper = resolve_parameters("log-odds", registry.mapper("log-odds").parameters, {})
    drive = {"scans": 12, "backwards": 0, "file": "", "breaks": False, "reads_until": ""}
    point = {"backend": "faulty-slam", "dataset": "straight", "sequence": drive, "mapper": "log-odds", "code": "",
             "mapper_parameters": mapper, "scans": 3,
             "metrics": ("ate_rmse_m", "final_ate_rmse_m", "final_pair_error", "closures_accepted")}  # fmt: skip
    found = evaluate(**point, parameters={"fault": "none"})
    assert found["status"] == "complete", found["reason"]
    assert found["scores"]["ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    assert 0.001 < found["scores"]["final_ate_rmse_m"] < 0.01
    assert found["scores"]["final_pair_error"] > 0.0
    assert found["scores"]["closures_accepted"] == 1.0
    found = evaluate(**point, parameters={"fault": "raise"})
    assert (found["status"], found["reason"]) == ("failed", "RuntimeError: the graph is torn (_fail)")


@pytest.mark.slow
@pytest.mark.thorough
def test_a_killed_study_resumes_without_repeating_finished_points(file, tmp_path, wait_for):
    kept = tmp_path / "out" / "results"
    command = [
        sys.executable,
        "-c",
        "from evalkit.cli import main; main()",
        "study",
        str(file),
        "--out",
        str(tmp_path / "out"),
        "--jobs",
        "1",
    ]
    first = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    assert wait_for(lambda: len(list(kept.glob("*.npz"))) >= 3 or first.poll() is not None)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    before = {path: path.stat().st_mtime_ns for path in kept.glob("*.npz")}
    assert len(before) >= 3
    assert not (tmp_path / "out" / "index.html").exists()
    subprocess.run(command, check=True, capture_output=True)
    after = {path: path.stat().st_mtime_ns for path in kept.glob("*.npz")}
    assert {path: after[path] for path in before} == before
    assert len(after) == 16  # the four points of the grid are also in the orthogonal array
    assert (tmp_path / "out" / "index.html").exists()


def hang(metrics):
    time.sleep(600)


def test_a_run_that_hangs_is_a_lost_run_with_its_reason(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    job = make_task("p seed 0", importlib.import_module("test_study").hang, metrics=["ate_rmse_m"]).with_limit(1.0)
    (result,) = run_points([job], tmp_path, 1, lambda _name, _seconds: None).values()
    assert (result["status"], result["scores"]) == ("timeout", {"ate_rmse_m": None})
    assert result["reason"].startswith("not finished after 1 s; it was in ")
