"""The study chapter of the paper's page, with a study of one second."""

import pytest

from evalkit.core.errors import BadExperiment
from evalkit.plugins import registry
from evalkit_paper.study_chapter import CHAPTER, MAP_CHAPTER, compare_poses

STUDY = """
title = "A small study"
description = "Nothing to learn here."
method = { use = "embedded", epsilon = 1e-3 }
sequence = { use = "lab", laps = 0.03, speed_mps = 0.6 }
mapper.scans = 4
response = [{ metric = "ate_rmse_m", scale = "log", lost = 0.5 }]
envelope = [{ design = "driven", x = "speed", y = "rate", metric = "ate_rmse_m", limit = 0.2 }]
factor = [
    { name = "speed", sets = "sequence.speed_mps", levels = [0.6, 1.2], unit = "m/s" },
    { name = "rate", sets = "sequence.rate_hz", levels = [10.0, 15.0], unit = "Hz" },
    { name = "pairs", sets = "method.one_to_one", levels = [true, false] },
]
design = [{ name = "driven", kind = "grid", factors = ["speed", "rate", "pairs"] }]
"""

needs_core = pytest.mark.skipif(bool(registry.backend("embedded").missing()), reason="the compiled core is not here")


@pytest.fixture
def settings(tmp_path):
    file = tmp_path / "study.toml"
    file.write_text(STUDY)
    return CHAPTER.settings("paper.toml: [study]", {"file": str(file), "comparisons": 1, "comparison_scans": 3})


@needs_core
def test_the_chapter_reports_the_results_of_its_tasks(settings):
    tasks = CHAPTER.tasks(settings)
    assert len(tasks) == 8 + 1
    found = {
        task.name: {"apart_m": 1e-12, "apart_rad": 0.0, "scans": 3}
        if task.name.startswith("comparison")
        else {"status": "complete", "reason": "", "scores": {"ate_rmse_m": 0.1}, "why": {}, "cpu_s": 0.5}
        for task in tasks
    }
    first, *rest = CHAPTER.sections(settings, found)
    words = " ".join(block.body for block in first.blocks if block.kind == "text")
    assert "8 points in 1 designs, 8 runs in 0.1 minutes of CPU; 0 runs failed" in words
    assert "At 1 points of the designs, over 3 scans" in words
    assert "1.0e-12 m apart" in words
    assert [section.anchor for section in rest] == ["study-summary", "study-design", "study-envelope", "study-points"]
    study, slow, fast = CHAPTER.findings(settings, found)
    assert study.judgement.verdict == "not reproduced"  # all values are equal
    assert "pairs on: up to 1.2 m/s and 15 Hz, the largest levels tested (4 of 4 drives)" in slow.measured
    assert (slow.judgement.verdict, fast.judgement.verdict) == ("reproduced", "not reproduced")  # none is too fast


@needs_core
def test_core_and_reference_give_the_same_poses_with_the_same_parameters():
    found = compare_poses(
        ("paper", "embedded"), {"epsilon": 1e-5, "one_to_one": False}, "lab", {"laps": 0.03, "seed": 1}, 5
    )
    assert found["scans"] == 5
    assert found["apart_m"] < 1e-9
    assert found["apart_rad"] < 1e-9


def test_the_map_chapter_judges_the_levels_of_its_factors():
    settings = MAP_CHAPTER.settings("paper.toml: [maps]", {"file": "reports/study-maps-quick.toml"})
    f1 = {"exact": 0.9, "bresenham": 0.7}
    results = {
        task.name: {"status": "complete", "reason": "", "why": {}, "cpu_s": 0.5, "scores": {
            "map_f1": f1[task.arguments["mapper_parameters"]["traversal"]], "map_log_loss": 0.1}}
        for task in MAP_CHAPTER.tasks(settings)
    }  # fmt: skip
    cells, choices = MAP_CHAPTER.findings(settings, results)
    assert cells.judgement.verdict == "not reproduced"  # the same F1 at every cell size
    assert choices.judgement.why == "the map depends on traversal"
    assert "traversal: F1 0.700 to 0.900" in choices.measured
    assert [section.anchor for section in MAP_CHAPTER.sections(settings, results)][:2] == ["maps", "maps-design"]


def test_a_missing_study_is_reported(tmp_path):
    settings = CHAPTER.settings("paper.toml: [study]", {"file": str(tmp_path / "none.toml")})
    with pytest.raises(BadExperiment, match=r"none\.toml: no such file"):
        CHAPTER.tasks(settings)
