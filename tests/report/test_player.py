"""The player's data: positions as in the run, size within the budget, and reproducible bytes."""

import json
from dataclasses import replace

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.run_result import NO_STEPS
from evalkit.core.scan import Frame, Scan
from evalkit.report.html import player as module
from evalkit.report.html.array_encoding import unpack_array
from evalkit.report.html.maps import MapWindow
from evalkit.report.html.method_colours import assign_strokes
from evalkit.report.html.player import build_player, choose_scans, motion_disagreement, ranges_per_sequence
from evalkit.report.html.shown_scans import load_beams, place_hits

WINDOW = MapWindow(0.0, 12.0, 0.0, 8.0)


class Wall:
    """60 scans of 9 beams that all hit a wall 2 m ahead of the sensor, which is mounted 10 cm ahead of the base."""

    def __len__(self):
        return 60

    def frames(self):
        angles = np.linspace(-0.4, 0.4, 9)
        for index in range(60):
            yield Frame(Scan(index * 100_000_000, 2.0 / np.cos(angles), angles, 0.1, 8.0), Pose(0.1, 0.0, 0.0))


class Broken(Wall):
    def frames(self):
        raise OSError("no such disk")


def lines(records):
    return assign_strokes([record.method for record in records])


@pytest.fixture
def runs(record):
    return [record(name, "room", {}, error_m=error) for name, error in (("a", 0.02), ("b", 0.3))]


def content(made):
    return json.loads(made.content)


def test_a_wall_ahead_is_drawn_at_the_position_given_by_the_pose():
    stamps = np.array([0, 100_000_000])
    beams = load_beams(Wall(), stamps, 10_000)
    points = place_hits(beams, np.array([[1.0, 5.0, np.pi / 2], [4.0, 0.0, 0.0]]), stamps)
    assert np.abs(points[0, :, 1] - 7.1).max() < 1e-3  # facing +y: 5 + 0.1 + 2
    assert np.abs(points[1, :, 0] - 6.1).max() < 1e-3
    assert points[1, 4] == pytest.approx([6.1, 0.0], abs=1e-3)


def test_the_motion_within_a_scan_is_corrected():
    stamps = np.array([0, 100_000_000])
    beams = replace(load_beams(Wall(), stamps, 10_000), sweep=np.array([100, 100], dtype=np.int32))
    points = place_hits(beams, np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), stamps)
    assert points[0, :, 0] == pytest.approx(2.1 + np.linspace(0.0, 1.0, 9), abs=1e-3)
    assert points[1, :, 0] == pytest.approx(3.1 + np.linspace(0.0, 1.0, 9), abs=1e-3)


def test_a_drawn_point_has_an_error_below_two_millimetres(runs):
    stamps = runs[0].result.steps["stamp_ns"]
    made = content(build_player(runs, Wall, WINDOW, lines(runs)))
    poses = unpack_array(made["runs"][0]["poses"], (60, 3)) * [1e-3, 1e-3, 1e-5]
    drawn = place_hits(load_beams(Wall(), stamps, 10**6), poses, stamps)
    for row, frame in enumerate(Wall().frames()):
        exact = module.world_poses(runs[0], stamps)[row]
        points = se2.transform(se2.compose(exact, frame.base_from_sensor.row), frame.scan.points())
        assert np.linalg.norm(drawn[row] - points, axis=1).max() < 2e-3


def test_the_number_of_ranges_is_within_the_budget_and_the_beams_have_no_gap():
    beams = load_beams(Wall(), np.arange(60) * 100_000_000, 60 * 3)
    assert beams.ranges.shape == (60, 3)
    assert beams.every == 3
    assert beams.angles[0].tolist() == [-40000, -10000, 20000]


def test_many_sequences_share_the_budget_of_the_page():
    assert ranges_per_sequence(1) == ranges_per_sequence(2) == module.MAX_RANGES
    assert ranges_per_sequence(20) * 20 == module.MAX_ON_PAGE


def test_a_single_jump_survives_thinning():
    poses = np.zeros((2, 10_000, 3))
    poses[0, :, 0] = 0.01 * np.arange(10_000)
    poses[1] = poses[0]
    poses[1, 4321:, 1] += 0.5
    apart = motion_disagreement(poses)
    rows = choose_scans(apart, 200)
    assert apart[4321] == pytest.approx(0.5)
    assert np.delete(apart, 4321).max() < 1e-9
    assert len(rows) == 200
    assert {0, 4321, 9999} <= set(rows.tolist())
    assert (np.diff(rows) > 0).all()


