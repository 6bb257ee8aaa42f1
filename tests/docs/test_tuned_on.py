"""``tuned_on`` of the SLAMs agrees with the pages that state what their rules were chosen on."""

import re
from pathlib import Path

import pytest

from evalkit.plugins import registry

PAGES = Path(__file__).parents[2] / "docs" / "pages"


@pytest.mark.parametrize("page", ["loop-closure-rules.md", "loop-closure-dropped.md"])
def test_every_data_set_that_chose_a_rule_of_the_slam_is_in_its_tuned_on(page):
    text = (PAGES / page).read_text(encoding="utf-8")
    named = {name for name in registry.names("datasets") if re.search(rf"`{name}[`-]", text)}
    named |= {name for name in ("fr079", "intel") if name in text}
    assert {"room", "office", "fr079", "intel"} < named
    for method in ("paper-slam", "embedded-slam"):
        assert named <= set(registry.backend(method).tuned_on)
