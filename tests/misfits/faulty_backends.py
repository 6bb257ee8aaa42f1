"""Faulty back ends that each break one rule, and correct ones for comparison; found as "faulty_backends:NAME"."""

from __future__ import annotations

import ctypes
import itertools
import math
import os
import sys
import time
from dataclasses import replace

import answer_faults
import numpy as np

from evalkit.core.errors import NotInstalled
from evalkit.core.match import Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame
from evalkit.odometry import planar3d
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.protocols import NoAnswer
from evalkit.plugins.specs import BackendSpec, OdometrySpec, RegistrationSpec
from evalkit_baselines.paper.icp import Icp


class Sound:
    """A Registration that follows every rule; the faulty ones change one thing."""

    def __init__(self) -> None:
        self._icp = Icp(epsilon=1e-6)

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        return self._icp.register(target, source, guess)


class Guess:
    def register(self, target, source, guess):
        return Match(guess, True, 1, 0.0, len(source))


class Identity:
    def register(self, target, source, guess):
        return Match(Pose(), True, 1, 0.0, len(source))


class IgnoresTheGuess(Sound):
    def register(self, target, source, guess):
        return super().register(target, source, Pose())


class Inverse(answer_faults.Inverse, Sound): ...


class InverseOffByACell(Inverse):
    def register(self, target, source, guess):
        match = super().register(target, source, guess)
        return replace(match, target_from_source=match.target_from_source @ Pose(0.05, 0.0, 0.0))


class Correction(Sound):
    """The motion relative to the guess, from the right or from the left."""

    from_left = False

    def register(self, target, source, guess):
        match = super().register(target, source, guess)
        back, answer = guess.inverse(), match.target_from_source
        return replace(match, target_from_source=answer @ back if self.from_left else back @ answer)


class LeftCorrection(Correction):
    from_left = True


class Degrees(answer_faults.Degrees, Sound): ...


class Clockwise(answer_faults.Clockwise, Sound): ...


class Millimetres(answer_faults.Millimetres, Sound): ...


class Biased(answer_faults.Biased, Sound): ...


class ByIndex(Sound):
    """Pairs the rows with equal index."""

    def register(self, target, source, guess):
        count = min(len(target), len(source))
        if count < 3:
            return Match(guess, False, 0, math.nan, 0)
        shift = (target.points[:count] - guess.transform(source.points[:count])).mean(axis=0)
        return Match(Pose(*shift) @ guess, True, 1, 0.0, count)


class Halves(Sound):
    """Uses only the first half of the source: duplicated points change the result."""

    def register(self, target, source, guess):
        some = Cloud(source.points[:: 1 + (len(source) > 700)] + 0.1 * (len(source) > 700))
        return super().register(target, some, guess)


class Stateful(Sound):
    """Starts from its previous result."""

    last = None

    def register(self, target, source, guess):
        match = super().register(target, source, guess)
        shift, self.last = self.last or Pose(), Pose(1e-6) @ (self.last or Pose())
        return replace(match, target_from_source=shift @ match.target_from_source)


