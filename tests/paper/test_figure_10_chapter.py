"""The chapter of Figure 10: injected map faults and known places."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.plugins import registry
from evalkit_paper import figure_10_chapter, map_faults, plan_fit, recorded_drive, stage_errors

SIZE = 40  # cells of 0.1 m


def room(*, walls=(), free=True):
    """Return a square room of 4 m with occupied border cells, and further occupied cells (row, column)."""
    log_odds = np.full((SIZE, SIZE), -3.0 if free else 0.0, dtype=np.float32)
    log_odds[[0, -1], :] = log_odds[:, [0, -1]] = 3.0
    for row, column in walls:
        log_odds[row, column] = 3.0
    return OccupancyGrid(log_odds, np.ones((SIZE, SIZE), dtype=bool), 0.1, 0.0, 0.0)


def test_a_perfect_map_has_no_faults():
    found = map_faults.find_faults(room(), room())
    assert not found.ghosts.any()
    assert not found.smeared.any()
    assert len(found.missing) == 0


def test_a_false_wall_is_a_ghost_and_a_thick_wall_a_smear():
    found = map_faults.find_faults(room(walls=[(20, 20), (20, 21), (2, 10)]), room())
    assert np.argwhere(found.ghosts).tolist() == [[20, 20], [20, 21]]
    assert np.argwhere(found.smeared).tolist() == [[2, 10]]  # 0.2 m off


def test_a_true_wall_on_free_cells_is_missing():
    found = map_faults.find_faults(room(), room(walls=[(20, 20)]))
    np.testing.assert_allclose(found.missing, [[2.05, 2.05]])
    assert len(map_faults.find_faults(room(free=False), room(walls=[(20, 20)])).missing) == 0  # unknown is not missing


def test_adjacent_cells_are_one_fault_with_a_position():
    found = map_faults.find_clusters(np.array([[1.0, 1.0], [1.1, 1.0], [1.2, 1.0], [3.0, 3.0]]), np.array([[1.0, 0.5]]))
    assert [(each.cells, round(each.x, 3), round(each.y, 3)) for each in found] == [(3, 1.1, 1.0), (1, 3.0, 3.0)]
    assert (found[0].extent_m, found[0].wall_distance_m) == (pytest.approx(0.2), pytest.approx(np.hypot(0.2, 0.5)))


def test_hits_in_free_space_of_another_map_are_contradictions():
    hits = np.array([[2.05, 2.05], [0.05, 2.0], [0.12, 2.0], [9.0, 9.0]])
    assert map_faults.find_contradicted(hits, room()).tolist() == [True, False, False, False]


def test_a_cropped_map_is_located_on_its_floor_plan():
    rng = np.random.default_rng(3)
    steps = np.arange(0.0, 6.0, 0.05)
    plan = np.concatenate(
        [
            np.column_stack([steps, np.zeros(120)]),
            np.column_stack([np.zeros(120), 0.7 * steps]),
            np.column_stack([2.0 + 0.3 * steps, 1.5 + 0.4 * steps]),
            np.column_stack([np.full(60, 6.0), 0.5 * steps[:60]]),
        ]
    )
    true = Pose(12.3, -7.4, 2.0)
    cut = plan[np.hypot(plan[:, 0] - 2.0, plan[:, 1] - 1.0) < 3.0]
    found = plan_fit.fit_on_plan(true.inverse().transform(cut + rng.normal(0.0, 0.01, cut.shape)), plan)
    off = true.inverse() @ found.plan_from_map
    assert np.hypot(off.x, off.y) < 0.05
    assert abs(off.theta) < 0.01
    assert found.within > 0.95
    assert found.mean_m < 0.02
    assert found.rival < 0.8


def small_page(settings):
    chosen = figure_10_chapter.CHAPTER.settings("test", settings)
    results = {task.name: task.run()[0] for task in figure_10_chapter.CHAPTER.tasks(chosen)}
    return figure_10_chapter.CHAPTER.sections(chosen, results), figure_10_chapter.CHAPTER.findings(chosen, results)


@pytest.mark.thorough
def test_the_page_shows_plan_and_maps_and_explains_how_to_get_a_missing_recording(monkeypatch):
    monkeypatch.setattr(recorded_drive, "missing", lambda: "not here; fetch it: so and so")
    (lab, recorded), (finding,) = small_page({"laps": 0.1, "scans": 20})
    titles = [figure.title for figure in lab.blocks[1].figures]
    assert titles[1:] == [
        "Along odometry only",
        "Along last 10 scans, mean square",
        "Along paper",
        "Along paper-tight",
    ]
    assert [block.body for block in recorded.blocks] == [
        "The recording is not available on this machine: not here; fetch it: so and so"
    ]
    assert finding.anchor == lab.anchor


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.skipif(bool(recorded_drive.missing()), reason="the recording is not here")
def test_the_best_method_has_fewest_contradictions_and_fits_the_floor_map(monkeypatch):
    known, runs = registry.dataset, {}

    def every_second_scan(name):
        spec = known(name)
        return replace(spec, make=partial(spec.make, every=2)) if name == recorded_drive.RECORDING else spec

    def run_once(sequence, backend, parameters, run=stage_errors.run_with_errors):
        key = (backend, *parameters.items())
        return runs[key] if key in runs else runs.setdefault(key, run(sequence, backend, parameters))

    monkeypatch.setattr(registry, "dataset", every_second_scan)
    monkeypatch.setattr(stage_errors, "run_with_errors", run_once)  # the map and the fit are of the same run
    tasks = recorded_drive.tasks()
    results = {task.name: task.run()[0] for task in tasks}
    shares = [results[recorded_drive.result_name(each)]["contradicted"] for each in recorded_drive.VARIANTS]
    assert shares == sorted(shares, reverse=True)  # odometry, paper, paper-tight
    shown = [block.kind for block in recorded_drive.blocks(results)]
    assert shown[:4] == ["text", "figure", "figures", "table"]
    floor = results[recorded_drive.FLOOR]
    if not floor:
        pytest.skip("the map of the floor is not here")
    assert floor["rival"] < recorded_drive.UNIQUE
    assert np.hypot(*(np.array(floor["pose"]) - floor["odometry"])[:2]) < 1.0
