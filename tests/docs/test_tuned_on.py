"""``tuned_on`` of the SLAMs agrees with the pages that state what their rules were chosen on."""

import re
from pathlib import Path

import pytest

from evalkit.config.experiment_file import load_experiment
from evalkit.plugins import registry

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "pages"


@pytest.mark.parametrize("page", ["loop-closure-rules.md", "loop-closure-dropped.md"])
def test_every_data_set_that_chose_a_rule_of_the_slam_is_in_its_tuned_on(page):
    text = (PAGES / page).read_text(encoding="utf-8")
    named = {name for name in registry.names("datasets") if re.search(rf"`{name}[`-]", text)}
    named |= {name for name in ("fr079", "intel") if name in text}
    assert {"room", "office", "fr079", "intel"} < named
    for method in ("paper-slam", "embedded-slam"):
        assert named <= set(registry.backend(method).tuned_on)


def test_what_was_chosen_on_a_recording_and_does_not_count_is_stated_where_tuning_is():
    """KISS-ICP is ranked on intel, where its range was chosen, and each registration where its distance was chosen."""
    tuning = pytest.importorskip("evalkit_docs.tuning_reference", reason="the documentation is not part of a wheel")
    kiss = registry.backend("kiss-icp")
    ranges = {one.name: one.default for one in kiss.parameters}
    assert (ranges["max_range_m"], ranges["voxel_size_m"], kiss.tuned_on) == (12.0, 0.12, ())
    for page in (tuning.write_tuning(), (ROOT / "baselines" / "README.md").read_text(encoding="utf-8")):
        assert re.search(r"KISS-ICP's longest range[\w ,]* 12 m rather than 30 m,\s[\w ]*chosen on `?intel", page)
        assert "0.12, 0.2, 0.3 and 0.5 m on the same runs" in page
    counted = load_experiment(ROOT / "reports" / "default.toml")
    assert not {"fr079", "intel"} & {name for one in counted.methods if one.label in ("paper", "open3d-plane keyframes")
                                     for name in one.tuned_on}  # fmt: skip
    assert "does not count as such a setting: all methods had the same choice of it, on fr079, intel" in (
        counted.description
    )
