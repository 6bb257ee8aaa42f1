"""A whole comparison in a known map that lies in a bag, from the experiment file to the scores."""

import json

import numpy as np
from typer.testing import CliRunner

from evalkit.cli import app
from evalkit.commands.export.mcap import MessageBuilder, write_bag
from evalkit.core.grid import OccupancyGrid

EXPERIMENT = """
mapper.scans = 4

[[method]]
use = "wheel-odometry"

[[sequence]]
use = "straight"
scans = 12
map = "room?map=/map"
map_start = "1,0,0"
"""


def test_a_comparison_in_the_map_of_a_bag_tracks_from_its_start(tmp_path, monkeypatch, strangers, scoring_in_threads):
    """The box of the sequence, from 0 to 8 m and -2 to 2 m, walls one cell thick; the drive starts at x = 1 m."""
    monkeypatch.chdir(tmp_path)
    log_odds = np.full((82, 162), -3.0, dtype=np.float32)
    log_odds[[0, -1]], log_odds[:, [0, -1]] = 3.0, 3.0
    grid = OccupancyGrid(log_odds, log_odds != 0.0, 0.05, -0.05, -2.05)
    builder = MessageBuilder()
    write_bag(tmp_path / "room", builder, [(10**9, "/map", builder.grid(10**9, grid))])
    (tmp_path / "map.toml").write_text(EXPERIMENT)
    ended = CliRunner().invoke(app, ["compare", "map.toml", "--out", "out", "--no-page", "--accuracy-only"])
    assert ended.exit_code == 0, ended.output
    (run,) = (tmp_path / "out" / "runs").iterdir()
    assert json.loads((run / "request.json").read_text())["dataset_parameters"]["map"] == f"{tmp_path}/room?map=/map"
    scored = json.loads((run / "scores.json").read_text())
    np.testing.assert_allclose(scored["world_from_start"], [1.0, 0.0, 0.0], atol=0.025)  # found to half a cell
    assert scored["alignment"].startswith("none, because the ground truth is in the frame of the known map, over ")
