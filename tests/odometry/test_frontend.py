"""The two-stage front end, driven by registrations with known results."""

import math
from dataclasses import replace

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.errors import BadParameter, UnknownName
from evalkit.core.match import Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.core.timing import Cost
from evalkit.odometry import frontend
from evalkit.odometry.frontend import complete_parameters, make_odometry, settable_parameters
from evalkit.odometry.motion_prior import MotionPrior
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import OdometrySpec, RegistrationSpec

LANDMARKS = np.random.default_rng(5).uniform(-4.0, 4.0, (60, 2))
BASE_FROM_SENSOR = Pose(0.2, -0.1, math.radians(40.0))
STEP_NS = 100_000_000
PATH = [Pose(0.15 * i, 0.02 * i * i, 0.06 * i) for i in range(12)]


class RegistrationByIndex:
    """Registration that returns the true motion, with point i of the source matched to point i of the target."""

    def __init__(self, inliers=60):
        self.inliers, self.targets, self.guesses = inliers, [], []

    def register(self, target, source, guess):
        self.targets.append(target)
        self.guesses.append(guess)
        shared = min(len(target), len(source))
        t, s = (complex_(cloud.points[:shared]) for cloud in (target, source))
        theta = np.angle(np.sum(np.conj(s - s.mean()) * (t - t.mean())))
        move = t.mean() - np.exp(1j * theta) * s.mean()
        return Match(Pose(move.real, move.imag, float(theta)), True, 1, 0.0, self.inliers)


class WrongRegistration:
    """Registration with a large error and few pairs."""

    def __init__(self, inliers):
        self.inliers = inliers

    def register(self, target, source, guess):
        return Match(Pose(70.0, 80.0, 1.0), True, 1, 0.0, self.inliers)


def complex_(points):
    return points[:, 0] + 1j * points[:, 1]


def frame(start_from_base, index=0, *, stamp_ns=None, odom=None, moved=None, told=None):
    """Return the landmarks seen from a pose; ``moved``: the motion of the base; ``told``: that of the odometry."""
    share = np.linspace(0.0, 1.0, len(LANDMARKS))
    start_from_beam = se2.compose(start_from_base.row, se2.fraction((moved or Pose()).row, share))
    sensor_from_start = se2.inverse(se2.compose(start_from_beam, BASE_FROM_SENSOR.row))
    points = se2.transform_each(sensor_from_start, LANDMARKS)
    scan = Scan(
        index * STEP_NS if stamp_ns is None else stamp_ns,
        np.hypot(points[:, 0], points[:, 1]),
        np.arctan2(points[:, 1], points[:, 0]),
        0.0,
        99.0,
        STEP_NS // 100 if moved else 0,
    )
    return Frame(scan, BASE_FROM_SENSOR, odom, told)


def spec(make, **changes):
    return RegistrationSpec(make, "for a test", "none", "MIT", **changes)


def build_odometry(registration, **given):
    """Return an odometry with one registration object for both stages."""
    described = spec(lambda: registration)
    return make_odometry(described, complete_parameters("test", described, given))


def run_poses(method, frames):
    return np.array([method.update(item).pose.row for item in frames])


def rows(poses):
    return np.array([pose.row for pose in poses])


# trajectories


@pytest.mark.parametrize(
    "stages",
    [{}, {"scan_to_map": False}, {"scan_to_scan": False}, {"prior": "none"}, {"prior": "constant-velocity"}],
    ids=str,
)
def test_a_perfect_registration_gives_the_exact_trajectory(stages):
    frames = [frame(pose, i) for i, pose in enumerate(PATH)]
    np.testing.assert_allclose(
        run_poses(build_odometry(RegistrationByIndex(), **stages), frames), rows(PATH), atol=1e-9
    )


def test_the_first_pose_is_the_identity_for_any_odometry_pose():
    method = build_odometry(RegistrationByIndex())
    assert method.update(frame(Pose(), odom=Pose(8.0, 9.0, 1.0))) == OdometryEstimate(Pose())


