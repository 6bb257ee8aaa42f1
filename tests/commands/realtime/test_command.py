"""``evalkit realtime``: one back end on slower devices."""

import json

import pytest
import typer
from typer.testing import CliRunner

from evalkit.commands.realtime.command import realtime
from evalkit.core.errors import BadParameter, UnknownName

pytestmark = pytest.mark.usefixtures("scoring_in_threads")

ARGUMENTS = ["wheel-odometry", "--on", "lab laps=0.05", "--factors", "1,1e6", "--repetitions", "1"]


def call(*words):
    app = typer.Typer()
    app.command()(realtime)
    return CliRunner().invoke(app, [*map(str, words)])


def test_it_prints_the_devices_and_stores_the_measured_costs(tmp_path):
    contents = [json.loads(call(*ARGUMENTS, "--json", "--out", tmp_path).stdout) for _ in range(2)]
    assert contents[0] == contents[1]  # the second run uses the stored costs
    assert [device["factor"] for device in contents[0]["devices"]] == [0.0, 1.0, 1e6]
    assert [device["dropped"] > 0.5 for device in contents[0]["devices"]] == [False, False, True]
    assert contents[0]["headroom"] > 1.0
    shown = call(*ARGUMENTS, "--out", tmp_path).stdout
    assert "answers every scan in time" in shown
    rows = [line for line in shown.splitlines() if " slower " in line and line.startswith("  ")]
    assert [row.split(" x")[0].strip() for row in rows] == ["up to 1", "1e+06"]  # neither 0 nor 1 drops a scan
    assert max(map(len, rows)) <= 80
    assert "100" not in rows[0]
    assert rows[1].rstrip().endswith("broken fewer than two answers") or "% dropped" in rows[1]


@pytest.mark.parametrize(
    ("words", "option"),
    [(["--factors", "1,-2"], "--factors"), (["--factors", "fast"], "--factors"), (["--policy", "wait"], "--policy")],
)
def test_an_invalid_option_is_a_usage_error(tmp_path, words, option):
    result = call(*ARGUMENTS, *words, "--out", tmp_path)
    assert result.exit_code == 2
    assert option in result.output


def test_an_unknown_back_end_is_refused_before_any_measurement(tmp_path):
    assert isinstance(call("papper", "--out", tmp_path).exception, UnknownName)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("on", "message"), [("room 'laps=1", "No closing quotation"), ("room laps", "NAME=VALUE")])
def test_an_invalid_data_set_is_refused_before_any_measurement(tmp_path, on, message):
    error = call("paper", "--on", on, "--out", tmp_path).exception
    assert isinstance(error, BadParameter)
    assert message in str(error)
    assert not list(tmp_path.iterdir())
