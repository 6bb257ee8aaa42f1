"""Comparison of two results folders: worse, better, noise or not comparable, with known results."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from evalkit import cli
from evalkit.commands.diff import command
from evalkit.commands.diff.changes import format_markdown
from evalkit.commands.diff.metric_changes import DiffLimits
from evalkit.commands.diff.results_changes import compare_results
from evalkit.commands.diff.results_text import describe_results_diff
from evalkit.core.errors import StoreError
from evalkit.core.run_result import LostTrack, RunConditions
from evalkit.metrics import all_metrics
from evalkit.report import write_report
from evalkit.results.reader import StoredResults, StoredRun, load_stored_results
from evalkit.results.seal import seal
from evalkit.terminal.console import WordConsole

METRICS = {metric.name: metric for metric in all_metrics()}
ATE, TIME = "ate_rmse_m", "cpu_median_ms"


def _snapshot(runs, folder="old", processor="a processor", **more):
    return StoredResults(folder, runs, processor, **more)


def _run(ate=0.02, ms=1.0, status="complete", errors=None, key="", conditions=None, **parameters):
    scores = {ATE: ate, TIME: ms} if status == "complete" else {}
    kept = () if errors is None else (np.arange(len(errors)) * 10**8, errors)
    reason = "" if status == "complete" else "signal 11"
    run = StoredRun(status, reason, parameters, scores, *kept)
    return replace(run, key=key, conditions=conditions or RunConditions())


def _seeds(ates, times=None, **parameters):
    times = times or [1.0] * len(ates)
    return {
        ("a", "room", seed): _run(ate, ms, **parameters) for seed, (ate, ms) in enumerate(zip(ates, times, strict=True))
    }


def _between(old, new, **limits):
    return compare_results(_snapshot(old), _snapshot(new, "new"), tuple(METRICS.values()), DiffLimits(**limits))


def _verdict(found, metric=ATE):
    return {change.metric: change.verdict for change in found.changes}[metric]


def _reason(found, metric=ATE):
    return {change.metric: change.reason for change in found.changes}[metric]


def test_equal_numbers_are_no_change():
    found = _between(_seeds([0.02, 0.03]), _seeds([0.02, 0.03]))
    assert [change.verdict for change in found.changes] == ["unchanged", "unchanged"]
    assert (found.regressions, describe_results_diff(found, METRICS).rows) == (0, ())


@pytest.mark.parametrize(
    ("new", "said"),
    [([0.0208, 0.0208, 0.0208], "within the limit"), ([0.03, 0.031, 0.032], "regression"),
     ([0.01, 0.011, 0.012], "improvement"), ([0.01, 0.04, 0.06], "no difference shown")],
)  # fmt: skip
def test_an_error_must_change_by_more_than_the_limit_and_the_noise(new, said):
    found = _between(_seeds([0.02, 0.02, 0.02]), _seeds(new))
    assert (_verdict(found), found.regressions) == (said, int(said == "regression"))
    assert (_reason(found) == "at most 5 %") is (said == "within the limit")


@pytest.mark.parametrize(("runs", "percent"), [(3, 99), (6, 97)])
def test_the_confidence_of_an_interval_is_stated(runs, percent):
    found = _between(_seeds([0.02] * runs), _seeds([0.01, 0.04, 0.06, 0.07, 0.02, 0.01][:runs]))
    (change,) = (one for one in found.changes if one.metric == ATE)
    assert (change.verdict, change.confidence) == ("no difference shown", percent / 100)
    assert change.reason == f"the {percent} % interval of the difference contains zero"
    text = describe_results_diff(found, METRICS)
    assert (text.columns[6], text.rows[0][6][:6]) == ("interval", f"{percent} %: ")


def test_a_median_that_rises_while_almost_every_run_falls_is_no_regression():
    old, new = [0.010, 0.011, 0.012, 0.013, 0.10, 0.10, 0.10], [0.005, 0.0055, 0.006, 0.016, 0.05, 0.05, 0.05]
    found = _between(_seeds(old), _seeds(new))  # medians 13 and 16 mm; the interval of the pairs is below zero
    (change,) = (one for one in found.changes if one.metric == ATE)
    assert change.high < 0.0 < change.new - change.old
    assert (change.verdict, change.reason[:11]) == ("no difference shown", "the medians")


@pytest.mark.parametrize(("runs", "said"), [(5, "no difference shown"), (6, "regression")])
def test_perturbed_runs_give_a_verdict_from_six_on(runs, said):
    """A perturbation hardly changes a run: five differences of one sign are no evidence, and no verdict in a report."""
    old, new = (
        {name: replace(run, perturbed=True) for name, run in _seeds([ate] * runs).items()} for ate in (0.02, 0.03)
    )
    found = _between(old, new)
    (change,) = (one for one in found.changes if one.metric == ATE)
    assert (change.verdict, found.regressions) == (said, int(said == "regression"))
    assert ("5 perturbed runs, 6 give a verdict" in change.reason) == (runs == 5)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [([], [2, 4], "regression"), ([2], [], "improvement"), ([2], [2], "unchanged"),
     ([2], [2, 4], "no difference shown"), ([0], [1, 2], "no difference shown"),
     ([0], [0, 1, 2, 3, 4, 5], "regression"),
     ([0, 1, 2, 3, 4, 5], [0], "improvement"), ([0, 1, 2, 3], [0, 4, 5], "no difference shown")],
)  # fmt: skip
def test_a_method_that_newly_loses_the_track_is_a_regression(before, after, said):
    """The first loss counts. Of further ones, five in one direction are no chance: 1/32 is below 5 %."""
    old, new = (
        {
            name: replace(run, lost=LostTrack(12.0 + name[2], "1.5 m away") if name[2] in lost else None)
            for name, run in _seeds([0.02] * 6).items()
        }
        for lost in (before, after)
    )
    found = _between(old, new)
    (track,) = found.tracks
    assert (track.verdict, found.regressions) == (said, int(said == "regression"))
    text = describe_results_diff(found, METRICS)
    assert len(text.rows) == (said != "unchanged")
    if (before, after) == ([], [2, 4]):
        assert text.rows[0][2:5] == ("track", "held", "lost in 2 of 6")
        assert text.rows[0][-1] == "❌ regression: newly lost: seed 2 at 14 s, seed 4 at 16 s"
        assert json.loads(json.dumps(text.content))["tracks"][0]["new"][1]["lost"]["at_s"] == 16.0


def test_runs_of_a_recording_are_named_as_perturbations():
    """The run without perturbation is "run"; the second one crashes, the first one is lost, the third is missing."""
    old = {("a", "cave", number): replace(_run(), perturbed=number is not None) for number in (None, 1, 2, 3)}
    new = {name: run for name, run in old.items() if name[2] != 3}
    new["a", "cave", 1] = replace(old["a", "cave", 1], lost=LostTrack(9.0, "1.5 m away"))
    new["a", "cave", 2] = replace(old["a", "cave", 2], status="crashed")
    found = _between(old, new)
    assert found.only_old == ("a over cave (perturbation 3)",)
    rows = describe_results_diff(found, METRICS).rows
    assert [row[2] for row in rows] == ["run perturbation 2", "track"]
    assert rows[1][-1] == "❌ regression: newly lost: perturbation 1 at 9 s"
    with pytest.raises(StoreError, match="perturbations 1 against 2"):
        _between({("a", "cave", 1): old["a", "cave", 1]}, {("a", "cave", 2): old["a", "cave", 2]})


def test_a_track_that_is_held_is_no_change():
    assert _between(_seeds([0.02] * 6), _seeds([0.02] * 6)).tracks == ()


@pytest.mark.parametrize(("after", "said"), [(1.1, "within the limit"), (1.3, "regression")])
def test_wrong_positions_in_a_known_map_must_change_by_a_percentage_point(after, said):
    """From 0.2 %: the probabilities are not measured better."""
    wrong = "map_wrong_percent"

    def runs(percent):
        own = _seeds([0.02] * 3).items()
        return {name: replace(run, scores={**run.scores, wrong: percent}) for name, run in own}

    found = _between(runs(0.2), runs(after))
    assert _verdict(found, wrong) == said
    assert (_reason(found, wrong) == "at most 1 percentage point") is (said == "within the limit")


def test_a_single_run_is_compared_scan_by_scan():
    """Both errors increase by a fifth in root mean square: one on every scan, one in a single block at the end."""
    errors = np.full(600, 0.02)
    everywhere, once = 1.2 * errors, errors.copy()
    once[-30:] = np.sqrt(20 * 0.44 * 0.02**2 + 0.02**2)
    kept = {("a", "room", None): _run(0.02, errors=errors)}
    assert _verdict(_between(kept, {("a", "room", None): _run(0.024, errors=everywhere)})) == "regression"
    assert _verdict(_between(kept, {("a", "room", None): _run(0.024, errors=once)})) == "no difference shown"


@pytest.mark.parametrize(
    ("new", "said"), [([0.0216], "within the limit"), ([0.0216] * 2, "regression"), ([0.0224], "regression")]
)
def test_an_error_of_a_single_run_must_change_by_twice_the_limit(new, said):
    assert _verdict(_between(_seeds([0.02] * len(new)), _seeds(new))) == said


@pytest.mark.parametrize(
    ("times", "said"),
    [([1.05, 1.09], "within the limit"), ([1.2, 1.3], "regression"), ([0.7, 0.8], "improvement"),
     ([0.9, 1.4], "no difference shown"), ([1.15], "within the limit"), ([1.25], "regression")],
)  # fmt: skip
def test_time_must_increase_in_every_run_and_by_twice_the_limit_in_a_single_run(times, said):
    ates = [0.02] * len(times)
    assert _verdict(_between(_seeds(ates), _seeds(ates, times)), TIME) == said


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ({"key": "k"}, {"key": "k"}, "machine was busy or slower: code, data and parameters are identical"),
        ({"key": "k"}, {"key": "l"}, ""),
        ({}, {"conditions": RunConditions(other_percent=40.0)}, "machine was busy: other processes took CPU time"),
        ({"conditions": RunConditions(load=1.0)}, {"conditions": RunConditions(load=9.0)}, "load 1.0 against 9.0"),
        ({"conditions": RunConditions(load=1.0)}, {"conditions": RunConditions(load=1.5)}, ""),
        ({"conditions": RunConditions(mhz=3400.0)}, {"conditions": RunConditions(mhz=2100.0)}, "3400 against 2100 MHz"),
        ({}, {"conditions": RunConditions(load=9.0, mhz=2100.0)}, ""),
    ],
)
def test_a_longer_time_is_no_regression_where_the_machine_explains_it(old, new, reason):
    """A third more CPU time in both runs: beyond the limit of 10 %."""
    before, after = (
        {("a", "room", seed): _run(ms=ms, **more) for seed in (0, 1)} for ms, more in ((1, old), (1.32, new))
    )
    found = _between(before, after)
    (change,) = (one for one in found.changes if one.metric == TIME)
    assert (change.verdict, found.regressions) == (("not comparable", 0) if reason else ("regression", 1))
    assert reason in change.reason


def test_a_busy_machine_does_not_hide_that_a_time_did_not_change():
    before, after = ({("a", "room", 0): _run(ms=ms, key="k")} for ms in (1.0, 1.05))
    assert _verdict(_between(before, after), TIME) == "within the limit"


def test_a_change_common_to_all_methods_is_attributed_to_the_machine():
    """All take a third longer, d three times as long: the median of four is the machine's, d is a regression."""
    old = {(who, "room", seed): _run(ms=1.0) for who in "abcd" for seed in (0, 1)}
    new = {(who, "room", seed): _run(ms=3.0 if who == "d" else 1.3) for who in "abcd" for seed in (0, 1)}
    found = _between(old, new)
    assert [one.method for one in found.changes if one.verdict == "regression"] == ["d"]
    assert found.notes[0].startswith(
        "the CPU time of all methods together changed by +30 %: this is attributed to the machine"
    )


