"""The table of matchers marks the errors on data that settings of a method were chosen on."""

import re
from pathlib import Path

import pytest

from evalkit.config.experiment_file import load_experiment

ROOT = Path(__file__).parents[2]


@pytest.mark.checkout
def test_a_star_marks_each_error_on_data_that_a_method_was_tuned_on():
    tuned_on = {method.label: method.tuned_on for method in load_experiment(ROOT / "reports/matchers.toml").methods}
    rows = re.findall(r"^\| (`.*) \|$", (ROOT / "docs/pages/which-matcher.md").read_text(encoding="utf-8"), re.M)
    marked, expected = set(), set()
    for name, *cells in (row.split(" | ") for row in rows):
        label = name.replace("`", "").replace(",", "").replace("embedded-map-line", "embedded-line")
        for data_set, cell in zip(("random-office", "random-home", "random-warehouse", "fr079"), cells, strict=False):
            if re.match(r"[*]*\d", cell):
                marked |= {(label, data_set)} if cell.endswith(" *") else set()
                expected |= {(label, data_set)} if data_set in tuned_on[label] else set()
    assert len(rows) == len(tuned_on)
    assert marked == expected
