"""``evalkit basin``: one row per back end and scene, in JSON and on a page, also for failures."""

import json
import os
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from evalkit.cli import app
from evalkit.commands.basin import command
from evalkit.core.errors import EvalkitError
from evalkit.plugins import registry

QUICK = ["--offsets", "48", "--beams", "120", "--pairs", "4", "--jobs", "1", "--scene", "long-corridor"]


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.chdir(os.path.dirname(__file__))  # noqa: PTH120 - where module:SPEC is looked for
    if command.basin not in [one.callback for one in app.registered_commands]:
        app.command()(command.basin)

    def runs(*arguments: str):
        found = CliRunner().invoke(app, ["basin", *arguments, *QUICK, "-o", str(tmp_path)])
        return found, json.loads((tmp_path / "basin.json").read_text()), (tmp_path / "index.html").read_text()

    return runs


def test_a_back_end_that_keeps_its_guess_succeeds_where_the_guess_is_good_enough(run):
    found, content, page = run("basin_backends:KEEPS", "kiss-icp")
    assert found.exit_code == 0, found.output
    kept, absent = content["rows"]
    assert content["scenes"]["long-corridor"]["open_directions"] == ["shift along 0 deg"]
    assert "the bound of Cramer and Rao if all noise were across the walls" in page
    assert kept["failures_reported_as_converged"] == 1.0
    assert 0.0 <= kept["success"]["low"] <= kept["success"]["share"] < 0.2
    assert kept["trials"] == 24
    assert kept["error_m"]["A95"] > 0.5
    assert set(absent) == {"backend", "scene", "reason"}
    assert absent["reason"]
    assert f"kiss-icp over long-corridor: {absent['reason']}" in " ".join(found.output.split())
    assert "Failures with the best guesses" in page
    assert "kiss-icp" in page
    for head in ("success [%]", "reach [m]", "reach [deg]", "A95 [m]"):  # brackets are no markup of the terminal
        assert head.split()[1] in found.output


def test_a_back_end_that_raises_or_ends_its_process_has_a_row_with_the_reason(run):
    found, content, page = run("basin_backends:RAISES", "basin_backends:ENDS", "basin_backends:KEEPS")
    assert found.exit_code == 1
    raises, ends, keeps = content["rows"]
    assert "it is out of tune" in raises["reason"]
    assert ends["reason"] == "it ended its process"
    assert keeps["reason"] == ""
    assert "it is out of tune" in page


@pytest.mark.parametrize("arguments", [["paper", "--scene", "roof"], ["papr"], ["paper", "--set", "epsilon=big"],
    ["paper", "--on", "room 'laps=1"]])  # fmt: skip
def test_invalid_requests_are_rejected_before_anything_runs(arguments, tmp_path):
    if command.basin not in [one.callback for one in app.registered_commands]:
        app.command()(command.basin)
    found = CliRunner().invoke(app, ["basin", *arguments, "-o", str(tmp_path)])
    assert found.exit_code != 0
    assert isinstance(found.exception, (EvalkitError, SystemExit))
    assert not list(tmp_path.iterdir())


def test_a_data_set_with_the_name_of_a_scene_is_rejected(tmp_path, monkeypatch):
    room = registry.dataset("room")
    monkeypatch.setattr(registry, "dataset", lambda _name: room)
    found = CliRunner().invoke(app, ["basin", "paper", "--scene", "corner", "--on", "corner", "-o", str(tmp_path)])
    assert found.exit_code == 2
    assert "a scene has the same name" in " ".join(found.output.split())


@pytest.mark.parametrize(("width", "broken"), [(80, False), (53, False), (52, True)])
def test_names_stay_whole_where_a_terminal_can_hold_them_beside_the_numbers(width, broken):
    row = SimpleNamespace(backend="mine", scene="roof", basin=None)  # 8 letters, 27 of heads, 22 of lines and spaces
    table = command._table(SimpleNamespace(rows=[row]), width + 4)
    assert [column.no_wrap for column in table.columns[:3]] == [not broken, not broken, False]