def test_times_of_different_processors_are_not_compared():
    found = compare_results(
        _snapshot(_seeds([0.02])),
        _snapshot(_seeds([0.02], [9.0]), "new", "another"),
        tuple(METRICS.values()),
        DiffLimits(),
    )
    assert (_verdict(found, TIME), found.regressions) == ("not comparable", 0)
    assert found.notes == ("times are not compared: a processor against another",)


def test_a_run_that_no_longer_completes_is_a_regression_and_a_new_method_is_not():
    old = {("a", "room", 0): _run(), ("gone", "room", 0): _run(), ("b", "room", 0): _run(status="crashed")}
    new = {("a", "room", 0): _run(status="crashed"), ("b", "room", 0): _run(), ("come", "room", 0): _run()}
    found = _between(old, new)
    assert [(one.method, one.verdict) for one in found.statuses] == [("a", "regression"), ("b", "improvement")]
    assert (found.only_old, found.only_new, found.regressions) == (("gone over room",), ("come over room",), 1)
    assert found.missing == 1
    assert "; 1 improved, 0 of 0 numbers" in describe_results_diff(found, METRICS).conclusion


def test_a_run_that_completed_before_and_is_missing_now_is_counted():
    """Of four completed runs two are missing; a run that had crashed, and runs that are new, are no loss."""
    old = {("a", "room", seed): _run() for seed in (0, 1)} | {("b", "room", 0): _run(), ("c", "room", 0): _run()}
    old[("a", "room", 2)] = _run(status="crashed")
    new = {("a", "room", 0): _run(), ("c", "room", 0): _run(), ("c", "room", 1): _run()}
    found = _between(old, new)
    assert (found.only_old, found.only_new) == (
        ("a over room (seed 1, seed 2)", "b over room"),
        ("c over room (seed 1)",),
    )
    assert (found.missing, found.regressions) == (2, 0)
    conclusion = describe_results_diff(found, METRICS).conclusion
    assert conclusion.startswith("2 runs of old have no counterpart in new. No regression beyond")
    assert _between(new, new).missing == 0


