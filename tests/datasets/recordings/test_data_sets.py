"""The named recordings: their published error values, if the files are available."""

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.pose import Pose
from evalkit.io.tum import read_tum
from evalkit.plugins import registry
from evalkit.plugins.protocols import Seekable
from evalkit.report.analysis.pairwise import RELATION_ACCURACY, SHARED_ERROR
from evalkit_datasets.parsing import carmen_parser
from evalkit_datasets.recordings import catalog, data_sets

NAMES = list(data_sets.FILES)


def absent(name):
    return registry.dataset(name).missing()


def needs(name):
    return pytest.mark.skipif(bool(absent(name)), reason=f"{name}: files not at hand (set EVALKIT_DATA)")


def sequence_of(name, **parameters):
    return registry.dataset(name).make(**parameters)


def nearest(trajectory, stamps):
    """Return the index of the pose nearest to each time, and its time distance (ns)."""
    right = np.clip(np.searchsorted(trajectory.stamps_ns, stamps), 1, len(trajectory) - 1)
    left = right - 1
    before, after = stamps - trajectory.stamps_ns[left], trajectory.stamps_ns[right] - stamps
    index = np.where(before <= after, left, right)
    return index, np.abs(trajectory.stamps_ns[index] - stamps)


def errors_m(relations, first, second, chosen):
    """Return Kuemmerle's translational error, component-wise, of the selected relations."""
    delta = se2.between(first, second)[chosen] - relations.first_from_second[chosen]
    return np.hypot(delta[:, 0], delta[:, 1])


def keyframe_errors(name):
    """Compare the reference trajectory with the relations whose two times are keyframes."""
    truth = sequence_of(name).truth()
    (first, a), (second, b) = (
        nearest(truth.trajectory, s) for s in (truth.relations.first_ns, truth.relations.second_ns)
    )
    poses = truth.trajectory.poses
    return errors_m(truth.relations, poses[first], poses[second], np.maximum(a, b) <= 1000)


@pytest.mark.parametrize("name", NAMES)
def test_each_spec_has_a_card(name):
    spec = registry.dataset(name)
    assert spec.summary
    assert spec.sensor
    assert spec.truth
    assert spec.citation
    assert spec.licence


@pytest.mark.parametrize("name", [name for name in NAMES if not absent(name)])
def test_every_available_file_equals_its_catalogue_entry(name):
    own = data_sets.needed_files(name)
    drives = [
        file for file in data_sets.files_of(name) if file not in own and catalog.find_local(catalog.get_file(file))
    ]
    assert all(catalog.locate(file).is_file() for file in (*own, *drives))


# --- fr079


@needs("fr079")
def test_fr079_matches_its_card():
    sequence = sequence_of("fr079")
    frames = list(sequence.frames())
    assert len(sequence) == len(frames) == 4791
    assert (frames[-1].scan.stamp_ns - frames[0].scan.stamp_ns) * 1e-9 == pytest.approx(1061.17, abs=0.01)
    assert frames[0].base_from_sensor == Pose(-0.04)
    assert all(frame.odom_from_base is None for frame in frames)
    assert sum(int(frame.scan.no_returns.sum()) for frame in frames) == 36004
    assert len(sequence.truth().relations) == 1685
    assert len(sequence.truth().trajectory) == 1463
    assert sequence.notes() == {"ground-truth poses outside the scans": 1}


def keyframe_residuals(name):
    """Return the motions (K, 3) of the reference trajectory seen from those of the relations, ordered by time."""
    truth = sequence_of(name).truth()
    (first, a), (second, b) = (
        nearest(truth.trajectory, s) for s in (truth.relations.first_ns, truth.relations.second_ns)
    )
    estimated = se2.between(truth.trajectory.poses[first], truth.trajectory.poses[second])
    exact = np.maximum(a, b) <= 1000
    residuals = se2.between(truth.relations.first_from_second, estimated)[exact]
    return residuals[np.argsort(truth.relations.first_ns[exact], kind="stable")]


