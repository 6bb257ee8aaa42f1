"""The table of runs that tracked the robot in a known map: start, track, errors; absent without such a map."""

from dataclasses import replace

import numpy as np
import pytest

from evalkit.core.map_start import MapStart
from evalkit.core.pose import Pose
from evalkit.core.run_result import LostTrack
from evalkit.metrics import all_metrics
from evalkit.report.analysis.analysis import analyse
from evalkit.report.analysis.ranking import mark
from evalkit.report.html.known_map import build_known_map
from evalkit.report.html.method_colours import assign_strokes
from evalkit.report.html.report_tables import DASH


def found(records, build):
    analysis = analyse(build(records))
    (sequence,) = analysis.sequences
    return build_known_map(analysis, sequence, 1, assign_strokes(["paper", "wheel"]), "room")


def in_map(record, start, lost=None, fit=None):
    scores = replace(record.scores, lost=lost, fit=np.zeros((0, 3)) if fit is None else fit)
    return replace(record, result=replace(record.result, start=start), scores=scores)


def test_each_method_has_its_start_and_its_track(record, build):
    pair = [record(name, "room", {"ate_rmse_m": value}) for name, value in (("paper", 0.1), ("wheel", 0.4))]
    assert found(pair, build) == []
    searched = MapStart(Pose(), 8, 0.7, True, 0.91)
    fit = np.column_stack([np.full(20, 0.02), np.full(20, 0.04), np.ones(20)])
    both = [
        in_map(pair[0], searched, fit=fit),
        in_map(pair[1], MapStart(Pose(), 1, 0.0, False, 1.0), LostTrack(3.0, "a jump of 2 m")),
    ]
    heading, _, table, figures = found(both, build)
    assert heading.text == "In the known map"
    rows = [[getattr(cell, "text", cell) for cell in row[1:4]] for row in table.rows]
    assert (rows[0], rows[1][1]) == (["start only", "0.7 s", "held"], DASH.text)
    (first, second) = table.rows
    assert (first[2].tip, second[3].tone, second[3].tip) == ("scan 8, score 0.91", "bad", "a jump of 2 m")
    (figure,) = figures.figures
    assert figure.svg.startswith(b"<?xml") or b"<svg" in figure.svg
    assert len(found(both[1:], build)) == 3  # nothing is predicted: no figure


def test_a_percentage_point_is_no_margin_for_metres(record, build):
    """Errors by map fit of 10 and 100 mm differ; shares of 0.2 and 0.9 % do not."""
    runs = [
        record(name, "room", {"map_fit_m": fit + seed / 1e5, "map_wrong_percent": wrong + seed / 1e3}, seed=seed)
        for name, fit, wrong in (("plane", 0.01, 0.2), ("slam", 0.1, 0.9)) for seed in range(6)
    ]  # fmt: skip
    (sequence,) = analyse(build(runs, metrics=all_metrics())).sequences
    marks = {name: mark(sequence.rankings[name], "slam") for name in ("map_fit_m", "map_wrong_percent")}
    assert marks == {"map_fit_m": "worse", "map_wrong_percent": "tied"}


def test_without_truth_no_track_is_called_held(record, build):
    start = MapStart(Pose(), 1, 0.0, True, 0.91)
    runs = [record("slam", "room", {"map_wrong_percent": 50.0}, truth=known) for known in (True, False)]
    tracks = [found([in_map(run, start)], build)[2].rows[0][3] for run in runs]
    assert [track.text for track in tracks] == ["held", "no loss seen"]
    assert "not the place in the map" in tracks[1].tip


def test_the_table_says_which_methods_match_the_map_and_which_only_start_there(record, build):
    """A registration is matched with the map, an odometry with a parameter ``map`` is given it, SLAM and others not."""
    names = {"plane": "matches", "amcl": "reads", "wheel": "starts there"}
    start = MapStart(Pose(), 1, 0.0, True, 0.91)
    comparison = build([in_map(record(name, "room", {"ate_rmse_m": 0.1}), start) for name in names])
    cards = {name: replace(card, map_use=names[name]) for name, card in comparison.methods.items()}
    analysis = analyse(replace(comparison, methods=cards))
    _, note, table, *_ = build_known_map(analysis, analysis.sequences[0], 1, assign_strokes(names), "room")
    assert {row[0].text: row[1].text for row in table.rows} == {
        "plane": "matched", "amcl": "given the file", "wheel": "start only"
    }  # fmt: skip
    assert "Start only: it runs as without a map" in note.body
    assert "in a known map, where wheel only starts" in [pill.text for pill in analysis.answer.pills]


@pytest.mark.parametrize("count", [0, 1])
def test_runs_without_a_known_map_have_no_table(record, build, count):
    records = [record("paper", "room", {"ate_rmse_m": 0.1}, seed=seed) for seed in range(count + 1)]
    assert found(records, build) == []
