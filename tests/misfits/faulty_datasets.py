"""Data sets that each break one rule; found as "faulty_datasets:NAME"."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.core.trajectory import Trajectory
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import DatasetSpec

STEP_NS = 100_000_000


class Straight:
    """Eight scans of a round wall; the faulty ones change one thing."""

    def __init__(self, seed: int = 0, scans: int = 8) -> None:
        self._seed, self._scans = seed, scans

    def __len__(self):
        return self._scans

    def frames(self):
        rng = np.random.default_rng(self._seed)
        angles = np.linspace(0.0, 6.0, 40)
        for index in range(self._scans):
            scan = Scan(index * STEP_NS, 3.0 + rng.normal(0.0, 0.01, 40), angles, 0.1, 12.0)
            yield self.frame(index, Frame(scan, Pose(0.1), Pose(0.1 * index)))

    def frame(self, index, frame):
        return frame

    def truth(self):
        stamps = np.arange(self._scans) * STEP_NS
        return Truth("exact", Trajectory(stamps, np.zeros((self._scans, 3))))

    def notes(self):
        return {"scans out of order": 0}


class Empty(Straight):
    def frames(self):
        return iter(())


class Blind(Straight):
    def frame(self, index, frame):
        return replace(frame, scan=replace(frame.scan, ranges=np.full(40, np.inf)))


class Once(Straight):
    """Its frames can be iterated only once."""

    def frames(self):
        if not hasattr(self, "kept"):
            self.kept = super().frames()
        return self.kept


class Unseeded(Straight):
    """Uses an unseeded generator."""

    def frame(self, index, frame):
        return replace(frame, scan=replace(frame.scan, ranges=frame.scan.ranges + np.random.default_rng().random() / 9))


class IgnoresSeeds(Straight):
    def __init__(self, seed=0, scans=8) -> None:
        super().__init__(0, scans)


class Backwards(Straight):
    def frame(self, index, frame):
        return replace(frame, scan=replace(frame.scan, stamp_ns=-index))


class Boastful(Straight):
    def __len__(self):
        return 100


class Patchy(Straight):
    """Contains the motion within a scan, and none between scans."""

    def frame(self, index, frame):
        return replace(frame, odom_from_base=None, start_from_end=Pose()) if index == 3 else frame


class Loose(Straight):
    """A lidar that moves relative to the robot."""

    def frame(self, index, frame):
        return replace(frame, base_from_sensor=Pose(0.1 * index))


class Degrees(Straight):
    def frame(self, index, frame):
        scan = frame.scan
        return replace(frame, scan=Scan(scan.stamp_ns, scan.ranges, np.degrees(scan.angles), 0.1, 12.0))


class OdometryOfNumbers(Straight):
    def frame(self, index, frame):
        return replace(frame, odom_from_base=(0.1 * index, 0.0, 0.0))


class TruthInMillimetres(Straight):
    def truth(self):
        stamps = np.arange(self._scans) * STEP_NS
        return Truth("exact", Trajectory(stamps, np.outer(np.arange(self._scans), [100.0, 0.0, 0.0])))


class LateTruth(Straight):
    """The first 30 frames are before the truth."""

    def truth(self):
        stamps = np.arange(30, self._scans) * STEP_NS
        return Truth("exact", Trajectory(stamps, np.zeros((len(stamps), 3))))


class OtherClock(Straight):
    def truth(self):
        return Truth("exact", Trajectory(np.array([10**18, 10**18 + 1]), np.zeros((2, 3))))


class Words(Straight):
    def notes(self):
        return {"scans out of order": "many"}


class NoNotes(Straight):
    def notes(self):
        return None


class Unreadable(Straight):
    def frames(self):
        raise ValueError("line 3")


class Refuses(Straight):
    def __init__(self, seed=0) -> None:
        super().__init__(seed)


def spec(make, **more) -> DatasetSpec:
    parameters = (Parameter("seed", 0, "", "draws the noise", low=0), Parameter("scans", 8, "", "how many", low=1))
    return DatasetSpec(
        make=make, summary="", sensor="", truth="", citation="", licence="MIT", seeded=True, parameters=parameters,
        **more,
    )  # fmt: skip


SOUND = spec(Straight)
MISSING = spec(Straight, missing=lambda **_given: "no such file; get it from somewhere")
