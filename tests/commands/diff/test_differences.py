"""What changed between two results folders: worse, better, noise, or not comparable, as their makers know it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from evalkit import cli
from evalkit.commands.diff.differences import Limits, difference
from evalkit.commands.diff.snapshot import Finished, Snapshot, read
from evalkit.commands.diff.text import markdown, rows, verdict
from evalkit.core.errors import StoreError
from evalkit.metrics import all_metrics
from evalkit.report import write
from evalkit.stats.bootstrap import Series

METRICS = {metric.name: metric for metric in all_metrics()}
ATE, TIME = "ate_rmse_m", "cpu_median_ms"


def _snapshot(runs, folder="old", processor="a processor", **more):
    return Snapshot(folder, runs, processor, **more)


def _run(ate=0.02, ms=1.0, status="complete", errors=None, **parameters):
    scores = {ATE: ate, TIME: ms} if status == "complete" else {}
    series = {} if errors is None else {ATE: Series(np.arange(len(errors)) * 10**8, errors, "rms", 0.1)}
    return Finished(status, "" if status == "complete" else "signal 11", parameters, scores, series)


def _seeds(ates, times=None, **parameters):
    times = times or [1.0] * len(ates)
    return {
        ("a", "room", seed): _run(ate, ms, **parameters) for seed, (ate, ms) in enumerate(zip(ates, times, strict=True))
    }


def _between(old, new, **limits):
    return difference(_snapshot(old), _snapshot(new, "new"), tuple(METRICS.values()), Limits(**limits))


def _said(found, metric=ATE):
    return {change.metric: change.said for change in found.changes}[metric]


def test_the_same_numbers_are_no_change():
    found = _between(_seeds([0.02, 0.03]), _seeds([0.02, 0.03]))
    assert [change.said for change in found.changes] == ["unchanged", "unchanged"]
    assert (found.regressions, rows(found, METRICS)) == (0, [])


@pytest.mark.parametrize(
    ("new", "said"),
    [([0.0208, 0.0208, 0.0208], "within the limit"), ([0.03, 0.031, 0.032], "regression"),
     ([0.01, 0.011, 0.012], "improvement"), ([0.01, 0.04, 0.06], "no difference shown")],
)  # fmt: skip
def test_an_error_must_change_by_more_than_the_limit_and_the_noise(new, said):
    found = _between(_seeds([0.02, 0.02, 0.02]), _seeds(new))
    assert (_said(found), found.regressions) == (said, int(said == "regression"))


def test_one_run_is_judged_by_the_same_scans_before_and_after():
    """Both rise by a fifth in root mean square: once on every scan, once by a single stretch at the end."""
    errors = np.full(600, 0.02)
    everywhere, once = 1.2 * errors, errors.copy()
    once[-30:] = np.sqrt(20 * 0.44 * 0.02**2 + 0.02**2)
    kept = {("a", "room", None): _run(0.02, errors=errors)}
    assert _said(_between(kept, {("a", "room", None): _run(0.024, errors=everywhere)})) == "regression"
    assert _said(_between(kept, {("a", "room", None): _run(0.024, errors=once)})) == "no difference shown"


@pytest.mark.parametrize(
    ("times", "said"),
    [([1.05, 1.09], "within the limit"), ([1.2, 1.3], "regression"), ([0.7, 0.8], "improvement"),
     ([0.9, 1.4], "no difference shown"), ([1.15], "within the limit"), ([1.25], "regression")],
)  # fmt: skip
def test_time_must_grow_in_every_run_and_twice_as_much_in_a_single_one(times, said):
    ates = [0.02] * len(times)
    assert _said(_between(_seeds(ates), _seeds(ates, times)), TIME) == said


def test_what_all_methods_lose_together_is_the_machines():
    """All took a third longer, d three times as long: the median of four is the machine's, d alone is a regression."""
    old = {(who, "room", seed): _run(ms=1.0) for who in "abcd" for seed in (0, 1)}
    new = {(who, "room", seed): _run(ms=3.0 if who == "d" else 1.3) for who in "abcd" for seed in (0, 1)}
    found = _between(old, new)
    assert [one.method for one in found.changes if one.said == "regression"] == ["d"]
    assert found.notes[0].startswith("all methods together took +30 % CPU time: taken for the machine's")


def test_times_of_another_processor_are_not_compared():
    found = difference(
        _snapshot(_seeds([0.02])), _snapshot(_seeds([0.02], [9.0]), "new", "another"), tuple(METRICS.values()), Limits()
    )
    assert (_said(found, TIME), found.regressions) == ("not comparable", 0)
    assert found.notes == ("times are not compared: a processor against another",)


def test_a_run_that_no_longer_ends_is_a_regression_and_a_new_method_is_none():
    old = {("a", "room", 0): _run(), ("gone", "room", 0): _run(), ("b", "room", 0): _run(status="crashed")}
    new = {("a", "room", 0): _run(status="crashed"), ("b", "room", 0): _run(), ("come", "room", 0): _run()}
    found = _between(old, new)
    assert [(one.method, one.said) for one in found.ended] == [("a", "regression"), ("b", "improvement")]
    assert (found.only_old, found.only_new, found.regressions) == (("gone over room",), ("come over room",), 1)


