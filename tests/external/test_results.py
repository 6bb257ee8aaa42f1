"""External trajectories as back ends: scans covered by the file are answered, others are not."""

import re

import numpy as np
import pytest

from evalkit.core.errors import BadData, BadParameter
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.run_result import RunResult
from evalkit.core.scan import Frame, Scan
from evalkit.core.trajectory import Trajectory
from evalkit.io.tum import format_tum, read_tum
from evalkit.metrics import runtime
from evalkit.metrics.metric import Evidence
from evalkit.plugins import registry
from evalkit.plugins.parameters import resolve_parameters
from evalkit.plugins.protocols import NoAnswer
from evalkit.plugins.result_files import parse_address, read_trajectory

STAMPS = np.arange(40) * 100_000_000


@pytest.fixture
def poses(tmp_path):
    """Write a trajectory in TUM format; returns its method name."""

    def write(stamps_ns, rows):
        path = tmp_path / "poses.tum"
        path.write_text(format_tum(Trajectory(stamps_ns, rows)))
        return f"file:{path}"

    return write


def rows_of(steps):
    return np.stack([steps["x"], steps["y"], steps["theta"]], axis=1)


def make_odometry(name, **given):
    spec = registry.backend(name)
    return spec.make(**resolve_parameters(name, spec.parameters, given))


def at(stamp_ns, base_from_sensor=None):
    return Frame(Scan(stamp_ns, np.array([1.0]), np.zeros(1), 0.1, 9.0), base_from_sensor or Pose())


def test_the_answers_are_the_poses_of_the_file_relative_to_the_first(poses, run_backend):
    world_from_start = Pose(3.0, -2.0, 1.0)
    outcome, steps = run_backend(poses(STAMPS, Trajectory(STAMPS, run_backend.truth).moved(world_from_start).poses))
    assert (outcome.status, len(steps)) == ("complete", 40)
    assert rows_of(steps) == pytest.approx(run_backend.truth, abs=1e-8)


def test_times_of_a_trajectory_file_are_not_reported(poses, run_backend):
    _, steps = run_backend(poses(STAMPS, run_backend.truth))
    assert not steps["wall_ns"].any()
    assert not steps["cpu_ns"].any()
    run = RunResult(steps, 40)
    scores = {m.name: m.compute(Evidence(run, Truth("none"))) for m in runtime.METRICS}
    names = ("wall_median_ms", "cpu_median_ms", "real_time_factor", "late_percent", "device_median_ms")
    assert [scores[name].value for name in names] == [None] * 5
    assert scores["wall_median_ms"].reason == "the poses were computed elsewhere"


def test_poses_are_interpolated_if_they_are_not_too_far_apart(poses):
    name = poses(np.array([0, 1_000_000_000, 5_000_000_000]), np.array([[0.0, 0, 0], [1.0, 0, 0.2], [2.0, 0, 0]]))
    follower = make_odometry(name)
    assert follower.update(at(0)).pose == Pose()
    assert follower.update(at(250_000_000)).pose.row == pytest.approx([0.25, 0.0, 0.05])
    with pytest.raises(NoAnswer, match=r"no pose near 3\.000 s; it reaches from 0\.000 s to 5\.000 s"):
        follower.update(at(3_000_000_000))
    assert make_odometry(name, max_gap_s=4.0).update(at(3_000_000_000)).pose == Pose()


def test_outside_the_time_span_only_a_pose_within_the_tolerance_is_used(poses):
    follower = make_odometry(poses(STAMPS, np.zeros((40, 3))), tolerance_s=0.05)
    assert follower.update(at(-50_000_000)).pose == Pose()
    for stamp_ns in (-51_000_000, int(STAMPS[-1]) + 51_000_000):
        with pytest.raises(NoAnswer):
            follower.update(at(stamp_ns))


def test_poses_of_the_sensor_are_converted_to_the_base(poses):
    base_from_sensor = Pose(0.2, 0.0, np.pi / 2)
    truth = Trajectory(np.array([0, 10]), np.array([[0.0, 0, 0], [1.0, 0, 0.5]]))
    world_from_sensor = np.array([(Pose.of(row) @ base_from_sensor).row for row in truth.poses])
    follower = make_odometry(poses(truth.stamps_ns, world_from_sensor), poses_of="sensor")
    assert follower.update(at(0, base_from_sensor)).pose == Pose()
    assert follower.update(at(10, base_from_sensor)).pose.row == pytest.approx([1.0, 0.0, 0.5], abs=1e-8)


def test_a_scan_missing_from_the_file_is_unanswered_and_the_run_is_complete(poses, run_backend):
    outcome, steps = run_backend(poses(STAMPS[2:], run_backend.truth[2:]))  # 38 of 40: 95 %
    assert (outcome.status, outcome.expected) == ("complete", 40)
    assert steps["stamp_ns"].tolist() == STAMPS[2:].tolist()


def test_a_run_with_more_than_one_unanswered_scan_in_twenty_has_failed(poses, run_backend):
    outcome, steps = run_backend(poses(STAMPS[:30], run_backend.truth[:30]))
    assert outcome.status == "failed"
    assert "no answer for 10 of 40 scans" in outcome.reason
    assert "it reaches from 0.000 s to 2.900 s" in outcome.reason
    assert len(steps) == 30


