"""The table of a terminal on a known map: use of the map, start, fit, wrong positions, the reason of no number."""

from dataclasses import replace

import pytest

from evalkit.core.map_start import MapStart
from evalkit.core.pose import Pose
from evalkit.core.run_result import Score
from evalkit.metrics import all_metrics
from evalkit.metrics.fit_calibration import describe_calibration, load_calibration
from evalkit.report.analysis.analysis import analyse
from evalkit.terminal.map_fit import FIT, PREDICTED, TRUE, describe_map_fit

START = MapStart(Pose(), 1, 0.0, False, 0.9)


@pytest.fixture
def lines(record, build):
    def describe(values, start=START, width=80):
        records = []
        for name, own in values.items():
            one = record(name, "room", {"ate_rmse_m": 0.1})
            scores = {key: score if isinstance(score, Score) else Score(score, 9) for key, score in own.items()}
            scored = replace(one.scores, by_metric={**one.scores.by_metric, **scores})
            records.append(replace(one, result=replace(one.result, start=start), scores=scored))
        return list(
            describe_map_fit(analyse(build(records, metrics=all_metrics())), {name: name for name in values}, width)
        )

    return describe


def test_each_method_has_its_use_of_the_map_its_start_its_fit_and_its_wrong_positions(lines):
    *table, note = lines(
        {"wheel": {PREDICTED: 38.24, FIT: 0.052, TRUE: 41.0}, "paper": {PREDICTED: 1.0, FIT: 0.009}},
        MapStart(Pose(), 8, 0.7, True, 0.9),
    )
    assert [line.replace("\u00a0", " ") for line in table] == [
        "In the known map, room:",
        "         map         localised after     fit  wrong by fit  truly wrong",
        "  paper  start only            0.7 s  9.0 mm         1.0 %            –",
        "  wheel  start only            0.7 s   52 mm        38.2 %       41.0 %",
    ]
    assert "more than 10 cm off; too high where fewer than 27 % really are" in note
    assert len(note) < 300  # what the shares were learnt on is on the page


def test_a_long_name_is_cut_to_the_width_of_the_table(lines):
    """Of 60 columns, the others take 2 + 12 + 17 + 8 + 14 and the name the rest of 7."""
    _, head, line, *_ = lines({"abcdefghijklmnopq": {PREDICTED: 1.0, FIT: 0.009}}, width=60)
    assert line.startswith("  ab...pq  start only  ")
    assert len(line) == len(head) == 60


def test_a_given_start_is_not_searched(lines):
    assert lines({"paper": {PREDICTED: 1.0}})[2].split() == ["paper", "start", "only", "given", "–", "1.0", "%"]


def test_the_calibration_says_for_which_share_of_wrong_positions_it_holds():
    wrong = load_calibration().check["wrong_share"]
    assert 0.1 < wrong < 0.9  # far from that of a drive without faults
    assert f"It holds where about {100 * wrong:.0f} % of the positions are wrong" in describe_calibration()


def test_outside_the_calibrated_range_there_is_the_reason_and_no_number(lines):
    *_, line, _ = lines({"paper": {PREDICTED: Score(None, 9, "outside the range"), TRUE: 3.0}})
    assert line == "paper: no share of wrong positions, outside the range"


def test_without_a_known_map_there_is_no_line(lines):
    assert lines({"paper": {PREDICTED: Score(None, reason="no known map")}}, start=None) == []
