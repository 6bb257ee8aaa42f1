"""The lines of a terminal on positions in a known map: predicted and true share, the reason of no number."""

from dataclasses import replace

import pytest

from evalkit.core.map_start import MapStart
from evalkit.core.pose import Pose
from evalkit.core.run_result import Score
from evalkit.metrics import all_metrics
from evalkit.metrics.fit_calibration import describe_calibration, load_calibration
from evalkit.report.analysis.analysis import analyse
from evalkit.terminal.map_fit import PREDICTED, TRUE, describe_map_fit

START = MapStart(Pose(), 1, 0.0, False, 0.9)


@pytest.fixture
def lines(record, build):
    def describe(values, start=START):
        records = []
        for name, own in values.items():
            one = record(name, "room", {"ate_rmse_m": 0.1})
            scores = {key: score if isinstance(score, Score) else Score(score, 9) for key, score in own.items()}
            scored = replace(one.scores, by_metric={**one.scores.by_metric, **scores})
            records.append(replace(one, result=replace(one.result, start=start), scores=scored))
        return list(describe_map_fit(analyse(build(records, metrics=all_metrics()))))

    return describe


def test_each_method_has_its_predicted_and_true_share_and_the_calibration_follows(lines):
    assert lines({"wheel": {PREDICTED: 38.24, TRUE: 41.0}, "paper": {PREDICTED: 1.0}}) == [
        "More than 10 cm off by map fit, room: wheel 38.2 % (true: 41.0 %); paper 1.0 %",
        describe_calibration(),
    ]


def test_the_calibration_says_for_which_share_of_wrong_positions_it_holds():
    wrong = load_calibration().check["wrong_share"]
    assert 0.1 < wrong < 0.9  # far from that of a drive without faults
    assert f"It holds where about {100 * wrong:.0f} % of the positions are wrong" in describe_calibration()


def test_outside_the_calibrated_range_there_is_the_reason_and_no_number(lines):
    (line,) = lines({"paper": {PREDICTED: Score(None, 9, "outside the range"), TRUE: 3.0}})
    assert line == "More than 10 cm off by map fit, room: paper: no number, outside the range"


def test_without_a_known_map_there_is_no_line(lines):
    assert lines({"paper": {PREDICTED: Score(None, reason="no known map")}}, start=None) == []
