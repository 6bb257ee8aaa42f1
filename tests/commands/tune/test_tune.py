"""The tune command: its page, its numbers, an experiment with default and tuned rows, and a resumed search."""

import json
import tomllib
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from evalkit.cli import app
from evalkit.commands.tune import search_loop
from evalkit.commands.tune.config import load_tuning
from evalkit.commands.tune.results_json import SCHEMA_VERSION
from evalkit.core.errors import BadParameter

FILE = """
title = "A stranger tuned"
points = 4

[mapper]
scans = 5

[[method]]
use = "evalkit_tunable:MISSET"
label = "misset"

[[method]]
use = "evalkit_tunable:PERFECT"
label = "perfect"

[[method]]
use = "evalkit_tunable:HOPELESS"
label = "hopeless"

[[training]]
use = "lab"
laps = 0.04
seeds = [0]
confirm = [2, 3, 4, 5]

[[held-out]]
use = "room"
laps = 0.04
seeds = [0]
"""


@pytest.fixture
def file(tmp_path, strangers):
    path = tmp_path / "own.toml"
    path.write_text(FILE)
    return path


def tune(*words):
    return CliRunner().invoke(app, ["tune", *map(str, words)])


@pytest.mark.thorough
@pytest.mark.slow
def test_a_bad_default_is_tuned_a_perfect_one_is_kept_and_a_failing_back_end_gives_exit_code_1(file, tmp_path):
    out = tmp_path / "out"
    done = tune(file, "--out", out, "--jobs", "2")
    assert done.exit_code == 1, done.output
    assert "no run completed: hopeless" in done.output
    told = json.loads((out / "tuned.json").read_text())
    misset, perfect, hopeless = told["backends"]
    assert told["schema_version"] == SCHEMA_VERSION
    assert [misset["tuned"], perfect["tuned"]] == [True, False]
    assert abs(misset["parameters"]["gain"] - 1.0) < abs(4.0 - 1.0)
    assert misset["confirmed"]["ratio"]["high"] < 1.0
    assert [each["spent"]["points"] for each in told["backends"]] == [4, 4, 4]
    assert [each["error"] for each in hopeless["points"]] == [1.0] * 4
    assert not misset["held_out"]["overfitted"]
    assert perfect["held_out"] is None
    rows = tomllib.loads((out / "tuned.toml").read_text())["method"]
    assert [row["label"] for row in rows] == ["misset", "misset tuned", "perfect", "hopeless"]
    page = (out / "index.html").read_text()
    assert "default kept: no point was better in the search" in page
    assert "failed: no run of any point was completed" in page
    assert "RuntimeError: hopeless" in page
    again = CliRunner().invoke(app, ["compare", str(out / "tuned.toml"), "--collect", "--out", str(out / "report")])
    assert "3 runs complete, 1 failed" in again.output  # the held-out runs are those of the report


@pytest.mark.slow
def test_a_killed_search_resumes_without_repeating_points(file, tmp_path):
    made = []
    tuning = replace(load_tuning(file, "own", "evalkit tune own.toml"), points=2)

    class Killed(Exception):
        pass

    def killed_after(runs):
        def done(_name, seconds):
            made.append(seconds > 0.0)
            if sum(made) == runs:
                raise Killed

        return done

    folder = tmp_path / "results"
    with pytest.raises(Killed):
        search_loop.run_search(tuning, search_loop.compute_missing(folder, 1, killed_after(3)))
    with pytest.raises(search_loop.ResultsMissing):
        search_loop.run_search(tuning, search_loop.load_stored(folder))
    made.clear()
    found = search_loop.run_search(
        tuning, search_loop.compute_missing(folder, 1, lambda _name, seconds: made.append(seconds > 0.0))
    )
    runs = sum(len(each.errors) for one in found for each in (*one.tried, *(one.confirmed or ())))
    assert sum(made) == runs - 3
    made.clear()
    search_loop.run_search(
        tuning, search_loop.compute_missing(folder, 1, lambda _name, seconds: made.append(seconds > 0.0))
    )
    assert not any(made)
    assert len(list(folder.glob("*.npz"))) == runs


def test_missing_runs_give_exit_code_3_with_collect(file, tmp_path):
    done = tune(file, "--out", tmp_path / "out", "--collect")
    assert done.exit_code == 3
    assert "the search is not finished: 6 runs" in done.output


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["paper"], "--on DATASET"),
        (["x.toml", "--budget", "9"], "stands alone"),
    ],
)
def test_wrong_arguments_are_a_usage_error(words, told):
    done = tune(*words)
    assert done.exit_code == 2
    assert told in " ".join(done.output.replace("│", " ").split())


def test_a_setting_without_a_value_is_refused():
    error = tune("paper", "--on", "lab", "--set", "laps").exception
    assert isinstance(error, BadParameter)
    assert str(error) == "--set: parameter 'laps': found 'laps', expected NAME=VALUE"