def test_a_run_over_another_sequence_is_no_counterpart():
    old = _seeds([0.02], laps=1.0) | {("a", "hall", 0): _run()}
    found = _between(old, old | _seeds([0.02], laps=0.5))
    assert (found.missing, found.only_old, len(found.not_comparable)) == (1, (), 1)


@pytest.mark.parametrize(
    ("runs", "limits"),
    [({"a": 2}, "5 % of an error, 10 % of CPU time and"),
     ({"a": 1}, "10 % of an error, 20 % of CPU time (doubled: single runs) and"),
     ({"a": 1, "b": 2}, "5 % of an error, 10 % of CPU time (doubled for single runs) and")],
)  # fmt: skip
def test_the_conclusion_states_the_limits_that_were_applied(runs, limits):
    same = {(who, "room", seed): _run() for who, count in runs.items() for seed in range(count)}
    assert f" beyond {limits} the noise" in describe_results_diff(_between(same, same), METRICS).conclusion


def test_changed_parameters_make_another_sequence_and_new_ones_at_their_default_do_not():
    with pytest.raises(StoreError, match=r"not comparable with old: the sequence differs: laps 1\.0 against 0\.5"):
        _between(_seeds([0.02], laps=1.0), _seeds([0.02], laps=0.5))
    new = _seeds([0.02], laps=1.0, people=3)
    defaults = {"room": {"people": 0}}
    assert not _between(_seeds([0.02], laps=1.0), new).not_comparable
    with pytest.raises(StoreError, match="people 0 against 3"):
        compare_results(
            _snapshot(_seeds([0.02], laps=1.0)), _snapshot(new, "new", defaults=defaults), tuple(METRICS.values()),
            DiffLimits(),
        )  # fmt: skip