def test_unclosed_quotation_marks_are_rejected():
    with pytest.raises(BadParameter, match="No closing quotation"):
        registry.backend("file:'poses.tum")


def test_a_missing_file_is_unavailable(tmp_path, run_backend):
    outcome, _ = run_backend(f"file:{tmp_path / 'none.tum'}")
    assert (outcome.status, "no such file: none.tum" in outcome.reason) == ("not-installed", True)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the file is empty"),
        ("# t x y z\n", "no pose in it"),
        ("0 1 2 3\n", "line 1: 4 columns: '0 1 2 3'"),
        ("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 one\n", "line 2"),
        ("0 nan 0 0 0 0 0 1\n", "line 1: a value is not finite"),
        ("0 0 0 0 0 0 0 0\n", "quaternion of length 0"),
        ("nan 0 0 0 0 0 0 1\n", "line 1"),
        ("1e400 0 0 0 0 0 0 1\n", "line 1"),
    ],
)
def test_an_unreadable_file_fails_with_its_line(tmp_path, run_backend, text, said):
    path = tmp_path / "poses.tum"
    path.write_text(text)
    outcome, _ = run_backend(f"file:{path}")
    assert outcome.status == "failed"
    assert said in outcome.reason
    with pytest.raises(BadData, match=re.escape(said)):
        read_tum(path)


def test_times_keep_every_nanosecond_and_their_order(tmp_path):
    path = tmp_path / "poses.tum"
    path.write_text(
        "976052857.337284002, 1, 0, 0, 0, 0, 0, 1\n976052857.337284001 0 0 0 0 0 0 1 # late\n"
        "976052857.337284001 7 0 0 0 0 0 1\n"
    )
    trajectory = read_tum(path).trajectory
    assert trajectory.stamps_ns.tolist() == [976052857337284001, 976052857337284002]
    assert trajectory.poses[:, 0].tolist() == [0.0, 1.0]


def test_the_cache_key_contains_the_content_of_the_file(poses):
    name = poses(STAMPS, np.zeros((40, 3)))
    before = registry.hash_run_code(name, "room")
    poses(STAMPS, np.ones((40, 3)))
    assert registry.hash_run_code(name, "room") != before


def write_tum(path, stamps_ns, rows):
    path.write_text(format_tum(Trajectory(stamps_ns, rows)))
    return path


def test_a_second_file_gives_the_corrected_poses_relative_to_the_first(tmp_path, run_backend):
    online = write_tum(tmp_path / "online.tum", STAMPS, run_backend.truth)
    corrected = run_backend.truth + np.linspace(0.0, 0.4, 40)[:, None] * [0.0, 1.0, 0.0]
    moved = Trajectory(STAMPS, corrected).moved(Pose(-7.0, 2.0, 2.0)).poses
    name = f"file:{online}?final={write_tum(tmp_path / 'final.tum', STAMPS, moved)}"
    spec = registry.backend(name)
    assert (spec.kind, spec.recorded, spec.missing()) == ("slam", True, "")
    slam = make_odometry(name)
    answers = [slam.update(at(int(stamp))).pose.row for stamp in STAMPS]
    assert np.array(answers) == pytest.approx(run_backend.truth, abs=1e-8)
    final = slam.trajectory()
    expected = Trajectory(STAMPS, corrected).moved(Pose.of(corrected[0]).inverse()).poses
    assert final.poses == pytest.approx(expected, abs=1e-8)
    assert (final.poses[0].tolist(), slam.loop_closures()) == ([0.0, 0.0, 0.0], ())
    outcome, steps = run_backend(name)
    assert (outcome.status, len(steps)) == ("complete", 40)
    other = registry.backend(f"file:{online}?final={write_tum(tmp_path / 'final.tum', STAMPS, corrected)}")
    assert other.digest != spec.digest


def test_corrected_poses_that_do_not_cover_the_answers_fail_with_the_place(tmp_path, run_backend):
    online = write_tum(tmp_path / "online.tum", STAMPS, run_backend.truth)
    name = f"file:{online}?final={write_tum(tmp_path / 'final.tum', STAMPS[:30], run_backend.truth[:30])}"
    outcome, steps = run_backend(name)
    assert (outcome.status, len(steps)) == ("failed", 40)
    assert "final.tum has no pose near 3.000 s; it reaches from 0.000 s to 2.900 s" in outcome.reason
    assert "write a corrected pose for every scan" in outcome.reason
    assert registry.backend(f"file:{online}?final=absent.tum").missing() == (
        "no such file: absent.tum; correct its path"
    )
    for words in ("final=", "topic=/pose&final=", "map=/map&final=x.tum", "final"):
        with pytest.raises(BadData, match="behind its name; write "):
            registry.backend(f"file:{online}?{words}")
    with pytest.raises(BadData, match="name corrected poses for a method only"):
        read_trajectory(f"{online}?final={online}")
    assert parse_address("run.mcap?topic=/odom&final=run.mcap?topic=/slam").final == "run.mcap?topic=/slam"
