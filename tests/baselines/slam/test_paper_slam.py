from dataclasses import replace

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame, Scan
from evalkit.core.world import World, closed_outline
from evalkit_baselines.slam import paper_slam
from evalkit_baselines.slam.continuity import Continuity
from evalkit_baselines.slam.keyframes import DOUBTED_M, DriftModel, Edge, Keyframes, Step
from evalkit_baselines.slam.loop_closer import LoopCloser
from evalkit_baselines.slam.loop_finder import Candidate, LoopFinder
from evalkit_baselines.slam.loop_places import LoopPlaces
from evalkit_baselines.slam.observability import ObservableIcp, measure_openness
from evalkit_baselines.slam.settings import SlamSettings

BEAMS = np.radians(np.arange(0.0, 360.0, 1.0))
STEP_NS = 200_000_000
RANGE_M = 8.0

RING = World(
    np.concatenate(
        [
            closed_outline([(0, 0), (9, 0), (9, 7), (0, 7)]),
            closed_outline([(2, 2), (6.5, 2), (7, 2.8), (7, 5), (2, 5)]),
            closed_outline([(3.0, 0.0), (3.6, 0.0), (3.6, 0.4), (3.0, 0.4)]),
            closed_outline([(8.6, 3.0), (9.0, 3.0), (9.0, 3.9), (8.6, 3.9)]),
            closed_outline([(5.0, 6.6), (5.4, 6.6), (5.4, 7.0), (5.0, 7.0)]),
            closed_outline([(0.0, 2.6), (0.5, 2.6), (0.5, 3.1), (0.0, 3.1)]),
        ]
    )
)
"""A ring of corridors 2 m wide, with a box in each."""


def ring_drive(laps, step_m=0.2):
    """Poses (N, 3) along the middle of the ring, turning on the spot in steps of 15 deg."""
    corners, poses = np.array([(1.0, 1.0), (8.0, 1.0), (8.0, 6.0), (1.0, 6.0)]), []
    for side in range(int(4 * laps)):
        begin, end = corners[side % 4], corners[(side + 1) % 4]
        heading, length = side * np.pi / 2, np.linalg.norm(end - begin)
        poses += [(*(begin + share * (end - begin)), heading) for share in np.arange(0.0, 1.0, step_m / length)]
        poses += [(*end, heading + turn) for turn in np.radians(np.arange(0.0, 90.0, 15.0))]
    return np.array(poses)


def make_frames(world, poses, drift=0.0, seed=0):
    """Frames of noisy scans with odometry whose heading drifts by ``drift`` rad a step."""
    rng = np.random.default_rng(seed)
    odom = poses[0]
    for index, pose in enumerate(poses):
        if index:
            odom = se2.compose(odom, se2.compose(se2.between(poses[index - 1], pose), [0.0, 0.0, drift]))
        distance = world.cast(np.tile(pose[:2], (len(BEAMS), 1)), pose[2] + BEAMS)
        distance = np.where(distance <= RANGE_M, distance + rng.normal(0.0, 0.01, len(BEAMS)), np.inf)
        scan = Scan(index * STEP_NS, np.clip(distance, 0.05, np.inf), BEAMS, 0.0, RANGE_M + 1.0)
        yield Frame(scan, Pose(), Pose.of(odom), Pose())


def cover(frames, rows, measured=True):
    """The frames with all beams of some rows ended by people around the robot; without odometry unless ``measured``."""
    rng = np.random.default_rng(3)
    for row, frame in enumerate(frames):
        ranges = rng.uniform(0.3, 1.0, len(BEAMS)) if row in rows else frame.scan.ranges
        odom = frame.odom_from_base if measured else None
        yield replace(frame, scan=replace(frame.scan, ranges=ranges), odom_from_base=odom)


def run(frames, **parameters):
    slam = paper_slam.make(**parameters)
    online = np.array([slam.update(frame).pose.row for frame in frames])
    return slam, online