def test_excerpts_of_another_length_are_another_sequence(tmp_path, record, build):
    def write(name, scans):
        one = record("a", "hall", {ATE: 0.02}, seed=1)
        sequence = replace(one.spec.sequence, perturbed=True, excerpt_scans=scans)
        write_report(build([replace(one, spec=replace(one.spec, sequence=sequence))]), tmp_path / name)
        return load_stored_results(tmp_path / name)

    whole, short = write("whole", 0), write("short", 50)
    assert whole.runs[("a", "hall", 1)].perturbed
    assert whole.runs[("a", "hall", 1)].supports[ATE] > 0
    with pytest.raises(StoreError, match="the sequence differs: nuisance_scans 0 against 50"):
        compare_results(whole, short, tuple(METRICS.values()), DiffLimits())


def test_results_without_common_seeds_are_not_comparable():
    with pytest.raises(StoreError, match="seeds 0 against 7"):
        _between({("a", "room", 0): _run()}, {("a", "room", 7): _run()})


def test_markdown_output_is_a_table_with_the_worst_first():
    found = _between(_seeds([0.02, 0.02], [1.0, 1.0]), _seeds([0.03, 0.03], [0.5, 0.5]))
    text = describe_results_diff(found, METRICS)
    lines = format_markdown(text).splitlines()
    assert lines[0] == f"**{text.conclusion}**"
    assert lines[0].startswith("**1 regression beyond 5 % of an error, 10 % of CPU time and the noise; 1 improved")
    assert lines[2].startswith("| method | sequence | metric |")
    assert lines[4].startswith(
        "| a | room | ATE RMSE [m] | 0.0200 | 0.0300 | +50.0 % | 99 %: 0.0100 to 0.0100 | ❌ regression"
    )
    assert "✅ improvement" in lines[5]


