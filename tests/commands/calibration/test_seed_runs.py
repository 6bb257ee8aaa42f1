"""Runs of one seed: every method is scored, and its series yields the score."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from evalkit.commands.calibration import command, coverage
from evalkit.commands.calibration.command import measure, measure_sequence
from evalkit.commands.calibration.seed_runs import DRIFTS, read_runs, run_seed
from evalkit.config.experiment_file import experiment_from_tables
from evalkit.core.errors import BadExperiment


def _experiment(**sequence):
    content = {"method": [{"use": "wheel-odometry", "label": "wheels"}], "sequence": [sequence]}
    return experiment_from_tables(content, "exp.toml", "exp", "compare exp.toml")


def test_a_seed_is_run_by_every_method_and_the_series_yield_the_scores():
    plan = _experiment(use="room", laps=0.1, rate_hz=5.0)
    (method,), (sequence,) = plan.methods, plan.sequences
    parameters = sequence.parameters_with_seed(3)
    found = run_seed(sequence.dataset, parameters, 3, [(method.label, method.backend, dict(method.parameters))])
    for label in ("wheels", *DRIFTS):
        errors = found[f"{label}|ate_rmse_m|values"]
        assert np.sqrt(np.mean(errors**2)) == pytest.approx(found[f"{label}|ate_rmse_m|score"], rel=0.02)
    scores = [found[f"{label}|ate_rmse_m|score"] for label in DRIFTS]
    assert scores[0] != scores[1]
    runs = read_runs("room", "wheels", "ate_rmse_m", [found, {}])
    assert runs.values == (found["wheels|ate_rmse_m|score"],)
    assert runs.draws[0].values.mean() == pytest.approx(runs.values[0], rel=0.3)


def _recording(tmp_path, **keys):
    path = tmp_path / "a.log"
    path.write_text("FLASER\n")
    return _experiment(use="carmen", path=str(path), **keys)


def test_a_recording_needs_perturbations_to_calibrate_with(tmp_path):
    expected = r"carmen: is a recording with too few runs \(1\); write nuisance = 20 or more"
    with pytest.raises(BadExperiment, match=expected):
        measure(_recording(tmp_path), 20, 50, tmp_path, 1)


def test_a_recording_that_is_not_on_this_machine_is_skipped(tmp_path):
    plan = _recording(tmp_path, nuisance=24)
    absent = replace(plan, sequences=(replace(plan.sequences[0], missing="not here"),))
    with pytest.raises(BadExperiment, match="no runs to resample: carmen: not here"):
        measure(absent, 20, 50, tmp_path, 1)


def _results(labels, metric, count):
    """Runs with values 1.00, 1.01, ... of every method, and without a series."""
    return [{f"{label}|{metric}|score": 1.0 + 0.01 * run for label in labels} for run in range(count)]


def test_perturbed_runs_are_resampled_without_walks_and_a_method_that_failed_is_named(tmp_path):
    (sequence,) = _recording(tmp_path, nuisance=24).sequences
    results = _results("ab", "ate_rmse_m", 25)
    results[7]["c|failed"] = "c: no odometry"
    results[8].pop("b|ate_rmse_m|score")
    found = measure_sequence(0, sequence, results, ["a", "b", "c"], 50)
    assert found.skipped == ("carmen: c failed in 1 of 25 runs (c: no odometry)",)
    assert [(one.method, one.runs) for one in found.coverage] == [(m, n) for n in (1, 2, 3, 5, 8) for m in "ab"]
    assert {one.population for one in found.coverage} == {24}  # the run without a value of b is left out of both
    assert {one.methods for one in found.verdicts} == {("a", "b")}
    assert {one.false_over for one in found.verdicts} == {0.0}  # both have the same value in every run


def test_relations_have_intervals_and_no_verdict_and_few_values_are_named(tmp_path):
    (sequence,) = _recording(tmp_path, nuisance=24).sequences
    found = measure_sequence(0, sequence, _results("ab", "relations_all_mean_m", 25), ["a", "b"], 50)
    assert (len(found.coverage), found.verdicts, found.skipped) == (10, (), ())
    few = measure_sequence(0, sequence, [*_results("ab", "ate_rmse_m", 19), *[{}] * 6], ["a", "b"], 50)
    assert few.coverage == ()
    assert few.skipped[0] == "carmen: ate_rmse_m: 19 runs have a value, 20 are needed"


def test_the_command_writes_what_it_measured_and_fails_beyond_a_limit(tmp_path, monkeypatch, capsys):
    file = tmp_path / "own.toml"
    log = tmp_path / "a.log"
    log.write_text("FLASER\n")
    file.write_text(
        "[[method]]\nuse = 'wheel-odometry'\nlabel = 'a'\n[[method]]\nuse = 'paper'\nlabel = 'b'\n"
        f"[[sequence]]\nuse = 'carmen'\npath = '{log}'\nnuisance = 24\n"
    )
    results = [{**one, "b|failed": "b: no odometry"} if at == 3 else one
               for at, one in enumerate(_results("ab", "ate_rmse_m", 25))]  # fmt: skip
    monkeypatch.setattr(command, "_run_all", lambda *_: {"carmen": results})
    app = typer.Typer()
    app.command()(command.calibrate)
    words = [str(file), "--subsets", "50", "--out", str(tmp_path / "out")]
    found = CliRunner().invoke(app, words)
    content = json.loads((tmp_path / "out" / "calibration.json").read_text(encoding="utf-8"))
    assert content["skipped"] == ["carmen: b failed in 1 of 25 runs (b: no odometry)"]
    assert (content["recordings"], len(content["coverage"]), content["verdicts"]) == (["carmen"], 5, [])
    assert sorted(one.name for one in (tmp_path / "out").iterdir()) == [
        "calibration.json", "calibration.md", "index.html"
    ]  # fmt: skip
    assert found.exit_code == int(bool(content["failures"]))
    assert "evalkit: skipped: carmen: b failed in 1 of 25 runs" in found.output
    monkeypatch.setattr(coverage, "find_failures", lambda *_: ["an interval holds in 50 %"])
    found = CliRunner().invoke(app, [*words, "--json"])
    assert found.exit_code == 1
    assert "evalkit: outside the limits: an interval holds in 50 %" in found.output


def test_a_world_is_calibrated_with_as_many_seeds_as_asked_for(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(command, "_run_all", lambda _e, sequences, seeds, *_: asked.append(seeds) or {
        one.label: _results("ab", "ate_rmse_m", seeds) for one in sequences
    })  # fmt: skip
    with pytest.raises(BadExperiment, match=r"no runs to resample: .*wheels failed|no runs to resample"):
        measure(_experiment(use="room", laps=0.1), 21, 50, tmp_path, 1)
    assert asked == [21]
