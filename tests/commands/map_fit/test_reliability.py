"""The check of the calibration on worlds it was not learnt on, of drives whose answer is known by hand."""

import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evalkit.commands.map_fit.command import app
from evalkit.commands.map_fit.reliability import (
    Drive,
    Scans,
    compare_shares,
    format_markdown,
    predict_from_others,
    summarize,
)
from evalkit.metrics.fit_calibration import FILE, LIMITS_M


def drive(world, fit_m, error_m, points=100, cell_m=0.05, fault="none"):
    scans = {
        "fit_m": np.array(fit_m, dtype=float),
        "points": np.full(len(fit_m), points),
        "error_m": np.array(error_m, dtype=float),
        "cell_m": cell_m,
    }
    return Drive(world, "tracker", fault, scans)


def test_a_world_is_predicted_by_the_other_worlds_alone():
    """In the others 8 of 8 small fits are right and 3 of 3 large ones wrong: 1/10 and 4/5. In c it is the opposite."""
    drives = [
        drive("a", [0.0] * 8, [0.01] * 8),
        drive("b", [0.6] * 3, [0.5] * 3),
        drive("c", [0.0, 0.6], [0.5, 0.01]),
        drive("c", [0.0], [0.1], points=99),
        drive("c", [0.0], [0.1], cell_m=0.06),
    ]
    predicted = predict_from_others(Scans.of(drives))
    assert predicted[-4:-2] == pytest.approx([0.1, 0.8])
    assert np.isnan(predicted[-2:]).all()  # fewer points, or larger cells, than the others have
    content = summarize(drives)
    assert content["check"]["by_world"]["c"] == {
        "scans": 2,
        "wrong_share": 0.5,
        "outside_range": 2,
        "predicted": pytest.approx(0.45),
        "auc": 0.0,
        "brier": pytest.approx((0.9**2 + 0.8**2) / 2),
        "brier_constant": 0.25,
    }
    assert content["bins"][0]["scans"] == 11  # an error of exactly 10 cm is not wrong
    assert content["bins"][0]["wrong_share"] == pytest.approx(1 / 11)
    assert (content["min_points"], content["cells_m"], content["worlds"]) == (99, [0.05, 0.06], ["a", "b", "c"])
    assert "| c | 2 | 2 | 45.0 % | 50.0 % | 0.000 | 0.725 | 0.250 |" in format_markdown(content)


def test_scans_that_do_not_fit_are_ranked_last_and_drives_without_scans_are_counted():
    drives = [
        drive(world, [0.01, 0.3, np.nan], [0.02, 0.05, 2.0], fault=fault)
        for world, fault in (("a", "none"), ("b", "glass"), ("c", "glass"))
    ]
    content = summarize([*drives, drive("a", [], [])])
    assert (content["drives"], content["drives_without_scans"], content["misfit"]["scans"]) == (4, 1, 3)
    assert content["misfit"]["probability"] == pytest.approx(4 / 5)
    assert content["check"]["auc"] == 1.0
    assert [content["check"]["by_fault"][name]["scans"] for name in ("none", "glass")] == [3, 6]


def test_probabilities_are_compared_in_groups_and_those_on_a_limit_belong_above():
    predicted = np.array([0.0, 0.019, 0.02, 0.9, 1.0, np.nan])
    rows = compare_shares(predicted, np.array([False, True, False, True, True, True]))
    assert [(row["from"], row["scans"], row["wrong_share"]) for row in rows] == [
        (0.0, 2, 0.5),
        (0.02, 1, 0.0),
        (0.9, 2, 1.0),
    ]
    assert rows[0]["predicted"] == pytest.approx(0.0095)


@pytest.mark.checkout
def test_the_documentation_shows_the_shipped_measurement():
    content = json.loads(files("evalkit.metrics").joinpath(FILE).read_text(encoding="utf-8"))
    page = (Path(__file__).parents[3] / "docs/pages/known-map-measured.md").read_text(encoding="utf-8")
    tables = format_markdown(content).strip().split("\n\n")
    for table in tables:
        assert page.count(table) == 1
    rows = [row for row in page.splitlines() if row.startswith("| below ")]
    assert len(rows) == sum(table.count("\n| below ") for table in tables)


EXPERIMENT = """
title = "small"

[[method]]
use = "wheel-odometry"

[[sequence]]
use = "room"
laps = 0.1
rate_hz = 5.0

[[sequence]]
use = "lab"
laps = 0.1
rate_hz = 5.0
"""
THIRD = """
[[sequence]]
use = "office"
laps = 0.07
rate_hz = 5.0
"""


def test_fewer_than_three_worlds_or_a_recording_are_refused(tmp_path):
    file = tmp_path / "small.toml"
    for text, what in ((EXPERIMENT, "2 worlds"), (EXPERIMENT + '[[sequence]]\nuse = "static"\n', "is a recording")):
        file.write_text(text, encoding="utf-8")
        result = CliRunner().invoke(app, [str(file), "--out", str(tmp_path / "out")])
        assert what in str(result.exception)


@pytest.mark.thorough
def test_the_fit_tells_wrong_positions_in_worlds_that_were_not_learnt(tmp_path):
    """Wheel odometry drifts, starts wrong and is kidnapped: in each world the fit by the others ranks it."""
    file = tmp_path / "small.toml"
    file.write_text(EXPERIMENT + THIRD, encoding="utf-8")
    result = CliRunner().invoke(app, [str(file), "--out", str(tmp_path / "out"), "--jobs", "1"])
    assert result.exit_code == 0, result.output
    content = json.loads((tmp_path / "out" / "fit_calibration.json").read_text(encoding="utf-8"))
    check = content["check"]
    assert content["drives"] == 3 * 6
    assert check["scans"] > 200
    assert check["auc"] > 0.9
    assert check["brier"] < 0.5 * check["brier_constant"]
    assert len(content["bins"]) == len(LIMITS_M) + 1
    assert (tmp_path / "out" / "map-fit.md").read_text(encoding="utf-8") in result.output
