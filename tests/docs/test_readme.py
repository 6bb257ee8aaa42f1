"""What README.md claims is so: its names, its commands, its example."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from evalkit.cli import app
from evalkit.config.experiment import experiment_from_tables, load_experiment
from evalkit.plugins import registry

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_back_end_it_names_exists_and_every_one_that_exists_is_named():
    table = README.split("| back end |")[1].split("\n\n")[0]
    assert set(re.findall(r"`([\w-]+)`", table)) == set(registry.names("backends"))


def test_every_data_set_is_named():
    readers = {name for name in registry.names("datasets") if registry.dataset(name).suffixes}
    line = README.split("Synthetic worlds:")[1].split("`evalkit datasets list`")[0]
    assert set(re.findall(r"`([\w-]+)`", line)) == set(registry.names("datasets")) - readers


def test_its_experiment_is_a_valid_one():
    content = tomllib.loads(README.split("```toml\n")[1].split("```")[0])
    plan = experiment_from_tables(content, "README.md", "readme", "compare my.toml")
    assert [method.label for method in plan.methods] == ["wheel-odometry", "paper, 1e-5"]
    assert plan.methods[1].parameters["keyframes"] == 20
    assert len(list(plan.runs())) == 6


@pytest.mark.parametrize("line", [line.strip() for line in README.splitlines() if line.startswith("    evalkit ")])
def test_every_command_and_option_it_shows_exists(line):
    words = shlex.split(line, comments=True)[1:]
    path = words[:2] if words[0] == "datasets" else words[:1]
    answer = CliRunner().invoke(app, [*path, "--help"], env={"COLUMNS": "200"})
    if path[0] not in registry.names("commands"):  # those of plug-ins are added when the program starts
        assert answer.exit_code == 0
        assert all(word in answer.output for word in words if word.startswith("--"))


@pytest.mark.parametrize("target", sorted(set(re.findall(r"make ([a-z-]+)", README))))
def test_every_make_target_it_names_exists(target):
    if not (ROOT / "Makefile").exists():
        pytest.skip("not in a checkout")
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


def test_the_shipped_experiments_are_valid():
    for name in ("default", "quick"):
        plan = load_experiment(ROOT / "reports" / f"{name}.toml")
        assert "wheel-odometry" in [method.label for method in plan.methods]
        assert not any(sequence.label == "" for sequence in plan.sequences)