# folders


@pytest.fixture
def folder(tmp_path, record, build):
    def made(name, factor=1.0):
        runs = [
            record("a", "room", {ATE: factor * ate, TIME: 1.0}, seed=seed) for seed, ate in enumerate((0.02, 0.021))
        ]
        write_report(build(runs), tmp_path / name)
        return tmp_path / name

    return made


def test_the_command_exits_with_1_only_on_a_regression(folder):
    runner, old = CliRunner(), folder("old")
    assert runner.invoke(cli.app, ["diff", str(old), str(folder("same"))]).exit_code == 0
    worse = runner.invoke(cli.app, ["diff", str(old), str(folder("worse", 1.5)), "--json"])
    assert (worse.exit_code, json.loads(worse.stdout)["regressions"]) == (1, 1)
    assert runner.invoke(cli.app, ["diff", str(old), str(folder("wide", 1.5)), "--limit-ate", "60%"]).exit_code == 0


def test_the_command_exits_with_1_if_a_run_is_missing_unless_it_is_allowed(folder, tmp_path, record, build):
    old = str(folder("old"))
    write_report(build([record("a", "room", {ATE: 0.02, TIME: 1.0}, seed=0)]), tmp_path / "new")
    arguments = ["diff", old, str(tmp_path / "new")]
    shown = CliRunner().invoke(cli.app, arguments)
    assert (shown.exit_code, "--allow-missing" in shown.stderr) == (1, True)
    assert "a over room (seed 1)" in shown.stdout
    accepted = CliRunner().invoke(cli.app, [*arguments, "--allow-missing", "--json"])
    assert (accepted.exit_code, json.loads(accepted.stdout)["missing"], accepted.stderr) == (0, 1, "")


def test_a_metric_with_a_value_in_old_alone_is_missing():
    """The second run has no ATE after; a metric that is unknown here counts, a new one does not."""
    old = _seeds([0.02, 0.03])
    old["a", "room", 0] = replace(old["a", "room", 0], scores={ATE: 0.02, TIME: 1.0, "former": 2.0})
    new = _seeds([0.02, 0.03])
    new["a", "room", 1] = replace(new["a", "room", 1], scores={TIME: 1.0, "later": 1.0})
    found = _between(old, new)
    assert [(one.metric, one.runs) for one in found.missing_metrics] == [("former", ("seed 0",)), (ATE, ("seed 1",))]
    text = describe_results_diff(found, METRICS)
    assert text.missing == 2
    assert text.conclusion.startswith("2 metrics of old have no counterpart in new. No regression beyond")
    assert text.remarks[0] == "room: former has a value in old and none in new: a (seed 0)"
    assert text.remarks[1] == "room: ATE RMSE has a value in old and none in new: a (seed 1)"
    crashed = {name: replace(run, status="crashed", scores={}) for name, run in new.items()}
    assert _between(old, crashed).missing_metrics == ()  # a regression of its own
    assert _between(new, new).missing_metrics == ()


def test_a_metric_that_is_no_headline_may_lose_its_value():
    name = next(one.name for one in METRICS.values() if not one.headline and one.group == "drift")
    old = {("a", "room", 0): replace(_run(), scores={ATE: 0.02, TIME: 1.0, name: 1.0})}
    assert _between(old, _seeds([0.02])).missing_metrics == ()


