"""The GitHub Action: its summary of a validation, and the options of evalkit that it uses."""

import importlib.util
import os
import re
import subprocess
from pathlib import Path

import pytest
import ruamel.yaml
from typer.testing import CliRunner

from evalkit import cli

pytestmark = pytest.mark.checkout

ACTION = Path(__file__).resolve().parents[1] / ".github" / "actions" / "evalkit"


def check(name, outcome, decides=True):
    return {"name": name, "on": "lab, seed 0", "outcome": outcome, "decides": decides, "observed": "3 < 4 | <b>"}


def test_the_summary_has_a_row_a_level_and_names_what_did_not_pass():
    spec = importlib.util.spec_from_file_location("summary", ACTION / "summary.py")
    summary = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(summary)
    levels = [
        {"name": "rules", "outcome": "passed", "checks": [check("a", "passed"), check("b", "informative", False)]},
        {"name": "time", "outcome": "failed", "checks": [check("c", "failed"), check("d", "passed"),
                                                         check("e", "not applicable")]},
    ]  # fmt: skip
    assert summary.summarise({"subject": "mine", "verdict": "No.", "levels": levels}).splitlines() == [
        "## evalkit: mine", "", "No.", "",
        "| level | outcome | decisive checks passed |", "|---|---|---|",
        "| rules | passed | 1 of 1 |", "| time | **failed** | 1 of 2 |", "",
        "* failed: c lab, seed 0 3 &lt; 4 \\| &lt;b>",
    ]  # fmt: skip


def test_the_commands_of_the_action_have_the_options_it_uses():
    action = (ACTION / "action.yml").read_text(encoding="utf-8")
    for command, options in (("validate", ("--quick", "--json", "--out")), ("diff", ("--markdown",))):
        told = CliRunner().invoke(cli.app, [command, "--help"], env={"COLUMNS": "200"}).output
        for option in options:
            assert option in told
            assert option in action


def test_the_action_installs_the_evalkit_it_belongs_to(tmp_path):
    """PyPI has another project of this name."""
    action = ruamel.yaml.YAML(typ="safe").load((ACTION / "action.yml").read_text(encoding="utf-8"))
    (install,) = (one["run"].splitlines()[-1] for one in action["runs"]["steps"] if one.get("name") == "Install")
    pip = tmp_path / "evalkit" / "bin" / "pip"
    pip.parent.mkdir(parents=True)
    pip.write_text('#!/bin/sh\nfor last; do :; done\nprintf %s "$last"\n')
    pip.chmod(0o755)

    def installed(package):
        variables = {"RUNNER_TEMP": str(tmp_path), "GITHUB_ACTION_PATH": str(ACTION), "PACKAGE": package}
        return subprocess.run(
            ["bash", "-c", install], env=os.environ | variables, capture_output=True, text=True, check=True
        ).stdout

    folder, extra = installed(action["inputs"]["package"]["default"]).split("[")
    assert (Path(folder) / "pyproject.toml").samefile(ACTION.parents[2] / "pyproject.toml")
    assert extra == "all]"
    assert installed("./mine.whl") == "./mine.whl"


def test_every_action_is_pinned_by_the_hash_of_its_commit():
    used = [
        line.strip()
        for path in sorted(ACTION.parents[1].rglob("*.yml"))
        for line in path.read_text(encoding="utf-8").splitlines()
        if "uses:" in line
    ]
    assert len(used) > 10
    assert [line for line in used if not re.fullmatch(r"(- )?uses: [\w./-]+@[0-9a-f]{40} # v[\d.]+.*", line)] == []
