"""The command line of the recorded data."""

import json

import pytest
from typer.testing import CliRunner

from evalkit_datasets.commands.datasets import command
from evalkit_datasets.recordings import catalog


def test_list_prints_each_file_on_its_own_line_with_its_licence_and_place(monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    result = CliRunner().invoke(command.app, ["list"])
    assert result.exit_code == 0
    lines = result.output.splitlines()[1:]
    for line, card in zip(lines, catalog.load_catalog().values(), strict=True):
        assert line.split()[0] == card.name
        assert f"; licence: {card.licence}; " in line


def test_list_can_be_printed_as_json():
    listed = json.loads(CliRunner().invoke(command.app, ["list", "--json"]).output)
    assert [row["name"] for row in listed] == list(catalog.load_catalog())
    assert set(listed[0]) == {"name", "summary", "licence", "where"}


def test_fetch_reports_every_file_and_exits_with_2_if_one_fails(monkeypatch, tmp_path):
    def pretended(name, _progress):
        return tmp_path / catalog.get_file(name).name

    monkeypatch.setattr(command, "fetch", pretended)
    monkeypatch.setattr(command, "why_offline", lambda _url: "")
    result = CliRunner().invoke(command.app, ["fetch", "turtlebot4", "nothing"])
    assert "macfirst_floor_take_2_0.db3" in result.output
    assert "metadata.yaml" in result.output
    assert "no recorded file named 'nothing'" in result.output
    assert result.exit_code == 2


@pytest.fixture
def bare(monkeypatch, tmp_path):
    """A machine without recordings, and an experiment that uses two of them."""
    monkeypatch.setenv(catalog.VARIABLE, str(tmp_path / "data"))
    monkeypatch.setattr(catalog, "cache_folder", lambda: tmp_path / "cache")
    experiment = tmp_path / "e.toml"
    experiment.write_text("".join(f'[[sequence]]\nuse = "{name}"\n' for name in ("lab", "fr079", "static")))
    return experiment


def test_offline_an_experiment_goes_on_without_its_recordings(bare, monkeypatch):
    monkeypatch.setenv("EVALKIT_OFFLINE", "1")
    result = CliRunner().invoke(command.app, ["fetch", "--for", str(bare)])
    assert result.output == (
        "offline (EVALKIT_OFFLINE is set): not fetched: fr079, static; their runs are listed as missing\n"
    )
    assert result.exit_code == 0
    assert CliRunner().invoke(command.app, ["fetch", "static"]).exit_code == 2


def test_the_files_of_an_experiment_are_announced_with_size_and_licence(bare, monkeypatch):
    fetched = []
    monkeypatch.setattr(command, "why_offline", lambda _url: "")
    monkeypatch.setattr(command, "fetch", lambda name, _progress: fetched.append(name))
    result = CliRunner().invoke(command.app, ["fetch", "--for", str(bare)])
    assert "downloading 4 files, 7.4 MB:" in result.output
    assert "  static-2xhokuyo.bag, 2.0 MB, licence: BSD (package.xml of the repository)\n" in result.output
    assert fetched == ["fr079-built.clf", "fr079.relations", "fr079-reference-flirtlib.tum", "static-2xhokuyo.bag"]


def test_fetch_needs_a_name_or_an_experiment():
    assert "give names of data sets" in CliRunner().invoke(command.app, ["fetch"]).output