class Random(Sound):
    def register(self, target, source, guess):
        rows = np.random.default_rng().choice(len(source), len(source) // 2, replace=False) if len(source) > 9 else []
        return super().register(target, Cloud(source.points[rows]), guess) if len(rows) else Match(
            guess, False, 0, math.nan, 0
        )  # fmt: skip


class WritesWithNumpy(Sound):
    """Writes into its arguments through NumPy, which raises."""

    def register(self, target, source, guess):
        source.points[:] = guess.transform(source.points)
        return super().register(target, source, Pose())


class WritesThroughPointer(Sound):
    """Writes into its arguments through a pointer, as a C library could."""

    def register(self, target, source, guess):
        match = super().register(target, source, guess)
        ctypes.memset(source.points.ctypes.data, 0, min(source.points.nbytes, 16))
        return match


class ReadsBehind(Sound):
    """Reads a byte behind the target."""

    def register(self, target, source, guess):
        ctypes.string_at(target.points.ctypes.data + target.points.nbytes, 1)
        return super().register(target, source, guess)


class AlwaysConverged(Sound):
    """Always reports convergence."""

    def register(self, target, source, guess):
        return replace(super().register(target, source, guess), converged=True)


class NoPairs(Sound):
    def register(self, target, source, guess):
        return replace(super().register(target, source, guess), inliers=0)


class WithoutTheLast(Sound):
    """Its loop over the source points ends one too early."""

    def register(self, target, source, guess):
        return super().register(target, Cloud(source.points[:-1]), guess)


class Unbounded(Sound):
    """Solves for the direction that a wall leaves unobservable."""

    def register(self, target, source, guess):
        match = super().register(target, source, guess)
        wall = len(source) and np.ptp(target.points[:, 1]) < 1e-6
        return replace(match, target_from_source=Pose(1e6) @ match.target_from_source) if wall else match


class Nan(Sound):
    def register(self, target, source, guess):
        match = super().register(target, source, guess)
        return match if len(source) > 1 else replace(match, target_from_source=None)


class NanPose(Sound):
    def register(self, target, source, guess):
        match = super().register(target, source, guess)
        return match if len(source) > 1 else replace(match, target_from_source=Pose(math.nan, 0.0, 0.0))


class Matrix(Sound):
    """Returns the matrix of its library instead of a Pose."""

    def register(self, target, source, guess):
        return np.eye(4)


class Leaks(Sound):
    def __init__(self) -> None:
        super().__init__()
        self._kept = []

    def register(self, target, source, guess):
        self._kept.append(np.ones(1_000))
        return super().register(target, source, guess)


class Remembers(Sound):
    """Keeps a number of each question in a list, and looks at all of them many times in each call."""

    def __init__(self):
        super().__init__()
        self.kept = []

    def register(self, target, source, guess):
        self.kept.append(len(source))
        for number in 20 * self.kept:
            abs(number)
        return super().register(target, source, guess)


class Segfault(Sound):
    """Dereferences a null pointer if the source is empty."""

    def register(self, target, source, guess):
        if len(source) == 0:
            sys.stderr.write("about to read nothing\n")
            ctypes.string_at(0)
        return super().register(target, source, guess)


class AlwaysSegfault(Sound):
    def register(self, target, source, guess):
        ctypes.string_at(0)


class Exits(Sound):
    def register(self, target, source, guess):
        if len(source) == 1:
            os._exit(3)
        return super().register(target, source, guess)


class Hangs(Sound):
    """Iterates endlessly on a single wall."""

    def register(self, target, source, guess):
        while len(target) and np.ptp(target.points[:, 1]) < 1e-6:
            time.sleep(0.01)
        return super().register(target, source, guess)


class Hogs(Sound):
    """Allocates memory in proportion to its input."""

    def register(self, target, source, guess):
        self.kept = [np.ones(2_000_000) for _ in itertools.count()] if len(source) == 0 else []
        return super().register(target, source, guess)


class Absent(Sound):
    def __init__(self) -> None:
        raise NotInstalled("absent", "does not load (no libabsent.so)", "install libabsent")


class Raises(Sound):
    def register(self, target, source, guess):
        raise RuntimeError("the licence has run out")


class RawOpen3DPlane:
    """Open3D's point-to-plane on z = 0 with the normals that it estimates itself."""

    def register(self, target, source, guess):
        import open3d as o3d

        if min(len(target), len(source)) < 3:
            return Match(guess, False, 0, math.nan, 0)
        fixed, moving = (
            o3d.geometry.PointCloud(o3d.utility.Vector3dVector(planar3d.points_3d(cloud.points)))
            for cloud in (target, source)
        )
        fixed.estimate_normals()
        icp = o3d.pipelines.registration
        found = icp.registration_icp(
            moving, fixed, 0.5, planar3d.matrix_4x4(guess), icp.TransformationEstimationPointToPlane()
        )
        pairs = len(found.correspondence_set)
        return Match(planar3d.pose_2d(found.transformation), found.fitness > 0.5, 0, found.inlier_rmse, pairs)


class RawSmallGicpPlane:
    """small_gicp's PLANE_ICP on z = 0."""

    def register(self, target, source, guess):
        import small_gicp

        if min(len(target), len(source)) < 3:
            return Match(guess, False, 0, math.nan, 0)
        found = small_gicp.align(
            planar3d.points_3d(target.points), planar3d.points_3d(source.points), planar3d.matrix_4x4(guess),
            registration_type="PLANE_ICP", downsampling_resolution=0.01, max_correspondence_distance=0.5,
        )  # fmt: skip
        return Match(
            planar3d.pose_2d(found.T_target_source, 1e-3), found.converged, found.iterations, 0.0, found.num_inliers
        )


class Wheels:
    """An Odometry that follows the rules if there is wheel odometry; the faulty ones change one thing."""

    def __init__(self) -> None:
        self.begin = None

    def pose(self, frame: Frame) -> Pose:
        if self.begin is None:
            self.begin = frame.odom_from_base
        return self.begin.inverse() @ frame.odom_from_base

    def update(self, frame: Frame) -> OdometryEstimate:
        return OdometryEstimate(self.pose(frame))


class StartsElsewhere(Wheels):
    def pose(self, frame):
        return frame.odom_from_base


class Stands(Wheels):
    def pose(self, frame):
        return Pose()


class RemarksInOneText(Wheels):
    def remarks(self):
        return "no room for 3 loops"


class SinceTheLastScan(Wheels):
    """Returns the motion since the scan before."""

    def pose(self, frame):
        last, self.begin = self.begin or frame.odom_from_base, frame.odom_from_base
        return last.inverse() @ frame.odom_from_base


class OfTheWheels(Wheels):
    """Returns the pose in the frame of the wheel odometry."""

    def pose(self, frame):
        return frame.odom_from_base


class LastBeam(Wheels):
    def pose(self, frame):
        answer = super().pose(frame)
        return answer @ frame.start_from_end if answer != Pose() else answer


class OfTheSensor(Wheels):
    """Returns the pose of the lidar instead of the base."""

    def pose(self, frame):
        mount = frame.base_from_sensor
        return mount.inverse() @ super().pose(frame) @ mount


class OfOtherScans(Wheels):
    """Returns for each scan the pose of the previous one."""

    before = Pose()

    def pose(self, frame):
        answer, self.before = self.before, super().pose(frame)
        return answer


class TurnsRight(Wheels):
    def pose(self, frame):
        answer = super().pose(frame)
        return Pose(answer.x, answer.y, -answer.theta)


class Mirrored(Wheels):
    def pose(self, frame):
        answer = super().pose(frame)
        return Pose(answer.x, -answer.y, -answer.theta)


class DegreesOdometry(Wheels):
    def pose(self, frame):
        answer = super().pose(frame)
        return Pose(answer.x, answer.y, math.degrees(answer.theta))


class MillimetresOdometry(Wheels):
    def pose(self, frame):
        answer = super().pose(frame)
        return Pose(1000.0 * answer.x, 1000.0 * answer.y, answer.theta)


class Backwards(Wheels):
    def pose(self, frame):
        return super().pose(frame).inverse()


class NeedsHits(Wheels):
    def pose(self, frame):
        frame.scan.points().max(axis=0)
        return super().pose(frame)


class DividesByTime(Wheels):
    def pose(self, frame):
        _ = 1 / frame.scan.time_increment_ns
        return super().pose(frame)


class Shared(Wheels):
    """Keeps its state in the class."""

    steps = 0

    def pose(self, frame):
        Shared.steps += 1
        return super().pose(frame) @ Pose(1e-9 * Shared.steps)


class WritesScans(Wheels):
    def pose(self, frame):
        frame.scan.ranges[~frame.scan.hits] = 0.0
        return super().pose(frame)


class LeaksScans(Wheels):
    def pose(self, frame):
        self.kept = [*getattr(self, "kept", []), np.ones(1_000)]
        return super().pose(frame)


class Seldom(Wheels):
    """Raises NoAnswer for every third scan."""

    count = 0

    def pose(self, frame):
        answer = super().pose(frame)
        self.count += 1
        if self.count % 3 == 2:
            raise NoAnswer("every third scan is left out")
        return answer


def spec(make, kind=RegistrationSpec, **more) -> BackendSpec:
    return kind(make=make, summary="", citation="", licence="MIT", **more)


def parameterised(stop: int) -> Sound:
    return AlwaysSegfault() if stop == 13 else Sound()


SOUND = spec(Sound)
SEGFAULT, ALWAYS_SEGFAULT, EXITS, HANGS, HOGS = map(spec, (Segfault, AlwaysSegfault, Exits, Hangs, Hogs))
LEAKS, ABSENT, RAISES, MATRIX = map(spec, (Leaks, Absent, Raises, Matrix))
WRITES_THROUGH_POINTER, READS_BEHIND = map(spec, (WritesThroughPointer, ReadsBehind))
PARAMETERISED = spec(parameterised, parameters=(Parameter("stop", 1, "", "13 ends badly", low=1),))
MISSING = spec(Sound, missing=lambda: "not installed: pip install nothing")
WHEELS = spec(Wheels, OdometrySpec, role="baseline")
NO_SPEC = 3