def test_other_parameters_make_another_sequence_and_new_ones_at_their_default_do_not():
    with pytest.raises(StoreError, match=r"not comparable with old: the sequence differs: laps 1\.0 against 0\.5"):
        _between(_seeds([0.02], laps=1.0), _seeds([0.02], laps=0.5))
    new = _seeds([0.02], laps=1.0, people=3)
    defaults = {"room": {"people": 0}}
    assert not _between(_seeds([0.02], laps=1.0), new).apart
    with pytest.raises(StoreError, match="people 0 against 3"):
        difference(
            _snapshot(_seeds([0.02], laps=1.0)), _snapshot(new, "new", defaults=defaults), tuple(METRICS.values()),
            Limits(),
        )  # fmt: skip


def test_seeds_without_a_common_one_are_not_comparable():
    with pytest.raises(StoreError, match="seeds 0 against 7"):
        _between({("a", "room", 0): _run()}, {("a", "room", 7): _run()})


def test_markdown_is_a_table_with_the_worst_first():
    found = _between(_seeds([0.02, 0.02], [1.0, 1.0]), _seeds([0.03, 0.03], [0.5, 0.5]))
    lines = markdown(found, METRICS).splitlines()
    assert lines[0] == f"**{verdict(found)}**"
    assert lines[0].startswith("**1 regression beyond 5 % of an error, 10 % of CPU time and the noise; 1 improved")
    assert lines[2].startswith("| method | sequence | what |")
    assert lines[4].startswith(
        "| a | room | ATE RMSE [m] | 0.0200 | 0.0300 | +50.0 % | 0.0100 to 0.0100 | ❌ regression"
    )
    assert "✅ improvement" in lines[5]


# folders


@pytest.fixture
def folder(tmp_path, record, build):
    def made(name, factor=1.0):
        runs = [
            record("a", "room", {ATE: factor * ate, TIME: 1.0}, seed=seed) for seed, ate in enumerate((0.02, 0.021))
        ]
        write(build(runs), tmp_path / name)
        return tmp_path / name

    return made


def test_the_command_ends_with_one_only_on_a_regression(folder):
    runner, old = CliRunner(), folder("old")
    assert runner.invoke(cli.app, ["diff", str(old), str(folder("same"))]).exit_code == 0
    worse = runner.invoke(cli.app, ["diff", str(old), str(folder("worse", 1.5)), "--json"])
    assert (worse.exit_code, json.loads(worse.stdout)["regressions"]) == (1, 1)
    assert runner.invoke(cli.app, ["diff", str(old), str(folder("wide", 1.5)), "--limit-ate", "60%"]).exit_code == 0


@pytest.mark.parametrize("text", ["much", "-5%", "nan", "inf"])
def test_a_limit_that_is_no_share_is_a_usage_error(folder, text):
    old = folder("old")
    assert CliRunner().invoke(cli.app, ["diff", str(old), str(old), "--limit-ate", text]).exit_code == 2


def test_folders_that_cannot_be_read_say_why(folder, tmp_path):
    path = folder("old") / "results.json"
    with pytest.raises(StoreError, match="there is no such folder"):
        read(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(StoreError, match="it holds no run"):
        read(tmp_path / "empty")
    whole = path.read_text(encoding="utf-8")
    path.write_text(whole.replace('"version": 1', '"version": 2'), encoding="utf-8")
    with pytest.raises(StoreError, match="evalkit-results version 2; make the report again"):
        read(path.parent)
    path.write_text(whole[: len(whole) // 2], encoding="utf-8")
    with pytest.raises(StoreError, match="half-written"):
        read(path.parent)
    path.write_text(json.dumps({"schema": {"name": "evalkit-results", "version": 1}}), encoding="utf-8")
    with pytest.raises(StoreError, match="is not whole"):
        read(path.parent)


def test_a_folder_of_runs_without_a_report_is_read_too(tmp_path, record):
    made = record("a", "room", {ATE: 0.02}, seed=3)
    own = tmp_path / "runs" / "room-s3-a-0123456789"
    own.mkdir(parents=True)
    (own / "request.json").write_text(json.dumps({"dataset_parameters": {"laps": 1.0, "seed": 3}}), encoding="utf-8")
    (own / "result.json").write_text(
        json.dumps({"method": "a", "sequence": "room", "status": "complete", "reason": ""}), encoding="utf-8"
    )
    (own / "scores.json").write_text(
        json.dumps({"scores": {ATE: {"value": 0.02, "support": 60, "reason": ""}}}), encoding="utf-8"
    )
    (own / "steps.bin").write_bytes(made.result.steps.tobytes())
    np.save(own / "errors.npy", made.scores.errors_m)
    (tmp_path / "runs" / "room-s4-a-0123456789").mkdir()
    found = read(tmp_path)
    run = found.runs[("a", "room", 3)]
    assert (run.status, run.parameters, run.scores, found.unfinished) == ("complete", {"laps": 1.0}, {ATE: 0.02}, 1)
    assert len(run.series[ATE].values) == 60
    assert replace(run, series={}).series == {}