def test_a_result_from_too_few_pairs_is_not_accepted():
    frames = [frame(pose, i, odom=Pose(3.0, 1.0, 2.0) @ pose) for i, pose in enumerate(PATH)]
    kept = run_poses(build_odometry(WrongRegistration(inliers=9), min_inliers=10), frames)
    np.testing.assert_allclose(kept, rows(PATH), atol=1e-12)
    accepted = run_poses(build_odometry(WrongRegistration(inliers=10), min_inliers=10), frames)
    assert accepted[1].tolist() == [70.0, 80.0, 1.0]


def test_a_motion_that_no_robot_makes_is_refused_before_it_is_used():
    class FarRegistration:
        def register(self, target, source, guess):
            return Match(Pose(1e300, 0.0, 0.0), True, 1, 0.0, 60)

    with pytest.raises(ValueError, match=r"returned a pose farther away than 10,000,000 m: \(1e\+300, 0.0\)"):
        run_poses(build_odometry(FarRegistration()), [frame(pose, i) for i, pose in enumerate(PATH)])


@pytest.mark.parametrize(("inliers", "accepted"), [(9, True), (8, False)])
def test_an_estimate_reports_which_stages_were_accepted(inliers, accepted):
    method = build_odometry(RegistrationByIndex(inliers=inliers), min_inliers=9)
    method.update(frame(PATH[0], 0))
    estimate = method.update(frame(PATH[1], 1))
    assert [(name, stage.accepted) for name, stage in estimate.stages.items()] == [("s2s", accepted), ("s2m", accepted)]
    assert estimate.accepted is accepted


@pytest.mark.parametrize(("odometry", "stages"), [(True, {"s2m"}), (False, {"s2s", "s2m"})])
def test_scans_are_matched_with_each_other_where_no_odometry_gives_the_guess(odometry, stages):
    method = build_odometry(RegistrationByIndex(), scan_to_scan_with_odometry=False)
    frames = [frame(pose, i, odom=pose if odometry else None) for i, pose in enumerate(PATH)]
    estimates = [method.update(each) for each in frames]
    assert all(set(estimate.stages) == stages for estimate in estimates[1:])
    np.testing.assert_allclose([estimate.pose.row for estimate in estimates], rows(PATH), atol=1e-9)


def test_an_estimate_sums_the_cost_of_both_stages():
    class CostlyRegistration(RegistrationByIndex):
        def register(self, target, source, guess):
            cost = Cost(conversion_ns=3, program_cpu_ns=5, device_ns=7)
            return replace(super().register(target, source, guess), cost=cost)

    method = build_odometry(CostlyRegistration())
    costs = [method.update(frame(pose, i)).cost for i, pose in enumerate(PATH[:2])]
    assert costs == [Cost(), Cost(6, 10, 14)]


def test_a_back_end_without_stages_returns_its_prior():
    frames = [frame(pose, i, odom=pose) for i, pose in enumerate(PATH)]
    alone = build_odometry(WrongRegistration(99), scan_to_scan=False, scan_to_map=False)
    np.testing.assert_allclose(run_poses(alone, frames), rows(PATH), atol=1e-12)


# guesses


def test_the_odometry_prior_predicts_the_step_of_the_odometry():
    registration = RegistrationByIndex()
    run_poses(
        build_odometry(registration, scan_to_map=False),
        [frame(Pose(), 0, odom=Pose(1.0, 0.0, math.pi / 2)), frame(PATH[1], 1, odom=Pose(1.0, 0.5, math.pi))],
    )
    assert registration.guesses[0].row == pytest.approx([0.5, 0.0, math.pi / 2])


@pytest.mark.parametrize(("elapsed", "expected"), [(1, 0.2), (2, 0.4), (0.5, 0.1), (9, 0.4)])
def test_constant_velocity_predicts_the_last_step_scaled_by_time_up_to_twice(elapsed, expected):
    registration = RegistrationByIndex()
    last = STEP_NS + int(elapsed * STEP_NS)
    frames = [
        frame(Pose(), 0, odom=Pose()),
        frame(Pose(0.2, 0.0, 0.0), 1, odom=Pose(5.0, 0.0, 0.0)),
        frame(Pose(0.3, 0.0, 0.0), stamp_ns=last, odom=Pose(9.0, 0.0, 0.0)),
    ]
    run_poses(build_odometry(registration, scan_to_map=False, prior="constant-velocity"), frames)
    np.testing.assert_allclose(rows(registration.guesses), [[0, 0, 0], [expected, 0, 0]], atol=1e-9)


