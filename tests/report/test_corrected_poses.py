"""A report with a SLAM ranks answers among all methods and corrected poses among those that have them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from evalkit import metrics
from evalkit.core import se2
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.pose import Pose
from evalkit.core.run_result import FinalAlignment, Score
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.series import SERIES
from evalkit.report.analysis.analysis import analyse
from evalkit.report.assembly import select_metrics
from evalkit.report.html.corrected_runs import add_strokes, with_corrected
from evalkit.report.html.corrected_tables import build_corrected, list_closures
from evalkit.report.html.method_colours import assign_strokes
from evalkit.report.html.player import build_player
from evalkit.report.html.report_tables import headline_table, numbers_table
from evalkit.report.results_json import build_results
from evalkit.report.tables import build_summary_table
from evalkit.terminal.ranked_table import build_rows, format_rows

NAMES = ("ate_rmse_m", "final_ate_rmse_m")


def corrected(run, error_m):
    """The run of a SLAM whose corrected poses are the answers, and whose distance to the truth is ``error_m``."""
    final = Trajectory(run.result.steps["stamp_ns"], run.result.estimate.poses, "start", "base")
    alignment = FinalAlignment(alignment="least squares", errors_m=np.full(len(final), error_m))
    return replace(run, result=replace(run.result, final=final), scores=replace(run.scores, final=alignment))


def records(record):
    made = []
    for seed in range(3):
        more = 1.0 + 0.01 * seed
        made.append(record("odometry", "room", {"ate_rmse_m": 0.05 * more, "final_ate_rmse_m": None}, seed=seed))
        for name, online, final in (("slam", 0.08, 0.01), ("other", 0.06, 0.03)):
            scores = {"ate_rmse_m": online * more, "final_ate_rmse_m": final * more}
            made.append(corrected(record(name, "room", scores, seed=seed), final))
    return made


def test_a_report_without_corrected_poses_has_no_metric_of_them(record):
    plain = [record("odometry", "room", {"ate_rmse_m": 0.05})]
    of_answers = [one for one in metrics.all_metrics() if not one.slam_only and one.group != "localisation"]
    assert list(select_metrics(plain)) == of_answers
    with_final = [one for one in metrics.all_metrics() if one.group != "localisation"]
    assert list(select_metrics(records(record))) == with_final
    assert any(one.slam_only for one in with_final)


def test_answers_decide_among_all_and_corrected_poses_among_those_that_have_them(record, build):
    table = tuple(metric for metric in metrics.METRICS if metric.name in NAMES)
    analysis = analyse(build(records(record), metrics=table))
    (sequence,) = analysis.sequences
    assert (sequence.deciding.metric.name, sequence.final.metric.name) == NAMES
    assert [score.method for score in sequence.deciding.ranked] == ["odometry", "other", "slam"]
    assert [score.method for score in sequence.final.ranked] == ["slam", "other"]
    assert sequence.final.of("odometry").values == ()
    assert [verdict.leaders[0] for verdict in analysis.verdicts] == ["odometry"]
    rows = build_summary_table(analysis).set_index(["method", "metric"])
    assert (rows.loc[("slam", NAMES[0]), "rank"], rows.loc[("slam", NAMES[1]), "rank"]) == (3, 1)
    content = build_results(analysis)
    assert [one["counterpart"] for one in content["metrics"]] == ["", "ate_rmse_m"]
    hashes = {run["method"]: (run["final_sha256"] != "", run["final_alignment"]) for run in content["runs"]}
    assert hashes == {"odometry": (False, ""), "slam": (True, "least squares"), "other": (True, "least squares")}


def test_corrections_that_change_no_error_have_no_column(record, build):
    runs = []
    for seed in range(2):
        scores = {"ate_rmse_m": 0.05, "final_ate_rmse_m": 0.05 * (1.0 + 1e-15)}
        runs += [
            corrected(record("slam", "room", scores, seed=seed), 0.05),
            record("other", "room", {"ate_rmse_m": 0.1}, seed=seed),
        ]
    table = tuple(metric for metric in metrics.METRICS if metric.name in NAMES)
    (sequence,) = analyse(build(runs, metrics=table)).sequences
    assert sequence.final is None


def test_the_series_of_corrected_poses_is_that_of_their_errors(record):
    run = corrected(record("slam", "room", {"ate_rmse_m": 0.5}), 0.25)
    assert set(SERIES["final_ate_rmse_m"](run).values.tolist()) == {0.25}
    assert SERIES["ate_rmse_m"](run).values.max() > 0.4
    assert SERIES["final_ate_rmse_m"](record("odometry", "room", {"ate_rmse_m": 0.5})) is None


def cells(table):
    return [[cell if isinstance(cell, str) else cell.text for cell in row] for row in table.rows]


def test_corrected_poses_have_columns_of_their_own_beside_the_answers(record, build):
    table = tuple(metric for metric in metrics.METRICS if metric.name in NAMES)
    analysis = analyse(build(records(record), metrics=table))
    strokes = assign_strokes(analysis.comparison.method_labels, ())
    (sequence,) = analysis.sequences
    headline = headline_table(analysis, sequence, 1, strokes)
    assert [column.label for column in headline.columns][2:] == ["ATE RMSE", "ATE RMSE, corrected poses"]
    assert [(row[0], *row[2:]) for row in cells(headline)] == [
        ("odometry", "50\u00a0mm", "–"), ("other", "61\u00a0mm", "30\u00a0mm"), ("slam", "81\u00a0mm", "10\u00a0mm"),
    ]  # fmt: skip
    numbers = numbers_table(analysis, strokes)
    assert [column.label for column in numbers.columns][2:] == ["room", "CPU a scan"]
    below = {row[0].text: row[2].extent.replace("\u00a0", " ") for row in numbers.rows}
    assert below["slam"].endswith(", corrected 10 mm")
    assert "corrected" not in below["odometry"]


def test_loop_closures_are_in_a_table_of_the_methods_that_correct_poses(record, build):
    names = (*NAMES, "closure_candidates", "closures_accepted", "closure_precision_percent", "recoveries_own")
    runs = [
        replace(run, scores=replace(run.scores, by_metric={
            **run.scores.by_metric,
            **{name: Score(value, 60) for name, value in zip(names[2:], (9.0, 7.0, 100.0, 2.0), strict=True)},
        })) if run.method == "slam" else run
        for run in records(record)
    ]  # fmt: skip
    table = tuple(metric for metric in metrics.METRICS if metric.name in names)
    analysis = analyse(build(runs, metrics=table))
    (sequence,) = analysis.sequences
    _, found, note, *_ = build_corrected(analysis, sequence, 1, assign_strokes(("slam", "other", "odometry"), ()), "s")
    assert cells(found) == [
        ["slam", "81\u00a0mm", "10\u00a0mm", "9", "7", "100.0", "2"],
        ["other", "61\u00a0mm", "30\u00a0mm", *["–"] * 4],
    ]
    assert found.columns[-1].label == "Recoveries (own)"
    assert "Recall" in note.body
    plain = analyse(build([record("odometry", "room", {"ate_rmse_m": 0.05})]))
    assert build_corrected(plain, plain.sequences[0], 1, {}, "s") == []


def test_the_terminal_prints_corrected_errors_in_a_column(record, build):
    table = tuple(metric for metric in metrics.METRICS if metric.name in NAMES)
    head, rows = build_rows(analyse(build(records(record), metrics=table)))
    assert [(row.method, row.corrected) for row in rows] == [
        ("odometry", ""), ("other", "30\u00a0mm"), ("slam", "10\u00a0mm"),
    ]  # fmt: skip
    lines = [line.plain for line in format_rows(head, rows, 80)]
    assert lines[0].endswith("corrected")
    assert lines[2].endswith("30 mm")
    assert max(map(len, lines)) <= 80


def closed(run):
    """The run with a right and a wrong loop closure between scans of known true poses, and a rejected one."""
    truth, stamps = run.truth.trajectory, run.result.steps["stamp_ns"]
    right = Pose.of(se2.between(truth.at(stamps[5:6]), truth.at(stamps[50:51]))[0])
    wrong = Pose(right.x + 0.3, right.y + 0.4, right.theta)
    at = [(int(stamps[late]), int(stamps[early])) for late, early in ((50, 5), (50, 5), (20, 2))]
    closures = (
        LoopClosure(*at[1], wrong, True, "score 0.6 > 0.55"), LoopClosure(*at[0], right, True, "score 0.9 > 0.55"),
        LoopClosure(*at[2], right, False, "score 0.4 < 0.55"),
    )  # fmt: skip
    return replace(run, result=replace(run.result, loop_closures=closures))


def test_loop_closures_are_listed_with_their_distance_from_the_truth_and_open_the_player(record):
    run = closed(corrected(record("slam", "room", {"ate_rmse_m": 0.1}), 0.01))
    (fold,) = list_closures([record("odometry", "room", {}), run], "sequence-1")
    assert fold.title == "Loop closures of slam: 3 candidates, 2 accepted"
    accepted, rejected, note = fold.blocks
    assert [(row[0].text, row[1].text, row[2], row[3].text) for row in accepted.rows] == [
        ("5.0", "0.5", "score 0.6 > 0.55", "500\u00a0mm"), ("5.0", "0.5", "score 0.9 > 0.55", "0.0\u00a0mm"),
    ]  # fmt: skip
    assert [row[:4] for row in cells(rejected)] == [["score 0.4 < 0.55", "1", "2.0", "0.2"]]
    assert rejected.columns[-1].label == "Its guess, from the true motion"
    assert rejected.rows[0][2].link == "#sequence-1-player?by=slam&and=slam%2C%20corrected&on=own&scan=21"
    assert run.truth.how in note.body


def test_all_accepted_closures_come_first_and_rejected_ones_by_reason(record):
    """40 candidates of low score precede the accepted one."""
    run = closed(corrected(record("slam", "room", {"ate_rmse_m": 0.1}), 0.01))
    stamps, accepted = run.result.steps["stamp_ns"], run.result.loop_closures[0]
    low = [
        LoopClosure(int(stamps[at]), int(stamps[0]), Pose(), False, f"score 0.{at:02d} < 0.55") for at in range(2, 42)
    ]  # fmt: skip
    other = LoopClosure(int(stamps[1]), int(stamps[0]), Pose(), False, "overlap 0.6 < 0.7")
    (fold,) = list_closures([replace(run, result=replace(run.result, loop_closures=(*low, other, accepted)))], "s")
    assert fold.title == "Loop closures of slam: 42 candidates, 1 accepted"
    first, second, *_ = fold.blocks
    assert [row[2] for row in first.rows] == [accepted.reason]
    assert [row[:2] for row in cells(second)] == [
        ["score 0.02 < 0.55", "40 (0.02, 0.215, 0.41)"], ["score 0.03 < 0.55", ""], ["score 0.04 < 0.55", ""],
        ["overlap 0.6 < 0.7", "1"],
    ]  # fmt: skip
    (alone,) = list_closures([replace(run, result=replace(run.result, loop_closures=(accepted,)))], "s")
    assert alone.title == "Loop closures of slam: 1 candidate, 1 accepted"


@pytest.mark.parametrize(
    ("reasons", "shown"),
    [
        (["overlap 0.5 < 0.7", "overlap 0.2 < 0.7", "overlap 0.6 < 0.7"], "3 (0.2, 0.5, 0.6)"),
        (["score at most 0.549, below 0.55"] * 2, "2"),
        (["lost", "lost"], "2"),
        (["chi2 1e3, high", "chi2 20, high"], "2 (20, 510, 1e+03)"),
        (["part 1.2.3", "part 1.2.4"], "2"),
        (["1,000 points", "2,000 points"], "2"),
    ],
)
def test_a_kind_of_rejection_states_the_range_of_its_first_number(record, reasons, shown):
    run = closed(corrected(record("slam", "room", {"ate_rmse_m": 0.1}), 0.01))
    stamps = run.result.steps["stamp_ns"]
    low = [LoopClosure(int(stamps[at]), int(stamps[0]), Pose(), False, reason) for at, reason in enumerate(reasons, 1)]
    (fold,) = list_closures([replace(run, result=replace(run.result, loop_closures=tuple(low)))], "s")
    assert cells(fold.blocks[0])[0][:2] == [reasons[0], shown]


def test_loop_closures_are_shown_where_no_error_has_a_counterpart_of_corrected_poses(record, build):
    """As on a recording without truth, which the maps decide; and where all candidates are rejected."""
    names = ("map_f1", "closure_candidates", "closures_accepted", "cpu_p99_ms", "cpu_max_ms")
    table = tuple(metric for metric in metrics.METRICS if metric.name in names)
    scores = dict(zip(names, (0.5, 3.0, 2.0, 8.0, 9.0), strict=True))
    run = closed(corrected(record("slam", "room", scores), 0.01))
    rejected = tuple(replace(one, accepted=False) for one in run.result.loop_closures)
    for loops in (run.result.loop_closures, rejected):
        runs = [
            replace(run, result=replace(run.result, loop_closures=loops)), record("odometry", "room", {"map_f1": 0.4}),
        ]  # fmt: skip
        analysis = analyse(build(runs, metrics=table))
        (sequence,) = analysis.sequences
        assert sequence.final is None
        heading, found, _, fold = build_corrected(analysis, sequence, 1, assign_strokes(("slam", "odometry"), ()), "s")
        assert heading.text == "Corrected poses and loop closures"
        assert cells(found) == [["slam", "3", "2", "8.00", "9.00"]]
        assert fold.title == f"Loop closures of slam: 3 candidates, {sum(one.accepted for one in loops)} accepted"


def test_corrected_poses_are_runs_of_their_own_in_charts_and_player(record):
    run = corrected(record("slam", "room", {"ate_rmse_m": 0.1}), 0.01)
    plain = record("odometry", "room", {"ate_rmse_m": 0.05})
    shown = with_corrected([plain, run])
    assert [one.method for one in shown] == ["odometry", "slam", "slam, corrected"]
    assert shown[2].scores.errors_m.max() == 0.01
    assert np.array_equal(shown[2].result.estimate.poses, run.result.final.poses)
    strokes = add_strokes(assign_strokes(("slam", "odometry"), ()))
    assert strokes["slam, corrected"].colour == strokes["slam"].colour
    content = json.loads(build_player(shown, None, None, strokes).content)
    assert [(one["label"], one["map"]) for one in content["runs"]] == [
        ("odometry", "odometry"), ("slam", "slam"), ("slam, corrected", "slam"),
    ]  # fmt: skip
