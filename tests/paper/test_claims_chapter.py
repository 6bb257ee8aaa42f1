"""The chapter on the claims of the paper: drift over the path length, and the effect of pedestrians."""

import numpy as np
import pytest

from evalkit.core.errors import BadParameter
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
    return claims_chapter.CHAPTER.settings("t", {"seeds": 2, "map_seeds": 3, "laps": 2.0})


def make_results(settings, percent):
    """Return results in which methods drift by given percentages, and every changed map is worse."""
    way = np.linspace(1.0, 100.0, claims_chapter.MARKS)
    results = {"map updates": {"log-odds": 1.0}}
    for task in claims_chapter.CHAPTER.tasks(settings):
        if task.function.__name__ == "error_over_path":
            share = percent[task.name.partition(" | ")[0]] / 100.0
            results[task.name] = {"path_m": way, "end_m": share * way, "rmse_m": share * way}
        elif task.function.__name__ == "score_drive":
            worse = 0.01 * (task.name.partition(" | ")[0] != claims_chapter.PLAIN.name)
            scores = {
                "ate_rmse_m": 0.01 + worse,
                "map_f1": 0.9 - worse,
                "map_precision": 0.9 - worse,
                "map_entropy": 0.1,
            }
            results[task.name] = {"scores": scores}
    return results


@pytest.mark.parametrize(
    ("literal", "reading", "verdict"),
    [(0.5, 0.2, "reproduced"), (3.0, 0.2, "reproduced with a correction"), (3.0, 1.5, "not reproduced")],
)
def test_the_verdict_follows_the_measured_values(settings, literal, reading, verdict):
    wheels, printed, read, tight = (entry.name for entry in claims_chapter.ENTRIES)
    results = make_results(settings, {wheels: 5.0, printed: literal, read: reading, tight: 0.1})
    loops, *others = claims_chapter.CHAPTER.findings(settings, results)
    assert loops.judgement.verdict == verdict
    assert f"{read}: {reading:.2f} ({reading:.2f} to {reading:.2f}) %" in loops.measured
    found = {finding.item: finding.judgement.verdict for finding in others}
    assert found.pop("A local radius reduces artefacts of the map") == "not reproduced"  # its map is worse here
    assert set(found.values()) == {"reproduced"}


def test_one_lap_is_one_lap(settings):
    way = np.array([0.0, 30.0, 80.0])
    assert claims_chapter._after_one_lap({"laps": 2.0}, way, np.array([[0.0, 3.0, 8.0]])).tolist() == [4.0]
    with pytest.raises(BadParameter, match="laps"):
        claims_chapter.CHAPTER.settings("t", {"laps": 0.5})


def test_a_drift_proportional_to_the_path_grows_with_exponent_one(settings):
    results = make_results(settings, {entry.name: 1.0 for entry in claims_chapter.ENTRIES})
    section = claims_chapter.CHAPTER.sections(settings, results)[0]
    (table,) = (block for block in section.blocks if block.kind == "table")
    assert all(row[-1].text == "1.0" for row in table.rows)
    assert {row[3].text for row in table.rows} == {"1.00"}