def test_few_scans_are_all_kept():
    assert choose_scans(np.zeros(7), 10).tolist() == [0, 1, 2, 3, 4, 5, 6]


def test_the_same_runs_give_identical_bytes(runs):
    made = [build_player(runs, Wall, WINDOW, lines(runs)) for _ in range(2)]
    assert made[0] == made[1]


def test_a_run_that_ended_early_has_no_pose_after_its_end(record):
    whole = record("a", "room", {})
    short = record("b", "room", {}, status="crashed", reason="signal 11", answered=31)
    made = content(build_player([whole, short], None, WINDOW, lines([whole, short])))
    poses = unpack_array(made["runs"][1]["poses"], (60, 3))
    assert (poses[:31] > module.NONE).all()
    assert (poses[31:] == module.NONE).all()
    errors = unpack_array(made["runs"][1]["error"], (60,)) * 1e-4
    assert errors[:31] == pytest.approx(short.scores.errors_m, abs=0.5e-4)


def test_diverged_or_nan_poses_are_missing(runs):
    steps = runs[1].result.steps.copy()
    steps["x"][7], steps["y"][8], steps["theta"][9] = np.inf, np.nan, 1e9
    gone = replace(runs[1], result=replace(runs[1].result, steps=steps))
    made = content(build_player([runs[0], gone], Wall, WINDOW, lines(runs)))
    poses = unpack_array(made["runs"][1]["poses"], (60, 3))
    assert np.flatnonzero((poses == module.NONE).all(axis=1)).tolist() == [7, 8, 9]


def test_an_unreadable_recording_keeps_the_paths_and_gives_a_reason(runs):
    made = build_player(runs, Broken, WINDOW, lines(runs))
    assert content(made)["beams"] is None
    assert "no such disk" in made.remarks


def test_a_map_without_a_path_is_shown_with_its_ghosts(runs):
    log_odds = np.full((40, 40), -3.5, dtype=np.float32)
    log_odds[:, 10] = 3.5
    true = OccupancyGrid(log_odds, np.ones((40, 40), dtype=bool), 0.1, 0.0, 0.0)
    there = [replace(run, truth=replace(run.truth, grid=true)) for run in runs]
    shifted = OccupancyGrid(log_odds, np.ones((40, 40), dtype=bool), 0.1, 1.0, 0.0)
    spec = replace(there[0].spec, method=replace(there[0].spec.method, label="theirs"))
    result, scores = replace(there[0].result, steps=NO_STEPS), replace(there[0].scores, grid=shifted)
    alone = replace(there[0], spec=spec, result=result, scores=scores)
    made = build_player([*there, alone], None, WINDOW, lines([*there, alone]))
    (theirs,) = content(made)["maps"]
    cells = unpack_array(theirs["ghosts"], (40, 2)) * 1e-3
    assert (made.methods, made.maps) == (("a", "b"), ("theirs",))
    assert "Maps without a path: theirs." in made.remarks
    assert cells[:, 0] == pytest.approx(2.05)  # the wall of the column at 1.0 to 1.1 m, one metre off
    assert build_player([alone], None, WINDOW, lines([alone])) is None


def test_a_run_without_answers_is_not_shown(record):
    absent = record("c", "room", {}, status="not-installed", reason="no module", answered=0)
    assert build_player([absent], None, WINDOW, lines([absent])) is None
    present = record("a", "room", {}, truth=False)
    made = build_player([present, absent], None, None, lines([present, absent]))
    assert made.methods == ("a",)
    assert content(made)["truth"] is None
    assert content(made)["runs"][0]["error"] is None


class Noisy:
    """3000 scans of 360 beams with 5 cm of noise, which compress badly."""

    def __len__(self):
        return 3000

    def frames(self):
        rng, angles = np.random.default_rng(0), np.linspace(-np.pi, np.pi, 360, endpoint=False)
        for index in range(3000):
            ranges = 5.0 + 3.0 * np.sin(3.0 * angles + 0.01 * index) + rng.normal(0.0, 0.05, 360)
            yield Frame(Scan(index * 100_000_000, ranges, angles, 0.1, 12.0))


def test_twenty_runs_on_twenty_sequences_stay_within_eight_megabytes(record):
    run = record("a", "room", {}, answered=3000, expected=3000)
    made = build_player([run], Noisy, WINDOW, lines([run]), ranges_per_sequence(20))
    assert len(made.content) * 20 < 6e6  # the rest is for drawings, maps and tables
    assert made.remarks.startswith("1,000 of 3,000 scans")
    assert "One beam in 12 is shown." in made.remarks