def test_the_command_exits_with_1_if_a_metric_is_missing_unless_it_is_allowed(folder, tmp_path, record, build):
    old = str(folder("old"))
    write_report(build([record("a", "room", {TIME: 1.0}, seed=seed) for seed in (0, 1)]), tmp_path / "new")
    arguments = ["diff", old, str(tmp_path / "new")]
    shown = CliRunner().invoke(cli.app, arguments)
    assert (shown.exit_code, "--allow-missing" in shown.stderr) == (1, True)
    assert "room: ATE RMSE has a value in" in " ".join(shown.stdout.split())
    accepted = CliRunner().invoke(cli.app, [*arguments, "--allow-missing", "--json"])
    assert accepted.exit_code == 0
    assert json.loads(accepted.stdout)["missing_metrics"][0]["runs"] == ["seed 0", "seed 1"]


@pytest.mark.parametrize(("width", "lines"), [(60, True), (150, False)])
def test_a_narrow_terminal_shows_one_line_for_each_change_and_no_broken_word(folder, monkeypatch, width, lines):
    shown = io.StringIO()
    monkeypatch.setattr(command, "out", WordConsole(file=shown, width=width, force_terminal=True))
    CliRunner().invoke(cli.app, ["diff", str(folder("old")), str(folder("worse", 1.5))])
    text = " ".join(shown.getvalue().split())
    assert ("a, room, ATE RMSE [m]: old 0.0205, new 0.0307, change +50.0 %, interval " in text) == lines
    assert all(word in text for word in ("regression: more than 5 %,", "interval"))


@pytest.mark.parametrize(("option", "value"), [("--limit", ["1%"]), ("--across-machines", [])])
def test_an_option_of_benchmarks_is_a_usage_error_between_results(folder, option, value):
    old = str(folder("old"))
    shown = CliRunner().invoke(cli.app, ["diff", old, old, option, *value])
    assert (shown.exit_code, f"{option} is for benchmarks" in shown.stderr) == (2, True)


@pytest.mark.parametrize("text", ["much", "-5%", "nan", "inf", "5", "1", "inf%"])
def test_a_limit_that_is_not_a_share_is_a_usage_error(folder, text):
    old = folder("old")
    assert CliRunner().invoke(cli.app, ["diff", str(old), str(old), "--limit-ate", text]).exit_code == 2


