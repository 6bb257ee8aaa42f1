"""The documentation lists every public name: of the Python API, and of the groups of entry points."""

import re
from pathlib import Path

import pytest

import evalkit
import evalkit.testing
from evalkit.plugins import registry

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^::: (\S+)\n(?:    options:\n(?:      .*\n)*?      members: \[(.*)\])?", re.MULTILINE)


@pytest.mark.checkout
def test_the_page_of_the_api_lists_every_public_name_and_no_other():
    listed = []
    for path, members in BLOCK.findall((ROOT / "docs" / "pages" / "api.md").read_text(encoding="utf-8")):
        listed += members.split(", ") if members else [path.rpartition(".")[2]]
    plots = "Plots"  # what ComparisonResults.plot returns
    assert sorted(listed) == sorted({*evalkit.__all__, *evalkit.testing.__all__, plots} - {"__version__"})


@pytest.mark.checkout
def test_contributing_lists_every_group_of_entry_points():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"\(`evalkit\.(\w+)`\)", text)) == sorted(registry.KINDS)
