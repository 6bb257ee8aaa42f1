"""``paper-slam``: the paper's ICP against a lasting map, with loop closure and a pose graph.

The front end is evalkit's, the ICP is ``paper-map-line`` with ``share_noise``. A loop closure corrects all keyframes
and redraws the map around the robot. Nothing here runs the compiled core, which is compared with this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import Any, NamedTuple

import numpy as np

from evalkit.core import se2
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.odometry.frontend import FrontEnd, FrontEndSettings, Matched
from evalkit.odometry.local_map import voxel_means
from evalkit.plugins.parameters import declared_parameters
from evalkit.plugins.protocols import Registration
from evalkit.plugins.specs import SlamSpec
from evalkit_baselines import paper
from evalkit_baselines.slam import pose_graph
from evalkit_baselines.slam.companions import Companions
from evalkit_baselines.slam.continuity import SOON_NS, Continuity
from evalkit_baselines.slam.keyframes import DOUBTED_M, DriftModel, Edge, Keyframes, Step
from evalkit_baselines.slam.lasting_map import LastingMap, NewKeyframe
from evalkit_baselines.slam.loop_closure import Candidate, LoopFinder
from evalkit_baselines.slam.match_doubt import MatchDoubt
from evalkit_baselines.slam.observability import AS_MANY, ObservableIcp
from evalkit_baselines.slam.odometry_gate import Gated, OdometryGate
from evalkit_baselines.slam.odometry_scale import OdometryScale
from evalkit_baselines.slam.range_noise import RangeNoise
from evalkit_baselines.slam.second_try import (
    DIRECT_EPSILON_M,
    FINE_CORRESPONDENCE_M,
    FINE_ITERATIONS,
    PART_ITERATIONS,
    Coarse,
    CoarseToFine,
    SecondTry,
)
from evalkit_baselines.slam.settings import SlamSettings
from evalkit_baselines.slam.speckles import Speckles
from evalkit_baselines.slam.sweep_times import SweepTimes, deskew
from evalkit_baselines.slam.uneven_turns import UnevenTurns
from evalkit_baselines.slam.wide_search import WideSearch

DCS_PHI = 10.0
_STORED_VOXEL_M = 0.03
_CONFIRMED_WITHIN_M = 6.0
_AGREE_M, _AGREE_RAD = 0.2, math.radians(2.0)
_CORRECTED_M, _CORRECTED_RAD = 0.01, math.radians(0.5)
"""An earlier pose that moves by more was corrected, see ``OdometryEstimate.corrected``."""

PATIENCE_NS = 2_000_000_000
"""With wheel odometry, scans that lie nowhere are set aside until so long after the last one that did: a bump, or
people around the robot. Without it no prediction holds so long."""

PARAMETERS = declared_parameters(SlamSettings)

_NARROW = {"max_correspondence_m": FINE_CORRESPONDENCE_M}


@dataclass
class _Recorded:
    """A candidate as reported, and the loop edge it became; ``edge`` is None where it was rejected."""

    closure: LoopClosure
    edge: Edge | None = None


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
        wide, narrow = _make_icp(), _make_icp(**_NARROW)
        coarse = _make_icp(max_iterations=PART_ITERATIONS)
        brief = _make_icp(**_NARROW, max_iterations=PART_ITERATIONS)
        fine = _make_icp(**_NARROW, max_iterations=FINE_ITERATIONS)
        direct = _make_icp(**_NARROW, max_iterations=FINE_ITERATIONS, epsilon=DIRECT_EPSILON_M)
        of_scan, of_scan_again = Coarse(wide, coarse), Coarse(narrow, brief)
        self._tries = SecondTry(
            CoarseToFine(of_scan, fine),
            CoarseToFine(of_scan_again, fine),
            brief,
            scan_to_scan=(of_scan, of_scan_again),
            search=WideSearch(),
        )
        self._gate = OdometryGate()
        observable = ObservableIcp(self._tries, FINE_CORRESPONDENCE_M)
        self._icps = observable, replace(observable, icp=direct)  # with the same samples
        in_two_stages, self._direct = (Gated(icp, self._gate) for icp in self._icps)
        self._front = FrontEnd(in_two_stages, in_two_stages, front_end, self._map)
        self._finder = LoopFinder(settings, wide, narrow)
        self._continuity = Continuity()
        self._candidates: list[_Recorded] = []
        self._waiting: list[Candidate] = []
        self._stamps_ns: list[int] = []
        self._odom_from_base: list[Floats] = []
        self._keyframe_of: list[int] = []
        self._odom_from_keyframe: list[Floats] = []
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
        if self._stamps_ns and frame.scan.stamp_ns <= self._stamps_ns[-1]:
            found = f"stamp {frame.scan.stamp_ns} ns is not later than the one before, {self._stamps_ns[-1]} ns"
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
        last = Pose.of(self._odom_from_base[-1]) if self._stamps_ns else None
        step = last.inverse() @ predicted if measured and last is not None else None
        elapsed_ns = frame.scan.stamp_ns - self._stamps_ns[-1] if self._stamps_ns else 0
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
        self._stamps_ns.append(frame.scan.stamp_ns)
        self._odom_from_base.append(estimate.pose.row)
        self._keyframe_of.append(len(self._keyframes) - 1)
        return replace(estimate, pose=self._map.odom_from_start.inverse() @ estimate.pose, corrected=self._corrected)

    def trajectory(self) -> Trajectory:
        """Return the corrected poses: between two keyframes the correction is distributed by the driven distance."""
        if not self._stamps_ns:
            return Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), "start", "base")
        odom = np.array(self._odom_from_base)
        keyframe = np.array(self._keyframe_of)
        odom_from_keyframe = np.array(self._odom_from_keyframe)
        corrected = self._keyframes.poses
        since = se2.between(odom_from_keyframe[keyframe], odom)
        poses = se2.compose(corrected[keyframe], since)
        following = np.minimum(keyframe + 1, len(corrected) - 1)
        arrived = se2.compose(corrected[:-1], se2.between(odom_from_keyframe[:-1], odom_from_keyframe[1:]))
        missing = np.concatenate([se2.between(arrived, corrected[1:]), np.zeros((1, 3))])[keyframe]
        step = np.linalg.norm(odom_from_keyframe[following, :2] - odom_from_keyframe[keyframe, :2], axis=1)
        turn = np.abs(se2.wrap(odom_from_keyframe[following, 2] - odom_from_keyframe[keyframe, 2]))
        share = (np.hypot(since[:, 0], since[:, 1]) + np.abs(since[:, 2])) / np.maximum(step + turn, 1e-9)
        poses = se2.compose(poses, np.clip(share, 0.0, 1.0)[:, None] * missing)
        return Trajectory(np.array(self._stamps_ns), poses, "start", "base")

    def loop_closures(self) -> tuple[LoopClosure, ...]:
        """Return all candidates so far."""
        return tuple(recorded.closure for recorded in self._candidates)

    def _insert(self, scan: _TrackedScan, new: NewKeyframe, lost: bool) -> None:
        """Add a keyframe; after a lost track the graph has it where the odometry predicts, not where it matched."""
        kind = Step.MATCHED if not lost else Step.MEASURED if scan.measured else Step.UNKNOWN
        odom_from_base = scan.predicted if kind is Step.MEASURED else new.odom_from_base
        last = Pose.of(self._odom_from_keyframe[-1]) if self._odom_from_keyframe else odom_from_base
        motion, points = last.inverse() @ odom_from_base, voxel_means(new.points, _STORED_VOXEL_M)
        self._keyframes.add(scan.frame.scan.stamp_ns, points, motion, kind, self._doubt.take(), new.base_from_sensor)
        self._odom_from_keyframe.append(new.odom_from_base.row)
        wheels = scan.came.odom_from_base
        if not lost and wheels is not None and self._wheels is not None and self._keyframes.is_last_step_seen():
            self._scale.observe(motion, self._wheels.inverse() @ wheels)
        self._wheels = wheels
        if lost:
            self._waiting = []
            self._map.odom_from_start = new.odom_from_base @ self._keyframes.pose(len(self._keyframes) - 1).inverse()
            self._map.rebuild()
            return
        candidate = self._finder.find(self._keyframes, self._expected(), wheels is not None)
        if candidate is None or not self._consider(candidate):
            self._map.extend()

    def _consider(self, candidate: Candidate) -> bool:
        """Record a candidate; return whether it closed a loop, after which the map has been redrawn."""
        passed = candidate.passed
        quick = candidate.is_local and candidate.chi_square <= self._settings.loop_quick_gate
        agreeing = [other for other in self._waiting if passed and self._agree(other, candidate)]
        if not passed or not (quick or agreeing):
            reason = candidate.reason if not passed else f"not confirmed yet: {candidate.reason}"
            self._record(candidate.edge, False, reason)
            if passed:
                self._waiting = [*self._waiting[-3:], candidate]
            return False
        self._waiting = []
        edge, sections = candidate.edge, self._keyframes.sections
        found_again = bool(self._keyframes.apart_m[edge.first] >= DOUBTED_M)
        if found_again:
            self._keyframes.join(edge, contradicts=not candidate.known)
            self._corrected = True
        lost = f"found again after a lost track (part {sections[edge.second]}): " if found_again else ""
        self._record(edge, True, lost + candidate.reason, found_again)
        self._optimise()
        return True

    def _expected(self) -> Candidate | None:
        """Return the last unconfirmed candidate, where another one may still confirm it."""
        path_m, last = self._keyframes.path_m, self._waiting[-1] if self._waiting else None
        return last if last is not None and path_m[-1] - path_m[last.edge.second] <= _CONFIRMED_WITHIN_M else None

    def _agree(self, earlier: Candidate, later: Candidate) -> bool:
        keyframes, first, second = self._keyframes, earlier.edge, later.edge
        if keyframes.path_m[second.second] - keyframes.path_m[first.second] > _CONFIRMED_WITHIN_M:
            return False
        driven = keyframes.pose(first.second).inverse() @ keyframes.pose(second.second)
        one = keyframes.pose(first.first) @ first.first_from_second @ driven
        two = keyframes.pose(second.first) @ second.first_from_second
        gap = one.inverse() @ two
        return math.hypot(gap.x, gap.y) <= _AGREE_M and abs(gap.theta) <= _AGREE_RAD

    def _record(self, edge: Edge, accepted: bool, reason: str, found_again: bool = False) -> None:
        later, earlier = (self._keyframes.stamps_ns[index] for index in (edge.second, edge.first))
        closure = LoopClosure(later, earlier, edge.first_from_second, accepted, reason, found_again=found_again)
        self._candidates.append(_Recorded(closure, edge if accepted else None))
        if accepted:
            self._keyframes.loops.append(edge)

    def _optimise(self) -> None:
        """Optimise all keyframes; loops that contradict the others are withdrawn."""
        keyframes = self._keyframes
        graph, trusted = keyframes.graph(), keyframes.trusted()
        kernel = pose_graph.dcs_kernel(DCS_PHI, trusted)
        solution = pose_graph.optimise(graph, kernel=kernel, max_iterations=10, tolerance=1e-6)
        kept = keyframes.loops
        if (solution.graph.chi_squares()[~trusted] > pose_graph.SLOW_GATE).any():
            solution = pose_graph.optimise_truncated(graph, trusted)
            weights = solution.weights[~trusted]
            kept = [loop for loop, weight in zip(keyframes.loops, weights, strict=True) if weight > 0.5]
            self._withdraw(kept)
        moved = np.abs(se2.between(keyframes.poses[:-1], solution.graph.poses[:-1]))  # the last one is of this scan
        self._corrected |= bool((np.hypot(moved[:, 0], moved[:, 1]) > _CORRECTED_M).any())
        self._corrected |= bool((moved[:, 2] > _CORRECTED_RAD).any())
        keyframes.correct(solution.graph.poses, kept)
        last = Pose.of(self._odom_from_keyframe[-1])
        self._map.odom_from_start = last @ keyframes.pose(len(keyframes) - 1).inverse()
        self._map.rebuild()

    def _withdraw(self, kept: list[Edge]) -> None:
        for recorded in self._candidates:
            if recorded.edge is not None and not any(recorded.edge is edge for edge in kept):
                reason = f"withdrawn, contradicts other loops: {recorded.closure.reason}"
                recorded.closure = replace(recorded.closure, accepted=False, reason=reason)
                recorded.edge = None


def _is_direct(matched: Matched) -> bool:
    """Return whether a scan was matched with the map alone."""
    return "s2m" in matched.estimate.stages and "s2s" not in matched.estimate.stages


def _make_icp(**changed: Any) -> Registration:
    defaults = {each.name: each.default for each in paper.MAP_LINE.parameters}
    made: Registration = paper.MAP_LINE.make(**{**defaults, "share_noise": True, **changed})
    return made


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
