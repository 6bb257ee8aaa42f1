"""The chapter on the claims of the paper: drift over the path length, and the effect of pedestrians."""

import numpy as np
import pytest

from evalkit_paper import claims_chapter, long_drives


def test_error_free_wheels_stay_on_the_path(monkeypatch):
    found = long_drives.error_over_path("wheel-odometry", {}, "lab", 0, 0.1, 8)
    assert found["path_m"].shape == (8,)
    assert found["path_m"] == pytest.approx(found["path_m"][-1] * np.arange(1, 9) / 8, abs=0.05)
    assert found["end_m"][0] < 0.1


def test_the_mean_error_up_to_a_mark_includes_all_scans_before_it():
    found = long_drives.error_over_path("wheel-odometry", {}, "lab", 1, 0.1, 200)
    assert found["rmse_m"][0] <= found["end_m"][:3].max() + 1e-9
    assert found["rmse_m"][-1] <= found["end_m"].max()
    assert found["rmse_m"][-1] >= found["end_m"].min()


@pytest.fixture
def settings():
    return claims_chapter.CHAPTER.settings("t", {"seeds": 2, "laps": 2.0})


def make_results(settings, percent):
    """Return results in which every method drifts by a given percentage, and pedestrians cost 1 cm each."""
    way = np.linspace(1.0, 100.0, claims_chapter.MARKS)
    results = {}
    for task in claims_chapter.CHAPTER.tasks(settings):
        if task.function.__name__ == "error_over_path":
            share = percent[task.name.partition(" | ")[0]] / 100.0
            results[task.name] = {"path_m": way, "end_m": share * way, "rmse_m": share * way}
        else:
            people = task.arguments["people"]
            results[task.name] = {"scores": {"ate_rmse_m": 0.01 * people, "map_f1": 0.9, "map_entropy": 0.1}}
    return results


@pytest.mark.parametrize(
    ("literal", "reading", "verdict"),
    [
        (0.5, 0.2, "reproduced"),
        (3.0, 0.2, "reproduced with a correction"),
        (3.0, 1.5, "not determined by the text"),
    ],
)
def test_the_verdict_follows_the_measured_values(settings, literal, reading, verdict):
    wheels, printed, read, tight = (entry.label for entry in claims_chapter.ENTRIES)
    results = make_results(settings, {wheels: 5.0, printed: literal, read: reading, tight: 0.1})
    loops, crowd = claims_chapter.CHAPTER.findings(settings, results)
    assert loops.verdict == verdict
    assert f"{read}: {reading:.2f} ({reading:.2f} to {reading:.2f}) %" in loops.measured
    assert "with 10 people in the lab ATE RMSE 0.100 m against 0.000 m without people" in crowd.measured


def test_a_drift_proportional_to_the_path_grows_with_exponent_one(settings):
    results = make_results(settings, {entry.label: 1.0 for entry in claims_chapter.ENTRIES})
    section = claims_chapter.CHAPTER.sections(settings, results)[0]
    (table,) = (block for block in section.blocks if block.kind == "table")
    assert all(row[-1].text == "1.0" for row in table.rows)
    assert {row[3].text for row in table.rows} == {"1.00"}