def errors_m(poses, true):
    return np.linalg.norm(se2.between(se2.between(true[0], true), poses)[:, :2], axis=1)


def test_a_drive_around_a_ring_closes_its_loop_and_keeps_the_first_pose():
    true = ring_drive(1.25)
    slam, online = run(make_frames(RING, true, drift=2e-4), loop_path_m=10.0)
    accepted = [loop for loop in slam.loop_closures() if loop.accepted]
    assert accepted
    for loop in accepted:
        first, second = true[loop.other_stamp_ns // STEP_NS], true[loop.stamp_ns // STEP_NS]
        np.testing.assert_allclose(se2.between(se2.between(first, second), loop.other_from_base.row), 0.0, atol=0.03)
    final = slam.trajectory()
    np.testing.assert_array_equal(final.poses[0], 0.0)
    assert errors_m(final.poses, true).max() < 0.05
    assert errors_m(online, true).max() < 0.08
    steps = np.linalg.norm(se2.between(final.poses[:-1], final.poses[1:])[:, :2], axis=1)
    assert steps.max() < 0.25  # 0.2 m driven: the corrected path does not jump


# --- bad input


def test_time_that_goes_back_is_an_error_that_names_both_stamps():
    first, second = list(make_frames(RING, ring_drive(0.25)))[:2]
    slam = paper_slam.make()
    slam.update(second)
    with pytest.raises(ValueError, match=r"stamp 0 ns is not later than the one before, 200000000 ns"):
        slam.update(first)


def test_scans_without_returns_keep_the_odometry_and_do_no_harm():
    true = ring_drive(0.75)
    frames = list(make_frames(RING, true))
    for index in (0, 10, 11, 12, 40):
        blind = replace(frames[index].scan, ranges=np.full(len(BEAMS), np.inf))
        frames[index] = replace(frames[index], scan=blind)
    slam, _ = run(frames)
    assert errors_m(slam.trajectory().poses, true).max() < 0.05


def test_odometry_that_stands_still_is_overruled_by_the_scans():
    true = ring_drive(0.5)
    still = (replace(frame, odom_from_base=Pose()) for frame in make_frames(RING, true))
    slam, _ = run(still)
    assert errors_m(slam.trajectory().poses, true).max() < 0.08


def test_a_kidnapped_robot_is_reported_and_found_again_by_a_loop_closure():
    drive = ring_drive(1.0)
    carried = drive[16:62]  # from the end of the lap to a place driven through before, and on from there
    true = np.concatenate([drive, carried])
    slam = paper_slam.make()
    frames = list(make_frames(RING, drive))
    estimates = [slam.update(frame) for frame in frames]
    for frame in make_frames(RING, carried, seed=1):  # the wheels stand still
        moved = replace(frame, scan=replace(frame.scan, stamp_ns=frame.scan.stamp_ns + len(drive) * STEP_NS))
        estimates.append(slam.update(replace(moved, odom_from_base=frames[-1].odom_from_base)))
    assert all(estimate.accepted is not False for estimate in estimates[: len(drive)])
    assert estimates[len(drive)].accepted is False
    assert estimates[len(drive)].pose.row == pytest.approx(estimates[len(drive) - 1].pose.row)  # the wheels go on
    aside = np.zeros(len(true), dtype=bool)
    aside[len(drive) : len(drive) + 10] = True  # 2 s: somebody may only stand around the robot
    assert [estimate.accepted is False for estimate in estimates] == [
        *aside[: len(drive) + 10], True, *aside[len(drive) + 11 :]
    ]  # fmt: skip
    assert any(loop.accepted and loop.found_again for loop in slam.loop_closures())
    assert all(loop.found_again is ("lost track" in loop.reason) for loop in slam.loop_closures())
    assert errors_m(slam.trajectory().poses, true)[~aside].max() < 0.1


def test_a_lidar_that_is_covered_for_a_moment_keeps_its_track_by_the_wheels_and_draws_no_map():
    true, covered = ring_drive(0.5)[:32], range(15, 24)
    slam = paper_slam.make()
    estimates = [slam.update(frame) for frame in cover(make_frames(RING, true), covered)]
    assert [row for row, estimate in enumerate(estimates) if estimate.accepted is False] == list(covered)
    assert max(slam._keyframes.sections) == 0
    assert not set(slam._keyframes.stamps_ns) & {row * STEP_NS for row in covered}
    assert errors_m(slam.trajectory().poses, true).max() < 0.05


def test_a_lidar_that_is_covered_for_longer_has_lost_its_track():
    slam = paper_slam.make()
    estimates = [slam.update(frame) for frame in cover(make_frames(RING, ring_drive(0.5)[:30]), range(15, 30))]
    assert slam._keyframes.sections.count(0) == slam._keyframes.stamps_ns.index(25 * STEP_NS)  # 2 s after scan 14
    assert all(estimate.accepted is False for estimate in estimates[15:26])


def test_a_gap_of_a_minute_in_which_the_robot_leaves_is_a_lost_track():
    frames = list(make_frames(RING, ring_drive(1.0)))
    slam = paper_slam.make()
    for frame in frames[:15]:
        slam.update(replace(frame, odom_from_base=None))
    later = replace(frames[36].scan, stamp_ns=frames[15].scan.stamp_ns + 60_000_000_000)
    assert slam.update(replace(frames[36], scan=later, odom_from_base=None)).accepted is False
    steps = np.linalg.norm(np.diff(slam.trajectory().poses[:, :2], axis=0), axis=1)
    assert steps[:-1].max() < 0.25  # the path before the gap is not torn


# --- contradicting loops and large graphs


def make_chain(count):
    """Keyframes without points on a straight line, one metre apart."""
    keyframes = Keyframes(DriftModel())
    for row in range(count):
        keyframes.add(row, np.zeros((0, 2)), Pose(1.0, 0.0, 0.0) if row else Pose())
    return keyframes


def test_of_two_loops_that_contradict_each_other_one_is_withdrawn_and_says_so():
    keyframes, information = make_chain(60), np.diag([4e3, 4e3, 6e4])
    closer = LoopCloser(keyframes, None, quick_gate=6.0)

    def close(first, second, x):
        edge = Edge(first, second, Pose(x, 0.0, 0.0), information)
        return closer.consider(Candidate(edge, True, f"measured {x} m", 1.0, True))

    assert close(0, 40, 40.05)
    assert close(1, 41, 40.05)
    assert close(0, 42, 38.0)  # 4 m short of what the other two say
    first, second, third = closer.closures()
    assert {one.found_again for one in (first, second, third)} == {False}
    assert (first.accepted, second.accepted, third.accepted) == (True, True, False)
    assert third.reason.startswith("withdrawn, contradicts other loops: measured 38.0 m")
    assert keyframes.poses[41, 0] == pytest.approx(41.05, abs=0.1)


@pytest.mark.parametrize(("measured_m", "corrected"), [(40.0, False), (40.02, True)])
def test_a_closure_is_a_correction_where_it_moves_an_earlier_pose_by_more_than_a_centimetre(measured_m, corrected):
    closer = LoopCloser(make_chain(60), None, quick_gate=6.0)
    edge = Edge(0, 40, Pose(measured_m, 0.0, 0.0), np.diag([4e3, 4e3, 6e4]))
    assert closer.consider(Candidate(edge, True, "measured", 1.0, True))
    assert closer.has_corrected is corrected


def test_the_distance_through_the_graph_is_short_across_a_loop_and_beyond_all_maps_after_a_lost_track():
    keyframes = make_chain(31)
    assert keyframes.apart_m[0] == pytest.approx(30.0)
    keyframes.correct(keyframes.poses.copy(), [Edge(0, 28, Pose(28.0, 0.0, 0.0), np.eye(3))])
    assert keyframes.apart_m[0] == pytest.approx(2.5)
    keyframes.add(31, np.zeros((0, 2)), Pose(), Step.MEASURED)
    assert (keyframes.apart_m[:31] >= DOUBTED_M).all()
    assert np.isfinite(keyframes.apart_m).all()
    keyframes.add(32, np.zeros((0, 2)), Pose(), Step.UNKNOWN)
    assert np.isinf(keyframes.apart_m[:32]).all()
    keyframes.correct(keyframes.poses.copy(), [Edge(3, 32, Pose(), np.eye(3))])
    assert keyframes.apart_m[3] == pytest.approx(0.5)
    assert keyframes.apart_m[31] >= DOUBTED_M


def test_after_a_lost_track_the_odometry_has_an_error_of_half_a_metre_and_10_degrees():
    keyframes = make_chain(3)
    keyframes.add(3, np.zeros((0, 2)), Pose(1.0, 0.0, 0.0), Step.MEASURED)
    usual, lost = (np.linalg.inv(keyframes.steps[row].information) for row in (1, 2))
    np.testing.assert_allclose(np.diag(lost - usual), [0.25, 0.25, np.radians(10.0) ** 2], rtol=1e-9)


@pytest.mark.parametrize("contradicts", [False, True])
def test_a_loop_to_another_part_moves_all_that_is_connected_and_may_refute_the_odometry_in_between(contradicts):
    keyframes = make_chain(3)
    keyframes.add(3, np.zeros((0, 2)), Pose(1.0, 0.0, 0.0), Step.MEASURED)
    for row in (4, 5):
        keyframes.add(row, np.zeros((0, 2)), Pose(1.0, 0.0, 0.0))
    keyframes.join(Edge(0, 4, Pose(0.0, 2.0, 0.0), np.eye(3)), contradicts)
    np.testing.assert_allclose(keyframes.poses[:, 0], [0.0, 1.0, 2.0, -1.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(keyframes.poses[:, 1], [0.0, 0.0, 0.0, 2.0, 2.0, 2.0], atol=1e-12)
    assert keyframes.kinds[3] == (Step.UNKNOWN if contradicts else Step.MEASURED)
    assert (keyframes.steps[2].information[0, 0] < 1e-3) == contradicts


def described(place):
    """Return the row of a place, where along the line it expects the robot, and whether the graph predicts that."""
    return place.row, place.expected and place.expected.x, place.known


def make_two_parts(kind=Step.UNKNOWN):
    """Keyframes of two lost parts of 31 m, 1 m apart, on one line: the second begins at 10.2 m of the first."""
    keyframes = make_chain(31)
    keyframes.add(31, np.zeros((0, 2)), Pose(-19.8, 0.0, 0.0), kind)
    return keyframes


X = pytest.approx


def drive_on(keyframes, metres):
    for _ in range(metres):
        keyframes.add(keyframes.stamps_ns[-1] + 1, np.zeros((0, 2)), Pose(1.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("kind", "measured", "near"),
    [
        (Step.UNKNOWN, False, [(11, None, False), (13, None, False), (16, None, False)]),  # at any heading
        (Step.UNKNOWN, True, [(11, X(11.2), False), (13, X(13.2), False), (16, X(16.2), False)]),
        (
            Step.MEASURED,
            True,
            [(11, X(11.2), True), (13, X(13.2), False), *((row, X(row + 0.2), True) for row in (14, 15, 16))],
        ),
    ],
)
def test_after_a_lost_track_the_robot_is_sought_by_turns_where_it_seems_to_be_and_at_all_places(kind, measured, near):
    keyframes, places, found = make_two_parts(kind), LoopPlaces(SlamSettings()), []
    for _ in range(7):
        drive_on(keyframes, 1)
        found.append(described(places.find_next(keyframes, measured)))
    predicted = kind is Step.MEASURED  # then this place has the fourth and the last turn, too
    others = [1, 6] if predicted else [1, 3, 4, 6]
    assert [place for turn, place in enumerate(found) if turn not in others] == near
    assert [found[turn][0] for turn in others] == [0, 4, 8, 12][: len(others)]  # all places, every 3.5 m


def test_beside_a_loop_of_another_part_the_place_is_where_that_loop_puts_the_robot():
    keyframes, places = make_two_parts(), LoopPlaces(SlamSettings())
    drive_on(keyframes, 20)  # a place of the same part is 15 m away along the path
    # the robot was at 2.4 m of the first part
    beside = Edge(2, len(keyframes) - 1, Pose(0.4, 0.0, 0.0), np.eye(3))
    drive_on(keyframes, 2)
    assert described(places.find_beside(keyframes, beside, known=False)) == (4, pytest.approx(4.4), False)


class PlaceFinder(LoopFinder):
    """A LoopFinder whose candidates are the rows of the places to compare."""

    def _verify(self, keyframes, place, last):
        return place.row


def test_a_place_beside_an_unconfirmed_loop_is_compared_before_the_nearest_and_one_a_metre():
    keyframes, finder = make_chain(41), PlaceFinder(SlamSettings(), None, None)
    keyframes.add(41, np.zeros((0, 2)), Pose(-35.0, 0.0, 0.0))  # back at 5 m, as it seems
    beside = Candidate(Edge(8, 41, Pose(0.0, 0.0, 0.0), np.eye(3)), True, "")
    drive_on(keyframes, 1)
    assert finder.find(keyframes, beside, True) == 9
    assert finder.find(keyframes, None, True) is None
    drive_on(keyframes, 1)
    assert finder.find(keyframes, None, True) == 7


def test_while_another_part_is_not_connected_it_has_four_of_five_turns():
    keyframes, places, rows = make_two_parts(), LoopPlaces(SlamSettings()), []
    drive_on(keyframes, 17)
    keyframes.add(100, np.zeros((0, 2)), Pose(-16.0, 0.0, 0.0))  # near the beginning of its own part
    for _ in range(6):
        drive_on(keyframes, 1)
        rows.append(places.find_next(keyframes, measured=True).row)
    assert [row <= 30 for row in rows] == [True, True, True, True, False, True]


# --- observability


def test_a_bare_corridor_leaves_its_direction_open_and_a_corner_none():
    along = np.column_stack([np.linspace(-6.0, 6.0, 200), np.ones(200)])
    corridor = np.concatenate([along, along * [1.0, -1.0]])
    openness = measure_openness(corridor)
    assert np.abs(openness.direction) == pytest.approx([1.0, 0.0], abs=1e-6)
    assert openness.ratio < 1e-6
    corner = np.concatenate([along, along[:, ::-1]])
    assert measure_openness(corner).ratio > 0.9


def test_what_lies_beyond_the_reach_of_the_map_fixes_nothing():
    along = np.column_stack([np.linspace(-6.0, 6.0, 200), np.ones(200)])
    end = np.column_stack([np.full(30, 8.0), np.linspace(-1.0, 1.0, 30)])
    corridor = np.concatenate([along, along * [1.0, -1.0], end])
    assert measure_openness(corridor, 9.0).ratio > 0.05
    assert measure_openness(corridor, 7.0).ratio < 1e-6
    nothing = measure_openness(corridor, 0.5)
    assert (nothing.ratio, *nothing.direction) == (0.0, 1.0, 0.0)


class Answers:
    """An ICP that always answers the same."""

    def __init__(self, pose):
        self.match = Match(pose, True, 5, 0.01, 100)

    def register(self, target, source, guess):
        return self.match


def test_an_icp_keeps_its_guess_along_a_bare_corridor_and_its_answer_across():
    along = np.column_stack([np.linspace(-6.0, 6.0, 200), np.ones(200)])
    cloud = Cloud(np.concatenate([along, along * [1.0, -1.0]]))
    icp = ObservableIcp(Answers(Pose(0.4, 0.3, 0.0)), 0.5)
    answer = icp.register(cloud, cloud, Pose(1.0, 0.0, 0.0)).target_from_source
    assert answer.row == pytest.approx([1.0, 0.3, 0.0])
    icp.is_closed = True
    assert icp.register(cloud, cloud, Pose(1.0, 0.0, 0.0)).target_from_source.row == pytest.approx([0.4, 0.3, 0.0])


def test_a_wall_that_is_not_in_the_target_fixes_nothing():
    along = np.column_stack([np.linspace(-6.0, 6.0, 200), np.ones(200)])
    corridor = np.concatenate([along, along * [1.0, -1.0]])
    end = np.column_stack([np.full(30, 8.0), np.linspace(-1.0, 1.0, 30)])
    source = Cloud(np.concatenate([corridor, end]))
    icp = ObservableIcp(Answers(Pose(0.0, 0.1, 0.0)), 0.3)
    for target, x in ((corridor, 0.5), (source.points, 0.0)):
        answer = icp.register(Cloud(target), source, Pose(0.5, 0.0, 0.0)).target_from_source
        assert answer.row == pytest.approx([x, 0.1, 0.0], abs=1e-6)
    nothing = Cloud(np.zeros((0, 2)))
    assert icp.register(nothing, source, Pose(0.5, 0.0, 0.0)).target_from_source.x == 0.5
    assert icp.register(source, nothing, Pose(0.5, 0.0, 0.0)).target_from_source.x == 0.5


def test_a_round_room_leaves_the_turn_about_its_middle_open_and_a_square_one_none():
    angles = np.linspace(-np.pi, np.pi, 200, endpoint=False)
    circle = np.column_stack([0.5 + 2.0 * np.cos(angles), -0.3 + 2.0 * np.sin(angles)])
    openness = measure_openness(circle)
    assert openness.open_turn == 1.0
    assert openness.centre == pytest.approx([0.5, -0.3], abs=0.01)
    assert not openness.is_closed
    side = np.column_stack([np.linspace(-3.0, 3.0, 100), np.full(100, 3.0)])
    square = measure_openness(np.concatenate([side, -side, side[:, ::-1], -side[:, ::-1]]))
    assert square.open_turn == 0.0
    assert square.is_closed


def test_an_icp_keeps_the_heading_of_its_guess_in_a_round_room_and_its_answer_for_the_middle():
    angles = np.linspace(-np.pi, np.pi, 200, endpoint=False)
    cloud = Cloud(np.column_stack([0.5 + 2.0 * np.cos(angles), -0.3 + 2.0 * np.sin(angles)]))
    icp = ObservableIcp(Answers(Pose(0.4, 0.3, 0.5)), 1.0)
    pose = icp.register(cloud, cloud, Pose(5.0, 6.0, -0.2)).target_from_source
    assert pose.theta == pytest.approx(-0.2)
    middle = np.array([[0.5, -0.3]])
    assert pose.transform(middle) == pytest.approx(Pose(0.4, 0.3, 0.5).transform(middle), abs=0.01)


def test_a_scan_of_too_few_points_after_one_that_was_not_compared_leaves_none_to_compare_with():
    angles, away = np.linspace(-np.pi, np.pi, 400, endpoint=False), Pose(20.0, 0.0, 0.0)
    room = np.column_stack([3.0 * np.cos(angles), 3.0 * np.sin(angles)])
    for between, lost in (([], True), ([room], False)):
        continuity = Continuity()
        continuity.keep(room, Pose(), Pose())
        assert not continuity.is_lost(room, Pose(), False, room)
        for scan in [*between, room[:12]]:
            continuity.keep(scan, away, Pose())
        assert (
            continuity.is_lost(room, away, False, room) is lost
        )  # with nothing in between: the first one saw nothing there
