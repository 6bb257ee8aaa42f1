"""``paper-slam``: the paper's ICP against a lasting map, with loop closure and a pose graph.

The front end is evalkit's, the ICP is ``paper-map-line`` with ``share_noise``. A loop closure corrects all keyframes
and redraws the map around the robot. Nothing here runs the compiled core, which is compared with this.
"""

from __future__ import annotations

import math
from dataclasses import replace
from enum import Enum, auto
from typing import Any, NamedTuple

from evalkit.core.loop_closure import LoopClosure
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.trajectory import Trajectory
from evalkit.odometry.frontend import FrontEnd, FrontEndSettings, Matched
from evalkit.odometry.local_map import voxel_means
from evalkit.plugins.parameters import declared_parameters
from evalkit.plugins.specs import SlamSpec
from evalkit_baselines import paper
from evalkit_baselines.slam.companions import Companions
from evalkit_baselines.slam.continuity import SOON_NS, Continuity
from evalkit_baselines.slam.keyframes import DriftModel, Keyframes, Step
from evalkit_baselines.slam.lasting_map import LastingMap, NewKeyframe
from evalkit_baselines.slam.loop_closer import LoopCloser
from evalkit_baselines.slam.loop_finder import LoopFinder
from evalkit_baselines.slam.match_doubt import MatchDoubt
from evalkit_baselines.slam.matchers import make_matchers
from evalkit_baselines.slam.observability import AS_MANY, ObservableIcp
from evalkit_baselines.slam.odometry_gate import Gated, OdometryGate
from evalkit_baselines.slam.odometry_path import OdometryPath
from evalkit_baselines.slam.odometry_scale import OdometryScale
from evalkit_baselines.slam.range_noise import RangeNoise
from evalkit_baselines.slam.second_try import FINE_CORRESPONDENCE_M
from evalkit_baselines.slam.settings import SlamSettings
from evalkit_baselines.slam.speckles import Speckles
from evalkit_baselines.slam.sweep_times import SweepTimes, deskew
from evalkit_baselines.slam.uneven_turns import UnevenTurns

_STORED_VOXEL_M = 0.03
PATIENCE_NS = 2_000_000_000
"""With wheel odometry, scans that lie nowhere are set aside until so long after the last one that did: a bump, or
people around the robot. Without it no prediction holds so long."""

PARAMETERS = declared_parameters(SlamSettings)


class _TrackedScan(NamedTuple):
    """A scan, as it came and prepared, and what is known before it is matched."""

    came: Frame
    frame: Frame
    hits: int
    predicted: Pose
    measured: bool  # wheel odometry predicts it
    last: Pose | None  # pose of the scan before
    step: Pose | None  # the motion since then by wheel odometry
    elapsed_ns: int  # the time since then
    uneven_rad: float


class _Judgement(Enum):
    """How a scan is used."""

    SET_ASIDE = auto()
    LOST = auto()
    KEPT = auto()
    MATCHED = auto()  # kept, and it lies on the map


