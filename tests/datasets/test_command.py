"""The command line of the recorded data."""

import json

from typer.testing import CliRunner

from evalkit_datasets import catalog, command


def test_list_prints_each_file_on_its_own_line_at_any_width(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    result = CliRunner().invoke(command.app, ["list"])
    assert result.exit_code == 0
    assert len(catalog.load_catalog()) == sum(line.startswith("│") for line in result.output.splitlines())


def test_list_can_be_printed_as_json():
    listed = json.loads(CliRunner().invoke(command.app, ["list", "--json"]).output)
    assert [row["name"] for row in listed] == list(catalog.load_catalog())
    assert set(listed[0]) == {"name", "summary", "licence", "where"}


def test_fetch_reports_every_file_and_exits_with_2_if_one_fails(monkeypatch, tmp_path):
    def pretended(name, _progress):
        return tmp_path / catalog.get_file(name).name

    monkeypatch.setattr(command, "fetch", pretended)
    result = CliRunner().invoke(command.app, ["fetch", "turtlebot4", "nothing"])
    assert "macfirst_floor_take_2_0.db3" in result.output
    assert "metadata.yaml" in result.output
    assert "no recorded file named 'nothing'" in result.output
    assert result.exit_code == 2
