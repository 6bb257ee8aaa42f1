"""Pairs of nearby scans of a data set, with relative poses from ground truth or relations."""

from dataclasses import replace

import numpy as np
import pytest

from evalkit.commands.basin import sequences
from evalkit.commands.basin.sequences import PairSource, load_pairs
from evalkit.commands.basin.trials import TrialPlan
from evalkit.core.errors import BadData, BadParameter, UnknownName
from evalkit.core.ground_truth import Relations, Truth
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.core.trajectory import Trajectory
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import DatasetSpec

STEP_M = 0.08
STAMPS = np.arange(60) * 100_000_000


class Drive:
    """A robot that drives 8 cm per scan towards a wall 8 m ahead of its start, in a corridor 3 m wide."""

    def __init__(self, knows="truth", still=False):
        self._knows, self._step = knows, 0.0 if still else STEP_M

    def notes(self):
        return {}

    def __len__(self):
        return len(STAMPS)

    def frames(self):
        angles = np.linspace(-1.5, 1.5, 121)
        for index, stamp in enumerate(STAMPS.tolist()):
            ahead = (8.0 - self._step * index) / np.cos(angles)
            aside = 1.5 / np.maximum(np.abs(np.sin(angles)), 1e-9)
            yield Frame(Scan(stamp, np.minimum(ahead, aside), angles, 0.1, 20.0))

    def truth(self):
        path = np.stack([self._step * np.arange(60.0), np.zeros(60), np.zeros(60)], axis=1)
        if self._knows == "truth":
            return Truth("exact", Trajectory(STAMPS, path))
        if self._knows == "nothing":
            return Truth("none")
        rows = np.array([[2 * STEP_M, 0.0, 0.0], [40 * STEP_M, 0.0, 0.0], [STEP_M, 0.0, 0.0]])
        return Truth("measured", None, Relations(STAMPS[[3, 3, 10]], STAMPS[[5, 43, 11]] + [0, 0, 50_000_000], rows))


@pytest.fixture
def recorded(monkeypatch):
    parameters = (Parameter("knows", "truth", "", ""), Parameter("still", False, "", ""))
    spec = DatasetSpec(Drive, "a drive", "", "exact", "", "", parameters=parameters)
    monkeypatch.setattr(sequences.registry, "dataset", lambda name: spec if name == "drive" else _unknown(name))
    sequences._load_pairs.cache_clear()
    yield PairSource.of
    sequences._load_pairs.cache_clear()


def _unknown(name):
    raise UnknownName("dataset", name, ["drive"])


def test_both_scans_fit_the_same_walls_with_the_true_motion(recorded):
    pairs = load_pairs(recorded("drive"), 6)
    assert len(pairs) == 6
    for pair in pairs[:-1]:  # the last one starts where the drive ends
        assert pair.target_from_source.row == pytest.approx([3 * STEP_M, 0.0, 0.0])  # the next would be beyond 0.3 m
        in_target = pair.target_from_source.transform(pair.source.points)
        wall = np.abs(in_target[:, 1]) < 1.4
        assert np.ptp(in_target[wall, 0]) < 1e-9
        assert in_target[wall, 0][0] == pytest.approx(pair.target.points[np.abs(pair.target.points[:, 1]) < 1.4][0, 0])
        assert np.abs(np.abs(pair.normals).max(axis=1) - 1.0).max() < 0.3  # along x or along y, except in a corner


def test_relations_that_are_too_long_or_between_scans_make_no_pair(recorded):
    (pair,) = load_pairs(recorded("drive knows=relations"), 6)
    assert pair.target_from_source == Pose(2 * STEP_M, 0.0, 0.0)
    assert pair.world_from_target == Pose()


def test_trials_cycle_through_the_pairs(recorded):
    asked = recorded("drive knows=relations")
    trials = TrialPlan(asked.label, 10, 6, 0, 0.02, 1.0, 0.5, 0, asked.data)
    true, _ = trials.truths(trials.pairs_of_scans())
    assert true == pytest.approx(np.tile([2 * STEP_M, 0.0, 0.0], (10, 1)))
    assert "a drive" in trials.what
    assert (replace(trials, seed=1).pairs_of_scans()[0].source.points == trials.pairs_of_scans()[0].source.points).all()


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("drive knows=nothing", BadData, "it has no two scans close together with a known motion"),
        ("drive still=true", BadData, "it has no two scans close together"),
        ("drive fast", BadParameter, "expected NAME=VALUE after the name of the data set"),
        ("drove", UnknownName, "no dataset named 'drove'"),
    ],
)
def test_invalid_scenes_are_rejected(recorded, text, error, message):
    with pytest.raises(error, match=message):
        load_pairs(recorded(text), 6)
