"""The keys of a known map: paths are absolute, mistakes are named, and the map is part of a run's key."""

import numpy as np
import pytest

from evalkit.config.experiment_file import experiment_from_tables
from evalkit.core.errors import BadExperiment
from evalkit.core.grid import OccupancyGrid
from evalkit.io.map_server import write_map


def draw(folder, column):
    log_odds = np.full((4, 4), -3.5, dtype=np.float32)
    log_odds[:, column] = 3.5
    write_map(folder / "floor", OccupancyGrid(log_odds, np.ones((4, 4), dtype=bool), 0.05, 0.0, 0.0))


def plan(**keys):
    tables = {"method": [{"use": "wheel-odometry"}], "sequence": [{"use": "room", **keys}]}
    return experiment_from_tables(tables, "here", "name", "compare here")


def test_a_known_map_belongs_to_the_sequence_and_to_the_key_of_its_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    draw(tmp_path, 1)
    without, of_truth = (next(iter(plan(**keys).runs())) for keys in ({}, {"map": "truth"}))
    first = next(iter(plan(map="floor.yaml", map_start="1,2,90", align_truth=True).runs()))
    assert first.dataset_parameters["map"] == str(tmp_path / "floor.yaml")
    assert (first.dataset_parameters["map_start"], first.dataset_parameters["align_truth"]) == ("1,2,90", True)
    assert "map" not in without.dataset_parameters
    (tmp_path / "floor.pgm").write_bytes((tmp_path / "floor.pgm").read_bytes() + b"\n")
    again = next(iter(plan(map="floor.yaml", map_start="1,2,90", align_truth=True).runs()))
    assert len({without.key, of_truth.key, first.key, again.key}) == 4


@pytest.mark.parametrize(
    ("keys", "found"),
    [
        ({"map": "nowhere.yaml"}, "nowhere.yaml"),
        ({"map_start": "1,2,3"}, "'map_start': needs the key 'map'"),
        ({"align_truth": True}, "'align_truth': needs the key 'map'"),
        ({"map": "truth", "map_start": "1,2"}, "x,y,yaw"),
        ({"map": "truth", "align_truth": 1}, "true or false"),
        ({"map": 3}, "a text"),
    ],
)
def test_mistakes_are_named(keys, found):
    with pytest.raises(BadExperiment, match=found):
        plan(**keys)
