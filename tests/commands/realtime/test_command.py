"""``evalkit realtime``: one back end, slower and slower devices."""

import json

import pytest
import typer
from typer.testing import CliRunner

from evalkit.commands.realtime.command import realtime
from evalkit.core.errors import UnknownName

ASKED = ["wheel-odometry", "--on", "lab laps=0.05", "--factors", "1,1e6", "--repetitions", "1"]


def call(*words):
    app = typer.Typer()
    app.command()(realtime)
    return CliRunner().invoke(app, [*map(str, words)])


def test_it_tells_the_ladder_and_keeps_the_costs_it_was_made_of(tmp_path):
    told = [json.loads(call(*ASKED, "--json", "--out", tmp_path).stdout) for _ in range(2)]
    assert told[0] == told[1]  # the second takes the costs of the first, so the same scans are dropped
    assert [rung["factor"] for rung in told[0]["rungs"]] == [0.0, 1.0, 1e6]
    assert [rung["dropped"] > 0.5 for rung in told[0]["rungs"]] == [False, False, True]
    assert told[0]["headroom"] > 1.0
    shown = call(*ASKED, "--out", tmp_path).stdout
    assert "device factor" in shown
    assert "answers every scan in time" in shown


@pytest.mark.parametrize(
    ("words", "complaint"),
    [(["--factors", "1,-2"], "--factors"), (["--factors", "fast"], "--factors"), (["--policy", "wait"], "--policy")],
)
def test_what_cannot_be_asked_is_a_usage_error(tmp_path, words, complaint):
    result = call(*ASKED, *words, "--out", tmp_path)
    assert result.exit_code == 2
    assert complaint in result.output


def test_an_unknown_back_end_is_told_before_anything_is_measured(tmp_path):
    assert isinstance(call("papper", "--out", tmp_path).exception, UnknownName)
    assert not list(tmp_path.iterdir())
