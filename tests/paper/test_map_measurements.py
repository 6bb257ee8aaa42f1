"""The map measurements of the paper's page: short drives with known results."""

import numpy as np
import pytest

from evalkit.plugins import registry
from evalkit.report.html.blocks import Document, render
from evalkit_paper import map_chapter, map_measurements
from evalkit_paper.map_study import describe_variant

LAPS = 0.05
SETTINGS = {"worlds": "lab", "seeds": 2, "laps": 0.1, "interactions": True}


@pytest.fixture(scope="module")
def sequence():
    return map_measurements.make_drive("lab", 0, LAPS)


def test_every_map_is_measured_once_with_the_settings_of_the_paper_first():
    variants = map_measurements.variants(True)
    assert variants[0] == {}
    words = [describe_variant(variant) for variant in variants]
    assert len(set(words)) == len(words)
    assert words[0] == "paper's settings"
    assert all({} in map(map_measurements.departures, own) for own in map_measurements.factors().values())


def test_the_defaults_equal_those_of_the_mapper():
    own = {parameter.name: parameter.default for parameter in registry.mapper("log-odds").parameters}
    assert {name: map_measurements.DEFAULT[name] for name in own} == own


def test_scans_are_spread_over_the_whole_drive(sequence):
    placed = sequence.select_scans(5)
    stamps = [scan.stamp_ns for scan, _ in placed]
    assert len(stamps) == 5
    assert (stamps[0], stamps[-1]) == (sequence.frames[0].scan.stamp_ns, sequence.frames[-1].scan.stamp_ns)
    assert len(sequence.select_scans(10_000)) == len(sequence.frames)


def test_deskewing_with_true_poses_puts_noise_free_hits_on_the_walls():
    silent = map_measurements.make_drive("lab", 0, LAPS, noise_m=0.0, dropout=0.0)
    scan, world_from_sensor = silent.select_scans(3)[1]
    hits = map_measurements.se2.transform(world_from_sensor, scan.points())
    walls = silent.true.centres(silent.true.occupied())
    assert (
        map_measurements.nearest_distances_m(hits, walls).max() < 0.05
    )  # half a cell diagonal and the grid of the true map
    kept, _ = silent.select_scans(3, deskewed=False)[1]
    assert not np.allclose(kept.points(), scan.points(), atol=1e-3)


def test_noise_free_ranges_give_hardly_any_false_walls():
    found = map_measurements.measure_maps("lab", 0, LAPS, "true", [{}], {"noise_m": 0.0})
    assert found["precision"][0, map_measurements.DEFAULT_THRESHOLD] > 0.98
    assert found["ate_m"] == 0.0


def test_the_cost_of_estimated_poses_is_reported():
    assert 0.0 < map_measurements.measure_maps("lab", 0, LAPS, "estimated", [{}])["ate_m"] < 0.05


def test_zero_drift_changes_nothing_and_more_drift_moves_walls_further():
    found = map_measurements.measure_drift("lab", 0, LAPS, [0.0, 0.1, 0.4], [0.0, 4.0])
    assert found["metres"][0].tolist() == found["degrees"][0].tolist()
    distances = found["metres"][:, map_measurements.DRIFT_MEASURES.index("mean distance to wall")]
    assert (np.diff(distances) > 0).all()


def test_both_mappers_give_the_same_map():
    if registry.mapper("embedded-log-odds").missing():
        pytest.skip("the compiled core was not built")
    found = map_measurements.compare_mappers("lab", 0, LAPS, [{}, {"l_free": -0.405}])
    assert found["log_odds"] < 1e-4
    assert found["observed by one only"] == 0
    assert not map_measurements.is_compiled({"traversal": "bresenham"})


def make_result(task):
    """Return a synthetic result with all fields."""
    rng = np.random.default_rng(0)
    asked = task.arguments
    if task.function.__name__ == "measure_maps":
        shape = (len(asked["variants"]), len(map_measurements.THRESHOLDS))
        names = [map_measurements.COMPILED[not map_measurements.is_compiled(v)] for v in asked["variants"]]
        thresholded = {name: rng.uniform(0.5, 0.9, shape) for name in map_measurements.MEASURES[:5]}
        plain = {name: rng.uniform(0.1, 0.2, shape[0]) for name in map_measurements.MEASURES[5:]}
        return thresholded | plain | {"ate_m": 0.01, "mappers": names}
    if task.function.__name__ == "measure_drift":
        return {key: rng.uniform(0.5, 1.0, (len(asked[key]), 6)) for key in ("metres", "degrees")}
    if task.function.__name__ == "render_maps":
        grids = {str(n): np.zeros((4, 5), dtype=np.uint8) for n in range(len(asked["variants"]))}
        return grids | {"extents": np.tile([0.0, 1.0, 0.0, 0.8], (4, 1)), "walls": np.zeros((3, 2)), "ate_m": 0.01}
    return {"log_odds": 1e-6, "cells": 1000, "observed by one only": 0}


@pytest.mark.parametrize("changed", [{}, {"seeds": 1, "interactions": False}])
def test_the_chapter_is_rendered_for_any_result(changed):
    settings = map_chapter.CHAPTER.settings("test", SETTINGS | changed)
    tasks = map_chapter.CHAPTER.tasks(settings)
    assert len({task.name for task in tasks}) == len(tasks)
    results = {task.name: make_result(task) for task in tasks}
    (section,) = map_chapter.CHAPTER.sections(settings, results)
    page = render(Document("test", "test", "", (section,)))
    assert "recommended" in page
    assert {finding.anchor for finding in map_chapter.CHAPTER.findings(settings, results)} == {section.target}