class PaperSlam:
    """A Slam; poses are ``start_from_base`` at the first beam of each scan."""

    def __init__(self, settings: SlamSettings) -> None:
        self._settings = settings
        self._keyframes = Keyframes(
            DriftModel(settings.drift_m, math.radians(settings.drift_deg)), settings.map_radius_m
        )
        self._map = LastingMap(self._keyframes, settings.map_voxel_m, settings.map_radius_m, settings.map_reach_m)
        front_end = FrontEndSettings(
            prior=settings.prior,
            keyframe_distance_m=settings.keyframe_distance_m,
            keyframe_angle_deg=settings.keyframe_angle_deg,
        )
        matchers = make_matchers()
        self._tries = matchers.in_two_stages
        self._gate = OdometryGate()
        observable = ObservableIcp(self._tries, FINE_CORRESPONDENCE_M)
        self._icps = observable, replace(observable, icp=matchers.direct)  # with the same samples
        in_two_stages, self._direct = (Gated(icp, self._gate) for icp in self._icps)
        self._front = FrontEnd(in_two_stages, in_two_stages, front_end, self._map)
        self._loops = LoopCloser(
            self._keyframes, LoopFinder(settings, matchers.wide, matchers.narrow), settings.loop_quick_gate
        )
        self._continuity = Continuity()
        self._path = OdometryPath()
        self._corrected = False
        self._scale = OdometryScale()
        self._doubt = MatchDoubt()
        self._turns = UnevenTurns()
        self._noise = RangeNoise()
        self._speckles = Speckles()
        self._sweeps = SweepTimes()
        self._companions = Companions()
        self._hits = 0  # of the front end's last keyframe
        self._wheels: Pose | None = None  # raw odometry at the last keyframe
        self._fitted_ns: int | None = None  # stamp of the last scan that was not lost

    def update(self, frame: Frame) -> OdometryEstimate:
        """Match one scan; a new keyframe may close a loop, which corrects this pose and all earlier ones.

        A scan that lies neither on the one before nor on the map is set aside where there is wheel odometry: that gives
        its pose, and nothing is matched with it. So is a scan within which the robot turned unevenly, where good
        odometry was right over such turns; otherwise it does not enter the map, unless the track is lost. That is so
        after a while, or without odometry: the map begins anew until a loop closure connects it with the old one. In
        between, the pose is that of the wheel odometry, which the graph doubts. Neither answer is accepted. Raises
        ValueError where time does not advance. The steps are those of ``ek_slam_update`` (``../embedded/src/slam.c``).
        """
        before_ns = self._path.last_ns
        if before_ns is not None and frame.scan.stamp_ns <= before_ns:
            found = f"stamp {frame.scan.stamp_ns} ns is not later than the one before, {before_ns} ns"
            raise ValueError(f"paper-slam: {found}; give the scans in the order of time")
        self._corrected = False
        scan = self._begin(frame)
        matched = self._track(scan)
        outcome = self._judge(scan, matched)
        on_map = matched if outcome is _Judgement.MATCHED else None
        self._note_turn(scan, on_map)
        self._observe_sweep(scan, on_map)
        if matched is None or outcome is _Judgement.SET_ASIDE:
            return self._set_aside(scan, matched)
        return self._keep(scan, matched, lost=outcome is _Judgement.LOST)

    def _begin(self, came: Frame) -> _TrackedScan:
        """Prepare a scan, and predict its pose."""
        frame = self._prepare(came)
        predicted, measured = self._front.predict(frame), self._front.is_measured(frame)
        last, last_ns = self._path.last, self._path.last_ns
        step = last.inverse() @ predicted if measured and last is not None else None
        elapsed_ns = 0 if last_ns is None else frame.scan.stamp_ns - last_ns
        uneven_rad = self._turns.measure(frame, step, elapsed_ns)
        return _TrackedScan(
            came, frame, int(frame.scan.hits.sum()), predicted, measured, last, step, elapsed_ns, uneven_rad
        )

    def _prepare(self, frame: Frame) -> Frame:
        """Return a frame with what is known of the wheels, of the lidar and of what moves along corrected."""
        took_ns = self._sweeps.take(frame)
        self._map.noisy = self._noise.is_noisy and not self._speckles.is_dirty  # by the scans before this one
        frame = self._scale.correct(replace(frame, scan=self._speckles.drop(self._noise.smooth(frame.scan))))
        odom = frame.odom_from_base if self._settings.prior == "odometry" else None
        odom_from_sensor = None if odom is None else odom @ frame.base_from_sensor
        frame = replace(frame, scan=self._companions.drop(frame.scan, odom_from_sensor))
        return deskew(frame, self._front.extrapolate(took_ns)) if took_ns else frame

    def _track(self, scan: _TrackedScan) -> Matched | None:
        """Match a scan, with the map alone where good odometry allows it; None: it is set aside, and not matched."""
        is_closed = self._is_closed(scan.hits, scan.predicted)
        for icp in self._icps:
            icp.is_closed = is_closed
        self._gate.begin_scan(scan.step, self._doubt.usual_gap, self._doubt.usual_m, self._doubt.usual_points)
        if self._gate.is_good:
            if scan.uneven_rad and self._turns.is_odometry_right:
                return None
            direct = self._front.match(scan.frame, with_map=self._direct)
            if self._gate.is_sure and direct.estimate.accepted:
                return direct
        self._tries.begin_scan(self._doubt.usual_m, None if scan.measured else scan.predicted)
        return self._front.match(scan.frame)

    def _is_closed(self, hits: int, predicted: Pose) -> bool:
        """Return whether nothing is open: near a keyframe in a room, with about as many hits.

        Elsewhere it is measured again: a scan that is left to its guess, or held back, may never get far from there.
        """
        as_many = abs(hits - self._hits) <= AS_MANY * self._hits
        return as_many and self._keyframes.is_last_in_room() and not self._front.is_keyframe(predicted)

    def _judge(self, scan: _TrackedScan, matched: Matched | None) -> _Judgement:
        """Return whether a scan is set aside, or the track is lost, or else whether it matched with the map."""
        if matched is None:
            return _Judgement.SET_ASIDE
        stamp_ns = scan.frame.scan.stamp_ns
        lost = self._is_lost(scan, matched)
        if not lost or self._fitted_ns is None:
            self._fitted_ns = stamp_ns
        if lost:
            within = scan.measured and stamp_ns - self._fitted_ns <= PATIENCE_NS
            return _Judgement.SET_ASIDE if within else _Judgement.LOST
        match = matched.estimate.stages.get("s2m")
        return _Judgement.MATCHED if match is not None and match.accepted else _Judgement.KEPT

    def _is_lost(self, scan: _TrackedScan, matched: Matched) -> bool:
        """Return whether a scan lies neither on the one before nor on the map; a direct match lies on the map."""
        if _is_direct(matched):
            return False
        pose, cloud = matched.start_from_points, self._map.cloud(matched.start_from_points)
        is_predicted = scan.frame.odom_from_base is not None or scan.elapsed_ns <= SOON_NS
        return self._continuity.is_lost(matched.source.points, pose, is_predicted, cloud.points)

    def _note_turn(self, scan: _TrackedScan, matched: Matched | None) -> None:
        """Note how uneven a scan is, and after an uneven one whether the odometry was right over its turn."""
        pose = None if matched is None else matched.start_from_points
        self._turns.note(scan.uneven_rad, scan.frame.odom_from_base, scan.last, pose)

    def _observe_sweep(self, scan: _TrackedScan, matched: Matched | None) -> None:
        """Learn the times of the beams from a scan, as it came, if it matched with the map."""
        if matched is None or scan.last is None:
            return
        came, pose = scan.came, matched.start_from_points
        step = scan.last.inverse() @ pose
        if self._sweeps.is_informative(came, step):
            cloud = self._map.cloud(scan.predicted if _is_direct(matched) else pose)
            pairs = self._icps[0].find_pairs(cloud, matched.source, pose)
            self._sweeps.observe(came.scan.angles, came.base_from_sensor, step, pairs)

    def _set_aside(self, scan: _TrackedScan, matched: Matched | None) -> OdometryEstimate:
        """Answer with the pose that wheel odometry predicts: nothing is matched with this scan."""
        estimate = OdometryEstimate(scan.predicted)
        if matched is not None:
            estimate = replace(matched.estimate, pose=scan.predicted)
        self._front.set_aside(scan.frame, scan.predicted)
        return self._answer(scan.frame, replace(estimate, accepted=False))

    def _keep(self, scan: _TrackedScan, matched: Matched, lost: bool) -> OdometryEstimate:
        """Keep a scan as the one before, and unless it is uneven in the map if it fits, or as a keyframe.

        It is a keyframe if the base has moved enough, and in any case if the track was lost.
        """
        estimate, points, pose = matched.estimate, matched.source.points, matched.start_from_points
        frame, even = scan.frame, not scan.uneven_rad
        self._front.keep(frame, matched, may_be_keyframe=even)
        self._continuity.keep(points, pose, frame.base_from_sensor)
        fits = self._observe_match(scan, matched)
        keyframe = self._map.take()
        if keyframe is not None:
            self._hits = scan.hits
        if keyframe is not None or lost:
            self._insert(scan, keyframe or NewKeyframe(points, pose, frame.base_from_sensor), lost)
        elif fits and even:
            self._map.add_between(points, pose, frame.base_from_sensor)
        return self._answer(frame, replace(estimate, accepted=False) if lost else estimate)

    def _observe_match(self, scan: _TrackedScan, matched: Matched) -> bool:
        """Sum up the doubt about a match with the map; return whether it fits about as usual."""
        match = matched.estimate.stages.get("s2m")
        if match is None or not match.accepted or scan.last is None:
            return False
        predicted = scan.predicted if scan.measured else None
        return self._doubt.observe(scan.last, predicted, matched.start_from_points, match, scan.hits)

    def _answer(self, frame: Frame, estimate: OdometryEstimate) -> OdometryEstimate:
        """Note the pose of a scan in the frame of the front end, and return it in that of the corrected poses."""
        self._path.add(frame.scan.stamp_ns, estimate.pose)
        return replace(estimate, pose=self._map.odom_from_start.inverse() @ estimate.pose, corrected=self._corrected)

    def trajectory(self) -> Trajectory:
        """Return the corrected poses of all scans."""
        return self._path.correct(self._keyframes.poses)

    def loop_closures(self) -> tuple[LoopClosure, ...]:
        """Return all candidates so far."""
        return self._loops.closures()

    def _insert(self, scan: _TrackedScan, new: NewKeyframe, lost: bool) -> None:
        """Add a keyframe; after a lost track the graph has it where the odometry predicts, not where it matched."""
        kind = Step.MATCHED if not lost else Step.MEASURED if scan.measured else Step.UNKNOWN
        odom_from_base = scan.predicted if kind is Step.MEASURED else new.odom_from_base
        last = self._path.last_keyframe or odom_from_base
        motion, points = last.inverse() @ odom_from_base, voxel_means(new.points, _STORED_VOXEL_M)
        self._keyframes.add(scan.frame.scan.stamp_ns, points, motion, kind, self._doubt.take(), new.base_from_sensor)
        self._path.add_keyframe(new.odom_from_base)
        wheels = scan.came.odom_from_base
        if not lost and wheels is not None and self._wheels is not None and self._keyframes.is_last_step_seen():
            self._scale.observe(motion, self._wheels.inverse() @ wheels)
        self._wheels = wheels
        if lost:
            self._loops.forget_unconfirmed()
        elif self._loops.close(wheels is not None):
            self._corrected = self._loops.has_corrected
        else:
            self._map.extend()
            return
        self._map.move(new.odom_from_base)


def _is_direct(matched: Matched) -> bool:
    """Return whether a scan was matched with the map alone."""
    return "s2m" in matched.estimate.stages and "s2s" not in matched.estimate.stages


def make(**parameters: Any) -> PaperSlam:
    """Make a new ``paper-slam`` with the parameters of ``SlamSettings``."""
    return PaperSlam(SlamSettings(**parameters))


SPEC = SlamSpec(
    make=make,
    summary="the paper's ICP against a lasting map, with loop closure and a pose graph",
    citation=paper.CITATION,
    licence="MIT",
    guess="wheel odometry where recorded, else constant velocity",
    requires=("scipy",),
    parameters=PARAMETERS,
    tuned_on=(
        *paper.MAP_LINE.tuned_on,
        "rplidar-slambot",
        "room",
        "lab",
        "loop",
        "office",
        "long-loop",
        "doors",
        "wings",
        "symmetric-office",
    ),
)