@pytest.mark.parametrize(
    ("name", "triangles", "one_mm", "shared_mm"),
    [pytest.param(*row, marks=needs(row[0])) for row in (("fr079", 176, 17.3, 7.9), ("intel", 327, 13.2, 3.0))],
)
def test_relations_have_the_accuracy_that_verdicts_assume(name, triangles, one_mm, shared_mm):
    """Three relations of a triangle close to sqrt(3) times the error of one. Errors of successive relations do not
    correlate, and in the mean they differ by a few mm from the reference trajectory.
    """
    relations = sequence_of(name).truth().relations
    motions = {}
    for first, second, motion in zip(relations.first_ns, relations.second_ns, relations.first_from_second, strict=True):
        motions.setdefault(first, {})[second] = motion
        motions.setdefault(second, {})[first] = se2.inverse(motion)
    closed = np.array([
        se2.compose(se2.compose(motions[a][b], motions[b][c]), motions[c][a])
        for a in motions for b in motions[a] if b > a for c in motions[b] if c > b and c in motions[a]
    ])  # fmt: skip
    assert len(closed) == triangles
    one_m = np.hypot(*closed.T[:2]).mean() / np.sqrt(3.0)
    assert one_m == pytest.approx(1e-3 * one_mm, abs=1e-4)
    assert one_m < RELATION_ACCURACY["m"]
    residuals = keyframe_residuals(name)[:, :2]
    shared_m = np.hypot(*residuals.mean(axis=0))
    assert shared_m == pytest.approx(1e-3 * shared_mm, abs=1e-4)
    assert 0.5 * shared_m < SHARED_ERROR * RELATION_ACCURACY["m"]
    away = residuals - residuals.mean(axis=0)
    for lag in (1, 2, 5, 10):
        assert abs((away[:-lag] * away[lag:]).sum()) < 0.1 * (away**2).sum()


@needs("fr079")
def test_fr079_reference_scores_0_043_m_on_the_relations():
    errors = keyframe_errors("fr079")
    assert errors.mean() == pytest.approx(0.043, abs=5e-4)
    assert len(errors) == 136


@needs("fr079")
@pytest.mark.skipif(
    catalog.find_local(catalog.get_file("fr079-gmapping.tum")) is None, reason="fr079-gmapping.tum is absent"
)
def test_fr079_gmapping_scores_0_060_0_042_m_on_the_relations():
    relations = sequence_of("fr079").truth().relations
    gmapping = read_tum(catalog.locate("fr079-gmapping.tum")).trajectory
    everything = np.ones(len(relations), dtype=bool)
    errors = errors_m(relations, gmapping.at(relations.first_ns), gmapping.at(relations.second_ns), everything)
    assert errors.mean() == pytest.approx(0.060, abs=6e-4)
    assert errors.std() == pytest.approx(0.042, abs=6e-4)


# --- intel


@needs("intel")
def test_intel_matches_its_card():
    sequence = sequence_of("intel")
    frames = list(sequence.frames())
    assert len(sequence) == len(frames) == 5438
    assert all(frame.odom_from_base is not None for frame in frames)
    assert frames[0].base_from_sensor == Pose()
    assert len(sequence.truth().relations) == 2984
    assert len(sequence.truth().trajectory) == 2672
    assert (frames[-1].scan.stamp_ns - frames[0].scan.stamp_ns) * 1e-9 == pytest.approx(2690.677, abs=1e-3)
    assert sequence.notes() == {"scans in a gap of the odometry over 1 s": 115}


@pytest.mark.skipif(bool(registry.dataset("intel").missing(drive="exact")), reason="intel: files not at hand")
def test_the_exact_scans_of_intel_are_those_of_the_whole_with_the_same_odometry_and_relations():
    exact, whole = sequence_of("intel", drive="exact"), sequence_of("intel")
    assert (len(exact), len(whole), len(exact.truth().relations)) == (3361, 5438, 2984)
    by_stamp = {frame.scan.stamp_ns: frame for frame in whole.frames()}
    for frame in exact.frames():
        same = by_stamp[frame.scan.stamp_ns]
        np.testing.assert_array_equal(frame.scan.ranges, same.scan.ranges)
        np.testing.assert_array_equal(frame.odom_from_base.row, same.odom_from_base.row)


@needs("intel")
def test_intel_reference_scores_0_029_m_on_the_relations():
    errors = keyframe_errors("intel")
    assert errors.mean() == pytest.approx(0.029, abs=5e-4)
    assert len(errors) == 301


@needs("intel")
@pytest.mark.skipif(
    catalog.find_local(catalog.get_file("intel-gmapping.tum")) is None, reason="intel-gmapping.tum is absent"
)
@pytest.mark.parametrize(("beyond_s", "mean", "spread"), [(0.0, 0.051, 0.052), (0.1, 0.069, 0.081)])
def test_intel_gmapping_on_the_relations_depends_on_how_poses_are_carried(beyond_s, mean, spread):
    """0.051 m if odometry carries every pose to the time of the relation; 0.069 m if only poses more than 0.1 s
    away are carried. The second is the rule of the official evaluator; Kuemmerle et al. print 0.070 +- 0.083
    m.
    """
    relations = sequence_of("intel").truth().relations
    gmapping = read_tum(catalog.locate("intel-gmapping.tum")).trajectory
    log = carmen_parser.Log((-90.0, 0.0))
    for _ in carmen_parser.iter_readings(catalog.locate("intel-built.clf"), log):
        pass  # the log is complete then
    stamps, odometry = log.odometry.stamps_ns, log.odometry.poses

    def carried(times):
        index, away = nearest(gmapping, times)
        since = se2.interpolate(stamps, odometry, gmapping.stamps_ns[index])
        moved = se2.compose(gmapping.poses[index], se2.between(since, se2.interpolate(stamps, odometry, times)))
        return np.where((away > beyond_s * 1e9)[:, None], moved, gmapping.poses[index])

    everything = np.ones(len(relations), dtype=bool)
    errors = errors_m(relations, carried(relations.first_ns), carried(relations.second_ns), everything)
    assert errors.mean() == pytest.approx(mean, abs=5e-4)
    assert errors.std() == pytest.approx(spread, abs=5e-4)


