"""The page of the Python API lists every public name."""

import re
from pathlib import Path

import pytest

import evalkit
import evalkit.testing

PAGE = Path(__file__).parents[2] / "docs" / "pages" / "api.md"
BLOCK = re.compile(r"^::: (\S+)\n(?:    options:\n(?:      .*\n)*?      members: \[(.*)\])?", re.MULTILINE)


@pytest.mark.checkout
def test_the_page_of_the_api_lists_every_public_name_and_no_other():
    listed = []
    for path, members in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        listed += members.split(", ") if members else [path.rpartition(".")[2]]
    plots = "Plots"  # what ComparisonResults.plot returns
    assert sorted(listed) == sorted({*evalkit.__all__, *evalkit.testing.__all__, plots} - {"__version__"})
