"""The command line of the recorded data."""

import json

from typer.testing import CliRunner

from evalkit_datasets import catalog, command


def test_list_names_every_file_on_a_line_of_its_own_however_narrow_the_pipe(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    result = CliRunner().invoke(command.app, ["list"])
    assert result.exit_code == 0
    assert len(catalog.load_catalog()) == sum(line.startswith("│") for line in result.output.splitlines())


def test_the_list_for_programs():
    listed = json.loads(CliRunner().invoke(command.app, ["list", "--json"]).output)
    assert [row["name"] for row in listed] == list(catalog.load_catalog())
    assert set(listed[0]) == {"name", "summary", "licence", "where"}


def test_fetch_of_a_data_set_reports_every_file_and_ends_with_2_if_one_fails(monkeypatch, tmp_path):
    def pretended(name, _progress):
        return tmp_path / catalog.get_file(name).name

    monkeypatch.setattr(command, "fetch", pretended)
    result = CliRunner().invoke(command.app, ["fetch", "turtlebot4", "nothing"])
    assert "macfirst_floor_take_2_0.db3" in result.output
    assert "metadata.yaml" in result.output
    assert "no recorded file named 'nothing'" in result.output
    assert result.exit_code == 2
