"""Pairs of scans of a data set whose motion is known, by its truth or by its relations: places that nobody made up."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from evalkit.commands.basin.scenes import NEAR, Seen
from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.errors import BadData, BadParameter, DataMissing
from evalkit.core.ground_truth import Relations
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.trajectory import MAX_GAP_S, can_interpolate
from evalkit.odometry import planar3d
from evalkit.plugins import registry
from evalkit.plugins.parameter_parsing import from_text
from evalkit.plugins.parameters import resolve_parameters

MIN_M, MIN_RAD = 0.05, math.radians(2.0)
"""Less than this between two scans of a pair, and the robot stands: one place would count twice."""
AHEAD = 50
"""So many scans after the first of a pair the second is looked for."""
APART_M, APART_RAD = 0.5, math.radians(1.5)
"""Farther apart two scans no longer show the same; and in a turn the times of relations and scans of the classic logs
are too far apart: at 30 deg/s a tenth of a second is 3 deg, and scans were seen to disagree by so much."""
AT_NS = 20_000_000
"""A scan this close to a relation's time is the one it was measured from: 6 mm at 0.3 m/s."""
NEIGHBOURS, RADIUS_M = 10, 0.5


@dataclass(frozen=True)
class Recorded:
    """A data set as it is asked for: what the reader called it, its registered name and all its parameters."""

    label: str
    dataset: str
    parameters: Mapping[str, Any]

    @classmethod
    def of(cls, text: str) -> Recorded:
        """The data set of "fr079 limit=600"; UnknownName, BadParameter and DataMissing as usual."""
        try:
            name, *words = shlex.split(text) or [""]
        except ValueError as error:
            raise BadParameter("evalkit basin", "on", text, f"a data set's name and NAME=VALUE ({error})") from error
        spec = registry.dataset(name)
        for word in words:
            if "=" not in word:
                raise BadParameter(name, word, word, "NAME=VALUE behind the data set's name")
        given = from_text(name, spec.parameters, {key: value for key, _, value in (w.partition("=") for w in words)})
        values = resolve_parameters(name, spec.parameters, given)
        if missing := spec.missing(**values):
            what, _, remedy = missing.removeprefix(f"{name}: ").partition("; ")
            raise DataMissing(name, what, remedy)
        return cls(text, name, values)

    @property
    def data(self) -> dict[str, Any]:
        """All but the label, as JSON takes it."""
        return {"dataset": self.dataset, "parameters": dict(self.parameters)}

    @property
    def what(self) -> str:
        """In words."""
        spec = registry.dataset(self.dataset)
        return f"pairs of scans of a data set ({spec.summary}); the motion between them: {spec.truth}"

    @property
    def module(self) -> str:
        """Where its code stands."""
        return registry.plug_in_of("datasets", self.dataset).module


def seen(where: Recorded, pairs: int) -> tuple[Seen, ...]:
    """Pairs of scans spread evenly over a data set, as points of the base frame, the motion within a scan undone.

    The motion between two scans is a measured relation or, without any, what the truth says: where there are both,
    the trajectory was made from a log and interpolated. BadData where neither knows of two scans close together.
    """
    return _seen(where.label, where.dataset, json.dumps(dict(where.parameters), sort_keys=True), pairs)


@lru_cache(maxsize=4)
def _seen(label: str, dataset: str, parameters: str, pairs: int) -> tuple[Seen, ...]:
    sequence = registry.dataset(dataset).make(**json.loads(parameters))
    frames, truth = list(sequence.frames()), sequence.truth()
    if truth.relations is not None:
        found = _related(frames, truth.relations, pairs)
    elif truth.trajectory is not None:
        found = _along(frames, truth.trajectory, pairs)
    else:
        found = ()
    if not found:
        what = "no truth and no relation says how two of its scans close together stand"
        raise BadData(label, "", what, "give a data set with a true trajectory or with relations")
    return found


def _along(frames: list[Frame], truth: Trajectory, pairs: int) -> tuple[Seen, ...]:
    """The first scan of a pair, and of those after it the farthest that is still near."""
    stamps = _stamps(frames)
    known = np.flatnonzero(can_interpolate(truth.stamps_ns, stamps, MAX_GAP_S))
    poses = np.full((len(frames), 3), np.nan)
    poses[known] = truth.at(stamps[known])
    found = []
    for first in _evenly(len(frames) - 1, 4 * pairs):
        moved = np.abs(se2.between(poses[first], poses[first + 1 : first + 1 + AHEAD]))
        near = np.flatnonzero((moved <= NEAR.row).all(axis=1) & _moving(moved))
        if len(near):
            second = first + 1 + int(near[-1])
            motion = Pose.of(se2.between(poses[first], poses[second]))
            found.append(_pair(frames[first], frames[second], Pose.of(poses[first]), motion))
    return tuple(found[i] for i in _evenly(len(found), pairs))


def _related(frames: list[Frame], relations: Relations, pairs: int) -> tuple[Seen, ...]:
    """The scans of relations that are near; the world is turned as each first scan is."""
    stamps = _stamps(frames)
    first, second = _nearest(stamps, relations.first_ns), _nearest(stamps, relations.second_ns)
    there = np.abs(stamps[first] - relations.first_ns) <= AT_NS
    there &= np.abs(stamps[second] - relations.second_ns) <= AT_NS
    moved = np.abs(relations.first_from_second)
    near = (np.hypot(moved[:, 0], moved[:, 1]) <= APART_M) & (moved[:, 2] <= APART_RAD) & _moving(moved)
    rows = np.flatnonzero(there & near & (first != second))
    return tuple(
        _pair(frames[first[row]], frames[second[row]], Pose(), Pose.of(relations.first_from_second[row]))
        for row in rows[_evenly(len(rows), pairs)]
    )


def _pair(target: Frame, source: Frame, world_from_target: Pose, target_from_source: Pose) -> Seen:
    points = _cloud(source)
    heading = Pose(0.0, 0.0, (world_from_target @ target_from_source).theta)
    normals = planar3d.normals(points.points, NEIGHBOURS, RADIUS_M)
    walls = normals.any(axis=1)
    return Seen(
        _cloud(target),
        points,
        world_from_target,
        target_from_source,
        heading.transform(points.points[walls]),
        heading.transform(normals[walls]),
    )


def _cloud(frame: Frame) -> Cloud:
    scan = frame.scan.deskewed(frame.base_from_sensor, frame.start_from_end)
    return Cloud(frame.base_from_sensor.transform(scan.points()), "base")


def _moving(moved: Floats) -> Any:
    return (np.hypot(moved[:, 0], moved[:, 1]) >= MIN_M) | (moved[:, 2] >= MIN_RAD)


def _stamps(frames: list[Frame]) -> Stamps:
    return np.array([frame.scan.stamp_ns for frame in frames], dtype=np.int64)


def _nearest(stamps: Stamps, times: Stamps) -> Ints:
    """The index of the stamp nearest to each time."""
    after = np.clip(np.searchsorted(stamps, times), 1, len(stamps) - 1)
    return np.asarray(after - (times - stamps[after - 1] < stamps[after] - times))


def _evenly(count: int, most: int) -> list[int]:
    return [int(i) for i in np.unique(np.linspace(0, count - 1, min(most, count)).astype(int))] if count > 0 else []
