"""The documentation names what exists: the Python API, the groups of entry points, and the modules of the changelog."""

import re
from importlib.util import find_spec
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


def module_names(cell):
    """Return the modules in a cell of a table: `evalkit.core.{pose,scan}` is two."""
    found = re.findall(r"`(evalkit[\w.]+?)(?:\.\{([\w,]+)\}|\.\*)?`", cell)
    return [f"{path}.{name}".rstrip(".") for path, names in found for name in names.split(",")]


@pytest.mark.checkout
def test_the_changelog_moves_modules_to_where_they_are():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## ")[1]
    rows = [
        row.split(" | ") for row in text.split("\n### Python: modules\n")[1].split("\n### ")[0].splitlines()[3:] if row
    ]
    names = [name for _, now in rows for name in module_names(now)]
    assert len(names) > 50
    assert [name for name in names if find_spec(name) is None] == []
    assert module_names("`evalkit.core.{pose,scan}`, `evalkit.report.html.*`, `evalkit.design`") == [
        "evalkit.core.pose", "evalkit.core.scan", "evalkit.report.html", "evalkit.design",
    ]  # fmt: skip