# --- bags


@needs("turtlebot4")
def test_turtlebot4_matches_its_card():
    sequence = sequence_of("turtlebot4")
    frames = list(sequence.frames())
    assert len(frames) == len(sequence) == 357
    np.testing.assert_allclose(frames[0].base_from_sensor.row, [0.004, 0.0, np.pi / 2], atol=1e-4)
    assert frames[0].odom_from_base.row[:2] == pytest.approx([6.54, -8.86], abs=0.005)
    assert all(frame.odom_from_base is not None for frame in frames)
    assert sum(frame.start_from_end is not None for frame in frames) == 356
    no_returns = np.mean([frame.scan.no_returns.mean() for frame in frames])
    assert no_returns == pytest.approx(0.235, abs=0.006)
    assert frames[0].scan.time_increment_ns == pytest.approx(187_091, abs=1)
    path = np.diff([frame.odom_from_base.row[:2] for frame in frames], axis=0)
    assert np.hypot(*path.T).sum() == pytest.approx(8.35, rel=0.02)
    assert sequence.truth().trajectory is None


@needs("turtlebot4")
def test_turtlebot4_shows_the_map_of_its_floor_without_scoring_it():
    truth = sequence_of("turtlebot4").truth()
    assert truth.grid is None
    if truth.plan is None:
        pytest.skip("the map of the floor is not here")
    assert truth.plan.shape == (1706, 903)
    assert (truth.plan.resolution_m, truth.plan.origin_x, truth.plan.origin_y) == (0.03, -1.12, -39.4)
    assert truth.plan.occupied().sum() > 5000


@needs("wheelchair")
@pytest.mark.parametrize(("topic", "count"), [("/left_scan", 435), ("/rear_scan", 435), ("/right_scan", 434)])
def test_wheelchair_has_three_lidars(topic, count):
    frames = list(sequence_of("wheelchair", topic=topic).frames())
    assert len(frames) == count
    assert {len(frame.scan.ranges) for frame in frames} == {768}
    assert frames[0].odom_from_base is None
    assert (frames[-1].scan.stamp_ns - frames[0].scan.stamp_ns) * 1e-9 == pytest.approx(57.8, abs=0.2)


@needs("static")
@pytest.mark.parametrize(("topic", "count"), [("/front_scan", 331), ("/rear_scan", 330)])
def test_static_does_not_move(topic, count):
    sequence = sequence_of("static", topic=topic)
    ranges = np.array([frame.scan.ranges for frame in sequence.frames()])
    assert ranges.shape == (count, 726)
    truth = sequence.truth()
    assert not truth.trajectory.poses.any()
    assert len(truth.trajectory) == count
    steady = np.isfinite(ranges).all(axis=0)
    assert np.median(np.abs(ranges[-1] - ranges[0])[steady]) < 0.02


@pytest.mark.thorough
@needs("backpack")
@pytest.mark.parametrize(("limit", "count", "no_returns"), [(20, 20, 573), (None, 345, 9481)])
def test_backpack_keeps_the_first_echo(limit, count, no_returns):
    frames = list(sequence_of("backpack", **({} if limit is None else {"limit": limit})).frames())
    assert len(frames) == count
    assert {len(frame.scan.ranges) for frame in frames} == {1079}
    assert frames[0].scan.ranges[:4].tolist() == pytest.approx([7.978, 8.151, 8.304, 8.452], abs=1e-6)
    assert sum(int(frame.scan.no_returns.sum()) for frame in frames) == no_returns
    assert frames[0].scan.time_increment_ns == pytest.approx(17_361, abs=1)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.thorough] * (name == "backpack")) for name in NAMES if not absent(name)],
)
def test_start_every_and_limit_shorten_each_recording(name):
    sequence = sequence_of(name, start=2, every=3, limit=4)
    frames = list(sequence.frames())
    assert len(sequence) == len(frames) == 4
    if isinstance(sequence, Seekable):
        for frame, sought in zip(frames[1:], sequence.frames_from(1), strict=True):
            assert np.array_equal(frame.scan.ranges, sought.scan.ranges, equal_nan=True)
            assert (frame.scan.stamp_ns, frame.odom_from_base) == (sought.scan.stamp_ns, sought.odom_from_base)
