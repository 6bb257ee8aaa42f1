"""Pairs of scans of a data set with a known motion, by its true trajectory or by its measured relations."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from evalkit.commands.basin.scenes import NEAR, KnownPair
from evalkit.core import se2
from evalkit.core.arrays import Ints, spread_indices
from evalkit.core.errors import BadData, DataMissing
from evalkit.core.ground_truth import Relations
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.trajectory import MAX_GAP_S, can_interpolate
from evalkit.odometry import planar3d
from evalkit.plugins import registry
from evalkit.plugins.parameter_parsing import parse_dataset
from evalkit.plugins.parameters import resolve_parameters

MIN_M, MIN_RAD = 0.05, math.radians(2.0)
"""The smallest motion between two scans of a pair; with less, the robot stands still and the pairs repeat."""

MAX_SCANS_APART = 50
"""The largest number of scans from the first to the second scan of a pair."""

MAX_APART_M, MAX_APART_RAD = 0.5, math.radians(1.5)
"""The largest motion of a relation that is used: farther scans show other walls, and in a turn the times of relations
and scans of the classic logs differ too much: at 30 deg/s a tenth of a second is 3 deg."""

MAX_STAMP_GAP_NS = 20_000_000
"""The largest gap between the time of a relation and its scan: 6 mm at 0.3 m/s."""
NEIGHBOURS, RADIUS_M = 10, 0.5


@dataclass(frozen=True)
class PairSource:
    """A data set to take pairs from: its label, registered name and all parameters."""

    label: str
    dataset: str
    parameters: Mapping[str, Any]

    @classmethod
    def of(cls, text: str) -> PairSource:
        """The data set of a text "NAME limit=600"; raises UnknownName, BadParameter or DataMissing."""
        name, given = parse_dataset(text)
        spec = registry.dataset(name)
        values = resolve_parameters(name, spec.parameters, given)
        if missing := spec.missing(**values):
            what, _, remedy = missing.removeprefix(f"{name}: ").partition("; ")
            raise DataMissing(name, what, remedy)
        return cls(text, name, values)

    @property
    def data(self) -> dict[str, Any]:
        """Everything but the label, as JSON values."""
        return {"dataset": self.dataset, "parameters": dict(self.parameters)}

    @property
    def what(self) -> str:
        """A description."""
        spec = registry.dataset(self.dataset)
        return f"pairs of scans of a data set ({spec.summary}); the motion between them: {spec.truth}"

    @property
    def module(self) -> str:
        """The module of the data set."""
        return registry.plug_in_of("datasets", self.dataset).module


def load_pairs(where: PairSource, pairs: int) -> tuple[KnownPair, ...]:
    """Pairs of scans spread evenly over a data set, deskewed, in the base frame.

    The motion between two scans is a measured relation, or from the true trajectory if there are none. Raises BadData
    if neither contains two scans close together.
    """
    return _load_pairs(where.label, where.dataset, json.dumps(dict(where.parameters), sort_keys=True), pairs)


@lru_cache(maxsize=4)
def _load_pairs(label: str, dataset: str, parameters: str, pairs: int) -> tuple[KnownPair, ...]:
    sequence = registry.dataset(dataset).make(**json.loads(parameters))
    frames, truth = list(sequence.frames()), sequence.truth()
    if truth.relations is not None:
        known_pairs = _pairs_by_relations(frames, truth.relations, pairs)
    elif truth.trajectory is not None:
        known_pairs = _pairs_by_trajectory(frames, truth.trajectory, pairs)
    else:
        known_pairs = ()
    if not known_pairs:
        what = "it has no two scans close together with a known motion"
        raise BadData(label, "", what, "give a data set with a true trajectory or with relations")
    return known_pairs


def _pairs_by_trajectory(frames: list[Frame], truth: Trajectory, pairs: int) -> tuple[KnownPair, ...]:
    """Pairs of a scan and the farthest later scan that is still near."""
    stamps = _stamps(frames)
    known = np.flatnonzero(can_interpolate(truth.stamps_ns, stamps, MAX_GAP_S))
    poses = np.full((len(frames), 3), np.nan)
    poses[known] = truth.at(stamps[known])
    known_pairs = []
    for first in spread_indices(len(frames) - 1, 4 * pairs).tolist():
        moved = np.abs(se2.between(poses[first], poses[first + 1 : first + 1 + MAX_SCANS_APART]))
        near = np.flatnonzero((moved <= NEAR.row).all(axis=1) & _moving(moved))
        if len(near):
            second = first + 1 + int(near[-1])
            motion = Pose.of(se2.between(poses[first], poses[second]))
            known_pairs.append(_pair(frames[first], frames[second], Pose.of(poses[first]), motion))
    return tuple(known_pairs[i] for i in spread_indices(len(known_pairs), pairs).tolist())


def _pairs_by_relations(frames: list[Frame], relations: Relations, pairs: int) -> tuple[KnownPair, ...]:
    """The scans of near relations; the axes of the world are those of each first scan."""
    stamps = _stamps(frames)
    first, second = _nearest(stamps, relations.first_ns), _nearest(stamps, relations.second_ns)
    there = np.abs(stamps[first] - relations.first_ns) <= MAX_STAMP_GAP_NS
    there &= np.abs(stamps[second] - relations.second_ns) <= MAX_STAMP_GAP_NS
    moved = np.abs(relations.first_from_second)
    near = (np.hypot(moved[:, 0], moved[:, 1]) <= MAX_APART_M) & (moved[:, 2] <= MAX_APART_RAD) & _moving(moved)
    rows = np.flatnonzero(there & near & (first != second))
    return tuple(
        _pair(frames[first[row]], frames[second[row]], Pose(), Pose.of(relations.first_from_second[row]))
        for row in rows[spread_indices(len(rows), pairs)]
    )


def _pair(target: Frame, source: Frame, world_from_target: Pose, target_from_source: Pose) -> KnownPair:
    points = Cloud(source.points_in_base(source.start_from_end))
    heading = Pose(0.0, 0.0, (world_from_target @ target_from_source).theta)
    normals = planar3d.normals(points.points, NEIGHBOURS, RADIUS_M)
    walls = normals.any(axis=1)
    return KnownPair(
        Cloud(target.points_in_base(target.start_from_end)),
        points,
        world_from_target,
        target_from_source,
        heading.transform(points.points[walls]),
        heading.transform(normals[walls]),
    )


def _moving(moved: Floats) -> Any:
    return (np.hypot(moved[:, 0], moved[:, 1]) >= MIN_M) | (moved[:, 2] >= MIN_RAD)


def _stamps(frames: list[Frame]) -> Stamps:
    return np.array([frame.scan.stamp_ns for frame in frames], dtype=np.int64)


def _nearest(stamps: Stamps, times: Stamps) -> Ints:
    """The index of the stamp nearest to each time."""
    after = np.clip(np.searchsorted(stamps, times), 1, len(stamps) - 1)
    return np.asarray(after - (times - stamps[after - 1] < stamps[after] - times))
