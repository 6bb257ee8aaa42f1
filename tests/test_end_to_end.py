"""End to end: an experiment file gives a report with plausible numbers, and the same numbers when repeated."""

import csv
import json
import math
import re
import signal

import numpy as np
import pytest

from evalkit import cli
from evalkit.io import map_server
from evalkit.io.tum import read_tum
from evalkit.plugins import registry
from evalkit.results.store import Store

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("scoring_in_threads")]

LAPS = 0.12  # 2.8 m and a turn: enough for errors of the wheel odometry
METHODS = ("wheel-odometry", "paper", "open3d-icp", "kiss-icp")
HERE = [name for name in METHODS if not registry.backend(name).missing()]


def experiment(path, methods, laps):
    rows = "".join(f'[[method]]\nuse = "{name}"\n' for name in methods)
    wheels = "odometry_scale = 0.1\ngyro_bias_dps = 2.0\n"
    sequence = f'[[sequence]]\nuse = "room"\nlaps = {laps}\nspeed_mps = 0.5\n{wheels}seeds = [1]\n'
    path.write_text(f'title = "A small one"\n{rows}[mapper]\nscans = 40\n{sequence}')
    return path


def evalkit(*words):
    """Run an evalkit command in this process; returns the exit code."""
    handler = signal.getsignal(signal.SIGTERM)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["evalkit", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
    signal.signal(signal.SIGTERM, handler)
    return ended.value.code


@pytest.fixture(scope="module")
def folder(tmp_path_factory, scoring_in_threads):
    """The folder of a finished report."""
    root = tmp_path_factory.mktemp("report")
    assert evalkit("compare", experiment(root / "small.toml", METHODS, LAPS), "--out", root / "out") == 0
    return root / "out"


@pytest.fixture(scope="module")
def results(folder):
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


@pytest.fixture
def trials(results):
    return {trial["method"]: trial for trial in results["runs"]}


def test_every_method_is_on_the_page_and_complete_or_has_a_reason(folder, trials):
    page = (folder / "index.html").read_text(encoding="utf-8")
    assert "A small one" in page
    assert list(trials) == list(METHODS)
    for name, trial in trials.items():
        assert name in page
        assert trial["status"] == ("complete" if name in HERE else "not-installed")
        assert bool(trial["reason"]) == (name not in HERE)


def test_the_page_is_self_contained(folder):
    page = (folder / "index.html").read_text(encoding="utf-8")
    assert not any(f'{word}="http' in page for word in ("src", "srcset", "xlink:href"))
    assert all(link.startswith("#") for link in re.findall(r'<link [^>]*href="([^"]*)"', page))
    assert page.count("<link ") == page.count('<link rel="expect" href="#')


def test_the_results_match_their_schema(folder, results):
    schema = json.loads((folder / "results.schema.json").read_text(encoding="utf-8"))
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.Draft202012Validator(schema).validate(results)


def test_every_number_is_finite_and_every_missing_one_has_a_reason(trials):
    for name in HERE:
        scores = trials[name]["scores"]
        assert scores
        for metric, score in scores.items():
            if score["value"] is None:
                assert score["reason"], metric
                assert "could not be computed" not in score["reason"], metric
            else:
                assert math.isfinite(score["value"]), metric


def test_scan_matching_is_better_than_wrong_wheel_odometry(trials):
    wheels = trials["wheel-odometry"]["scores"]["ate_rmse_m"]["value"]
    assert wheels > 0.03
    for name in set(HERE) - {"wheel-odometry"}:
        assert trials[name]["scores"]["ate_rmse_m"]["value"] < min(0.04, 0.7 * wheels), name


def test_the_csv_tables_have_a_row_for_every_run(folder, trials):
    for name in ("runs.csv", "scores.csv", "summary.csv"):
        with (folder / name).open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        assert {row["method"] for row in rows} >= set(HERE), name
    assert {row["method"] for row in csv.DictReader((folder / "runs.csv").open(encoding="utf-8"))} == set(trials)


@pytest.mark.parametrize("name", HERE)
def test_the_exported_trajectory_equals_that_of_the_run(folder, trials, name):
    key = trials[name]["key"]
    run = Store(folder).load_result(key)
    read = read_tum(folder / "trajectories" / f"{key}.tum").trajectory
    assert np.array_equal(read.stamps_ns, run.steps["stamp_ns"])
    assert np.allclose(read.poses, run.estimate.poses, atol=1e-8)
    assert len(read) == trials[name]["scans_answered"] == trials[name]["scans_expected"]


def test_the_exported_map_has_the_walls_of_the_run(folder, trials):
    key = trials["paper"]["key"]
    grid = Store(folder).load_scores(key).grid
    read = map_server.read_map(folder / "maps" / f"{key}.yaml")
    assert read.shape == grid.shape
    assert (read.resolution_m, read.origin_x, read.origin_y) == (grid.resolution_m, grid.origin_x, grid.origin_y)
    assert np.array_equal(read.occupied(), grid.occupied())


def test_resuming_a_finished_report_executes_nothing_and_gives_the_same_results(folder, results):
    before = {path: path.stat().st_mtime_ns for path in folder.glob("runs/*/*")}
    file = folder.parent / "small.toml"
    assert evalkit("compare", file, "--out", folder, "--resume") == 0
    assert {path: path.stat().st_mtime_ns for path in folder.glob("runs/*/*")} == before
    again = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert again["runs"] == results["runs"]


@pytest.mark.thorough
def test_the_same_inputs_give_the_same_numbers(folder, results, tmp_path):
    """All values except times and memory are identical, with one worker and with two."""
    again_too = ("paper", "wheel-odometry")
    chosen = [word for name in again_too for word in ("--method", name)]
    assert (
        evalkit("compare", "--no-page", folder.parent / "small.toml", "--out", tmp_path / "out", "-j", "1", *chosen)
        == 0
    )
    timed = {metric["name"] for metric in results["metrics"] if metric["group"] == "runtime"}
    for trial in (trial for trial in results["runs"] if trial["method"] in again_too):
        again = Store(tmp_path / "out").load_scores(trial["key"])
        ours = {name: score["value"] for name, score in trial["scores"].items() if name not in timed}
        values = {name: score.value for name, score in again.by_metric.items() if name not in timed}
        assert {name: value for name, value in values.items() if name in ours or value is not None} == ours
    assert timed
