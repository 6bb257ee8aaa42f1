"""External maps as methods: compared with the true map as they are, without a run."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from evalkit import cli
from evalkit.core.errors import BadData
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.external import maps
from evalkit.io.map_server import write_map
from evalkit.plugins import registry
from evalkit.plugins.parameters import resolve_parameters

pytestmark = pytest.mark.usefixtures("scoring_in_threads")

DRIVE = "laps = 0.02\n"
COARSE = "[mapper]\nresolution_m = 0.25\n"


@pytest.fixture
def save_map(tmp_path):
    """Save a map in the format of map_server; returns its method name."""

    def save(grid):
        (tmp_path / "elsewhere").mkdir(exist_ok=True)
        write_map(tmp_path / "elsewhere" / "map", grid)
        return f"file:{tmp_path / 'elsewhere' / 'map.yaml'}"

    return save


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run an experiment with the named methods; returns the exit code and the rows."""

    def call(command, *uses):
        path = tmp_path / "maps.toml"
        methods = "".join(f"[[method]]\nuse = {json.dumps(use)}\n" for use in uses)
        path.write_text(methods + COARSE + f'[[sequence]]\nuse = "room"\n{DRIVE}')
        words = ["evalkit", "compare", *command, str(path), "-o", str(tmp_path / "out"), "-j", "1", "--json"]
        monkeypatch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return ended.value.code, json.loads(capsys.readouterr().out)

    return call


def make_map(name, **given):
    spec = registry.backend(name)
    return spec.make(**resolve_parameters(name, spec.parameters, given))


def wall(shape=(30, 40)):
    log_odds = np.full(shape, -3.5, dtype=np.float32)
    log_odds[:, 10] = 3.5
    return OccupancyGrid(log_odds, np.ones(shape, dtype=bool), 0.1, -1.0, 2.0)


def test_the_true_map_has_a_perfect_score_and_no_trajectory_metrics(save_map, run):
    drive = {p.name: p.default for p in registry.dataset("room").parameters} | {"laps": 0.02}
    use = save_map(registry.dataset("room").make(**drive).truth().grid)
    code, answer = run([], "wheel-odometry", use, f"{use} x_m=0.5")
    _, theirs, shifted = answer["runs"]
    assert (code, theirs["status"]) == (0, "complete")
    found = theirs["scores"]
    assert found["map_f1"] == found["map_iou"] == 1.0
    assert found["map_coverage_percent"] == pytest.approx(100.0)
    assert found["corners"] is not None
    for name in ("ate_rmse_m", "rpe_trans_m", "map_entropy", "wall_thickness_m", "wall_median_ms", "answered_percent"):
        assert found.get(name) is None
    assert shifted["scores"]["map_f1"] < 0.5
    page = Path(answer["page"]).read_text(encoding="utf-8")
    assert "no trajectory: the back end is a map made elsewhere" in page
    assert "a map from another program is compared with the ground truth as it is" in page


def test_settings_place_the_map_in_the_world_frame(save_map):
    grid = make_map(save_map(wall()), x_m=3.0, y_m=-2.0)
    assert (grid.origin_x, grid.origin_y) == (2.0, 0.0)
    assert np.array_equal(grid.occupied(), wall().occupied())


def test_a_quarter_turn_rotates_every_cell():
    grid = maps.transform_map(wall(), Pose(0.0, 0.0, np.pi / 2))
    walls = grid.centres(grid.occupied())
    assert len(walls) == 30
    assert walls[:, 1] == pytest.approx(np.full(30, 0.05), abs=0.051)  # x = 0.05 becomes y = 0.05
    assert walls[:, 0].min() == pytest.approx(-4.95, abs=0.051)
    assert grid.observed.sum() == 30 * 40


def test_a_slanted_map_keeps_its_walls_within_a_cell():
    world_from_map = Pose(1.0, -2.0, 0.3)
    grid = maps.transform_map(wall(), world_from_map)
    back = world_from_map.inverse().transform(grid.centres(grid.occupied()))
    assert np.abs(back[:, 0] - 0.05).max() < 0.0501
    assert len(back) == pytest.approx(30, abs=3)
    assert grid.observed.sum() == pytest.approx(30 * 40, rel=0.01)


def test_a_missing_map_or_image_is_unavailable_and_a_damaged_one_fails(save_map, run, tmp_path):
    use = save_map(wall())
    image = tmp_path / "elsewhere" / "map.pgm"
    image.write_bytes(b"P5 3 2 255\n\0")
    code, answer = run(["--no-page"], use, "file:nowhere.yaml")
    damaged, absent = answer["runs"]
    assert (code, damaged["status"], absent["status"]) == (1, "failed", "not-installed")
    assert "1 pixels for 3 x 2" in damaged["reason"]
    image.unlink()
    assert registry.backend(use).missing() == "no such file: map.pgm; correct its path"
    (tmp_path / "elsewhere" / "map.yaml").write_text("words")
    with pytest.raises(BadData, match="no keys"):
        make_map(use)


def test_the_cache_key_contains_the_content_of_the_image(save_map):
    use = save_map(wall())
    before = registry.hash_run_code(use, "room")
    assert before == registry.hash_run_code(use, "room")
    save_map(wall((31, 40)))
    assert registry.hash_run_code(use, "room") != before