def test_unreadable_folders_are_rejected_with_the_reason(folder, tmp_path):
    path = folder("old") / "results.json"
    with pytest.raises(StoreError, match="there is no such folder"):
        load_stored_results(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(StoreError, match="it holds no run"):
        load_stored_results(tmp_path / "empty")
    whole = path.read_text(encoding="utf-8")
    path.write_text(whole.replace('"version": 4', '"version": 5'), encoding="utf-8")
    with pytest.raises(StoreError, match=r"evalkit-results version 5, expected .* version 4; repeat the comparison"):
        load_stored_results(path.parent)
    path.write_text(whole[: len(whole) // 2], encoding="utf-8")
    with pytest.raises(StoreError, match="half-written"):
        load_stored_results(path.parent)
    path.write_text(whole.replace('"value": ', '"value": 1'), encoding="utf-8")
    with pytest.raises(StoreError, match="damaged: its values do not agree with its checksum; repeat the comparison"):
        load_stored_results(path.parent)
    path.write_text(seal({"schema": {"name": "evalkit-results", "version": 4}}, {}), encoding="utf-8")
    with pytest.raises(StoreError, match=r"results\.json: no key 'title'; repeat the comparison with --resume"):
        load_stored_results(path.parent)


def test_a_folder_of_runs_without_a_report_is_read(tmp_path, record):
    made = record("a", "room", {ATE: 0.02}, seed=3)
    own = tmp_path / "runs" / "room-s3-a-0123456789"
    own.mkdir(parents=True)
    body = io.BytesIO()
    np.save(body, made.scores.errors_m)
    files = {"steps.bin": made.result.steps.tobytes(), "errors.npy": body.getvalue()}
    result = {"method": "a", "sequence": "room", "status": "complete", "reason": "", "provenance": {}}
    result["dataset_parameters"] = {"laps": 1.0, "seed": 3}
    scores = {"scores": {ATE: {"value": 0.02, "support": 60, "reason": ""}}}
    scores |= {"lost_at_s": 3.0, "lost_reason": "1.2 m away", "recovered_at_s": None}
    (own / "result.json").write_text(seal(result, files), encoding="utf-8")
    (own / "scores.json").write_text(seal(scores, files), encoding="utf-8")
    for name, content in files.items():
        (own / name).write_bytes(content)
    (tmp_path / "runs" / "room-s4-a-0123456789").mkdir()
    found = load_stored_results(tmp_path)
    run = found.runs[("a", "room", 3)]
    assert (run.status, run.parameters, run.scores, found.unfinished) == ("complete", {"laps": 1.0}, {ATE: 0.02}, 1)
    assert (run.lost, run.perturbed, run.supports) == (LostTrack(3.0, "1.2 m away"), False, {ATE: 60})
    assert len(run.errors_m) == len(run.stamps_ns) == 60
    result["dataset_parameters"] = {"laps": 1.0, "nuisance": 2}
    (own / "result.json").write_text(seal(result, files), encoding="utf-8")
    run = load_stored_results(tmp_path).runs[("a", "room", 2)]
    assert (run.perturbed, run.parameters) == (True, {"laps": 1.0, "nuisance_scans": 0})
    for change in ({"method": [[]]}, {"sequence": 7}, {"dataset_parameters": {"seed": {}}}):
        (own / "result.json").write_text(seal(result | change, files), encoding="utf-8")
        with pytest.raises(StoreError, match=r"is not complete .*: not the name of a run"):
            load_stored_results(tmp_path)


def test_a_results_folder_is_not_compared_with_a_benchmark(folder, tmp_path):
    (tmp_path / "bench.json").write_text("{}", encoding="utf-8")
    old, bench = str(folder("old")), str(tmp_path / "bench.json")
    result = CliRunner().invoke(cli.app, ["diff", old, bench])
    assert result.exit_code != 0
    assert f"{bench}: is a JSON file, {old} is a results folder; compare two" in str(result.exception)
    result = CliRunner().invoke(cli.app, ["diff", str(tmp_path), old])
    assert f"{old}: is a results folder, {tmp_path} is a folder of JSON files" in str(result.exception)


@pytest.mark.parametrize(
    ("name", "said"),
    [("old/results.json", "is a file of a results folder; name the folder: "),
     ("old/scores.csv", "is neither a results folder nor a benchmark"),
     ("empty", "holds neither results nor benchmarks"), ("none", "there is no such file or folder")],
)  # fmt: skip
def test_a_path_that_holds_nothing_to_compare_is_named_with_what_it_is(folder, tmp_path, name, said):
    old = folder("old")
    (tmp_path / "empty").mkdir()
    for pair in ([old, tmp_path / name], [tmp_path / name, old]):
        result = CliRunner().invoke(cli.app, ["diff", *map(str, pair)])
        assert f"{tmp_path / name}: {said}" in str(result.exception)


@pytest.mark.parametrize(
    ("relations", "new_m", "said"),
    [(0, 0.0449, "within the limit"), (0, 0.0451, "regression"),  # unknown: 5 mm
     (144, 0.0449, "within the limit"), (144, 0.0451, "regression"),  # 60 mm / 12
     (16, 0.0549, "within the limit"), (16, 0.0551, "regression"),  # 60 mm / 4
     (3600, 0.0449, "within the limit"), (3600, 0.0451, "regression")],  # at least 5 mm
)  # fmt: skip
@pytest.mark.parametrize("fewer", ["old", "new"])
def test_a_mean_over_relations_must_change_by_more_than_their_number_can_measure(relations, new_m, said, fewer):
    name = "relations_all_mean_m"
    old, new = (
        {
            ("a", "intel", seed): StoredRun(
                "complete", "", {}, {name: value}, supports={name: relations if which == fewer else 10 * relations}
            )
            for seed in range(3)
        }
        for which, value in (("old", 0.04), ("new", new_m))
    )
    found = _between(old, new)
    assert _verdict(found, name) == said
    assert (_reason(found, name) == "at most what errors of the ground truth make") is (said == "within the limit")