def test_the_pose_at_the_first_beam_is_found_from_the_middles_of_the_last_two_sweeps():
    motion = MotionPrior("constant-velocity")
    found = []
    for at, matched in enumerate([0.0, 0.3, 0.5]):  # deskewed at 0, 0 and 0.3 m: the middles are at 0, 0.3 and 0.65 m
        motion.store(sweep(at), Pose(matched, 0.0, 0.0))
        points, guess = motion.predict(sweep(at + 1))
        within = motion.within_scan(sweep(at + 1))
        assert within is not None
        found.append([points.x, (points @ guess).x, within.x])
    # the next first beam is half a step of 0.3 or 0.35 m after the middle
    np.testing.assert_allclose(found, [[0.0, 0.0, 0.0], [0.3, 0.45, 0.3], [0.5, 0.825, 0.35]], atol=1e-6)
    assert motion.find_first_beam(sweep(3), Pose(1.0, 0.0, 0.0)).x == pytest.approx(1.175 - 0.2625)
    wheels = replace(sweep(3), start_from_end=Pose(0.4, 0.0, 0.0))
    measured = MotionPrior("odometry")
    assert measured.find_first_beam(wheels, Pose(1.0, 0.0, 0.0)) == Pose(1.0, 0.0, 0.0)


@pytest.mark.parametrize("second_m", [0.2, 0.4], ids=["the same scan twice", "stamps of arrival"])
def test_stamps_of_two_sweeps_less_than_half_a_sweep_apart_tell_no_velocity(second_m):
    motion = MotionPrior("constant-velocity")
    motion.store(sweep(0), Pose())
    motion.store(sweep(1), Pose(0.2, 0.0, 0.0))
    soon = replace(sweep(1), scan=replace(sweep(1).scan, stamp_ns=STEP_NS + STEP_NS // 3))
    before = motion.within_scan(soon)
    motion.store(soon, Pose(second_m, 0.0, 0.0))
    assert motion.within_scan(sweep(2)) == before
    motion.store(sweep(3), Pose(0.7, 0.0, 0.0))  # two sweeps after the first of both
    # its middle is half a step of 0.2 m on; that of the first of both was matched before anything was known: at 0.2 m
    assert motion.within_scan(sweep(4)).x == pytest.approx((0.7 + 0.1 - 0.2) / 2, abs=1e-6)


def sweep(at: int) -> Frame:
    """Return a frame whose last beam is fired when the next one begins."""
    one = frame(Pose(), at)
    return replace(one, scan=replace(one.scan, time_increment_ns=STEP_NS // (len(one.scan.ranges) - 1)))


def test_a_turn_from_rest_is_known_one_scan_after_it_began():
    """12 deg a scan: the first bent scan is matched 6 deg on, in the middle of its sweep, and 3 deg are gone back."""
    begin = np.radians([0.0, 0.0, 0.0, 12.0, 24.0, 36.0, 48.0, 60.0])
    turns = [Pose(0.0, 0.0, turn) for turn in np.diff(begin)]
    frames = [frame(Pose(0.0, 0.0, begin[at]), at, moved=turn) for at, turn in enumerate(turns)]
    whole = [replace(one, scan=replace(one.scan, time_increment_ns=STEP_NS // len(LANDMARKS))) for one in frames]
    headings = run_poses(build_odometry(RegistrationByIndex()), whole)[:, 2]
    np.testing.assert_allclose(np.degrees(headings), [0.0, 0.0, 3.0, 12.0, 24.0, 36.0, 48.0], atol=1.0)


def test_without_a_prior_the_guess_is_the_identity_motion():
    registration = RegistrationByIndex()
    frames = [frame(pose, i, odom=pose) for i, pose in enumerate(PATH)]
    run_poses(build_odometry(registration, scan_to_map=False, prior="none"), frames)
    assert set(registration.guesses) == {Pose()}


def test_without_recorded_odometry_the_velocity_is_the_prior():
    registration = RegistrationByIndex()
    odom = [Pose(), Pose(0.2, 0.0, 0.0), None, Pose(0.7, 0.0, 0.0)]
    frames = [frame(Pose(0.2 * i, 0.0, 0.0), i, odom=told) for i, told in enumerate(odom)]
    run_poses(build_odometry(registration, scan_to_map=False), frames)
    np.testing.assert_allclose(rows(registration.guesses), [[0.2, 0, 0]] * 3, atol=1e-9)


def test_the_second_stage_starts_from_the_result_of_the_first():
    registration = RegistrationByIndex()
    run_poses(build_odometry(registration, prior="none"), [frame(PATH[0], 0), frame(PATH[1], 1), frame(PATH[2], 2)])
    expected = [Pose(), PATH[1], Pose(), PATH[2]]  # s2s, s2m, s2s, s2m
    np.testing.assert_allclose(rows(registration.guesses), rows(expected), atol=1e-9)


def test_both_stages_are_reported_in_order_from_the_second_scan_on():
    method = build_odometry(RegistrationByIndex(inliers=33))
    estimates = [method.update(frame(pose, i)) for i, pose in enumerate(PATH[:3])]
    reported = [[(name, stage.inliers) for name, stage in estimate.stages.items()] for estimate in estimates]
    assert reported == [[], *[[("s2s", 33), ("s2m", 33)]] * 2]


# motion within a scan


def swept(told):
    """Return scans during which the base moves; the odometry contains that motion or not."""
    moved = Pose(0.12, 0.01, 0.25)
    return [frame(pose, i, odom=pose, moved=moved, told=moved if told else None) for i, pose in enumerate(PATH)]


def test_the_motion_within_a_scan_is_corrected_with_the_odometry():
    exact = run_poses(build_odometry(RegistrationByIndex(), keyframe_distance_m=0.1), swept(told=True))
    np.testing.assert_allclose(exact, rows(PATH), atol=1e-9)


@pytest.mark.parametrize(("told", "settings"), [(True, {"deskew": False}), (False, {}), (True, {"prior": "none"})])
def test_without_deskewing_the_map_is_distorted(told, settings):
    registration = RegistrationByIndex()
    run_poses(build_odometry(registration, scan_to_scan=False, **settings), swept(told)[:2])
    assert np.abs(registration.targets[0].points - LANDMARKS).max() > 0.1


def test_steady_motion_is_corrected_without_odometry_from_the_second_step_on():
    """The base continues at the speed of the last step, 0.2 m in 0.1 s; a scan takes 59 % of that time."""
    moved = Pose(0.2 * 0.59, 0.0, 0.0)
    frames = [frame(Pose(0.2 * i, 0.0, 0.0), i, moved=moved) for i in range(4)]
    registration = RegistrationByIndex()
    run_poses(build_odometry(registration, scan_to_map=False, prior="constant-velocity"), frames)
    seen = Pose(0.4, 0.0, 0.0).transform(registration.targets[2].points)
    np.testing.assert_allclose(seen, LANDMARKS, atol=1e-9)


# local maps


def count_keyframes(path, **settings):
    """Return the number of keyframes in the local map when each scan but the first is matched."""
    registration = RegistrationByIndex()
    run_poses(
        build_odometry(registration, scan_to_scan=False, **settings), [frame(pose, i) for i, pose in enumerate(path)]
    )
    return [len(target) // len(LANDMARKS) for target in registration.targets]


def test_a_keyframe_is_added_after_every_half_metre():
    assert count_keyframes([Pose(0.2 * i, 0.0, 0.0) for i in range(9)]) == [1, 1, 1, 2, 2, 2, 3, 3]


def test_a_keyframe_is_added_after_a_turn_in_either_direction():
    assert count_keyframes([Pose(0.0, 0.0, math.radians(-15.0 * i)) for i in range(6)]) == [1, 1, 2, 2, 3]


def test_the_local_map_consists_of_the_last_keyframes():
    assert count_keyframes([Pose(0.6 * i, 0.0, 0.0) for i in range(7)], keyframes=3) == [1, 2, 3, 3, 3, 3]


def test_a_local_map_of_recent_scans_is_independent_of_their_motion():
    assert count_keyframes([Pose(0.01 * i, 0.0, 0.0) for i in range(6)], keyframes=3, local_map="scans") == [
        1,
        2,
        3,
        3,
        3,
    ]


def test_a_grid_receives_every_scan_and_returns_its_occupied_cells():
    registration = RegistrationByIndex(inliers=0)  # not accepted: the poses of the odometry are kept
    method = build_odometry(registration, scan_to_scan=False, local_map="grid", local_map_cell_m=0.1)
    run_poses(method, [frame(Pose(), i, odom=Pose()) for i in range(3)])
    cells = np.unique(np.floor(LANDMARKS / 0.1), axis=0)
    for target in registration.targets:
        assert target.frame == "start"
        np.testing.assert_allclose(target.points, cells[np.lexsort(cells.T)] * 0.1 + 0.05, atol=1e-9)


def test_a_persistent_map_is_selected_by_name():
    registration = RegistrationByIndex()
    method = build_odometry(registration, scan_to_scan=False, local_map="voxels", local_map_voxel_m=1.0)
    run_poses(method, [frame(PATH[0], 0), frame(PATH[1], 1)])
    assert len(registration.targets[0]) == len(np.unique(np.floor(LANDMARKS), axis=0))


def test_local_radius_keeps_only_points_near_the_base():
    registration = RegistrationByIndex()
    method = build_odometry(registration, local_radius_m=3.0)
    run_poses(method, [frame(PATH[0], 0), frame(PATH[0], 1)])
    near = LANDMARKS[np.hypot(LANDMARKS[:, 0], LANDMARKS[:, 1]) <= 3.0]
    np.testing.assert_allclose(registration.targets[0].points, near, atol=1e-9)
    assert registration.targets[0].frame == "base"


@pytest.mark.parametrize("voxel_m", [2.0, 1.0])
def test_a_scan_may_be_reduced_to_voxel_means(voxel_m):
    registration = RegistrationByIndex()
    run_poses(build_odometry(registration, source_voxel_m=voxel_m), [frame(PATH[0], 0), frame(PATH[0], 1)])
    assert len(registration.targets[0]) == len(np.unique(np.floor(LANDMARKS / voxel_m), axis=0)) < len(LANDMARKS)


# limits and defaults

DEFAULTS = {
    "prior": "odometry", "scan_to_scan": True, "scan_to_scan_with_odometry": True, "scan_to_map": True, "deskew": True,
    "local_radius_m": 0.0, "source_voxel_m": 0.0, "local_map": "keyframes", "keyframes": 10, "keyframe_distance_m": 0.5,
    "keyframe_angle_deg": 20.0, "local_map_voxel_m": 0.0, "local_map_radius_m": 15.0, "local_map_cell_m": 0.05,
    "local_map_probability": 0.5, "min_inliers": 10,
}  # fmt: skip


def test_every_parameter_of_the_front_end_has_its_default():
    assert {p.name: p.default for p in frontend.PARAMETERS} == DEFAULTS


@pytest.mark.parametrize(
    ("name", "least", "below", "most", "beyond"),
    [("local_radius_m", 0.0, -0.1, 1e9, None), ("source_voxel_m", 0.0, -0.1, 1e9, None), ("keyframes", 1, 0, 999, None),
     ("keyframe_distance_m", 0.0, -0.1, 1e9, None), ("keyframe_angle_deg", 0.0, -0.1, 1e9, None),
     ("local_map_voxel_m", 0.0, -0.1, 1e9, None), ("local_map_radius_m", 1.0, 0.9, 1e9, None),
     ("local_map_cell_m", 0.005, 0.004, 10.0, 10.1), ("local_map_probability", 0.0, -0.1, 1.0, 1.1),
     ("min_inliers", 0, -1, 999, None)],
)  # fmt: skip
def test_every_number_of_the_front_end_is_refused_beyond_its_limits(name, least, below, most, beyond):
    plain = spec(RegistrationByIndex)
    assert [complete_parameters("test", plain, {name: value})[name] for value in (least, most)] == [least, most]
    for value in (below, beyond):
        if value is not None:
            with pytest.raises(BadParameter, match=name):
                complete_parameters("test", plain, {name: value})


@pytest.mark.parametrize("moved", [Pose(0.5), Pose(0.0, -0.5), Pose(0.0, 0.0, math.radians(20.0))])
def test_a_keyframe_is_added_at_exactly_half_a_metre_or_twenty_degrees(moved):
    registration = RegistrationByIndex(inliers=0)  # not accepted: the poses of the odometry are kept
    method = build_odometry(registration, scan_to_scan=False)
    run_poses(method, [frame(pose, i, odom=pose) for i, pose in enumerate((Pose(), moved, moved))])
    assert [len(target) // len(LANDMARKS) for target in registration.targets] == [1, 2]


# parameters

GAIN, BIAS = Parameter("gain", 1.0, "", "how much", low=0.0), Parameter("bias", 0, "", "how far")


def stage_parameters(described, given):
    """Return the parameters of the registrations of both stages."""
    calls = []
    told = spec(
        lambda **parameters: calls.append(parameters) or RegistrationByIndex(),
        parameters=described.parameters,
        scan_to_scan=described.scan_to_scan,
    )
    make_odometry(told, complete_parameters("test", told, given))
    return calls


def test_a_parameter_may_differ_in_the_first_stage_only():
    plain, own = spec(RegistrationByIndex, parameters=(GAIN, BIAS)), {"gain": 3.0, "bias": 4}
    assert stage_parameters(plain, own) == [own, own]
    assert stage_parameters(plain, {**own, "s2s.gain": 2}) == [{"gain": 2.0, "bias": 4}, own]


def test_a_back_end_may_have_other_defaults_in_the_first_stage():
    eager = spec(RegistrationByIndex, parameters=(GAIN, BIAS), scan_to_scan={"gain": 9.0})
    assert stage_parameters(eager, {"bias": 1}) == [{"gain": 9.0, "bias": 1}, {"gain": 1.0, "bias": 1}]
    assert stage_parameters(eager, {"s2s.gain": 5.0})[0]["gain"] == 5.0
    assert [p.name for p in settable_parameters(eager)][:3] == ["gain", "bias", "s2s.gain"]


def test_front_end_settings_of_a_back_end_are_defaults():
    wide = spec(RegistrationByIndex, frontend={"keyframes": 4})
    assert complete_parameters("test", wide, {})["keyframes"] == 4
    assert complete_parameters("test", wide, {"keyframes": 5})["keyframes"] == 5
    assert complete_parameters("test", spec(RegistrationByIndex), {}) == {
        p.name: p.default for p in frontend.PARAMETERS
    }


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"keyframe": 3}, UnknownName, r"test: no parameter named 'keyframe' \(did you mean 'keyframes'\?\)"),
        ({"s2s.gian": 3.0}, UnknownName, "no parameter named 's2s.gian'"),
        ({"s2s.keyframes": 3}, UnknownName, "no parameter named 's2s.keyframes'"),
        ({"s2s.gain": -1.0}, BadParameter, "parameter 's2s.gain': found -1.0"),
        ({"prior": "gps"}, BadParameter, "one of odometry, constant-velocity, none"),
    ],
)
def test_unknown_and_invalid_parameters_are_rejected(given, error, message):
    with pytest.raises(error, match=message):
        complete_parameters("test", spec(RegistrationByIndex, parameters=(GAIN,)), given)


def test_an_odometry_back_end_is_created_without_a_front_end():
    calls = []
    own = OdometrySpec(lambda **p: calls.append(p) or "made", "", "", "MIT", parameters=(GAIN,))
    assert make_odometry(own, complete_parameters("test", own, {})) == "made"
    assert calls == [{"gain": 1.0}]
    with pytest.raises(UnknownName, match="no parameter named 'keyframes'; known: gain"):
        complete_parameters("test", own, {"keyframes": 3})
