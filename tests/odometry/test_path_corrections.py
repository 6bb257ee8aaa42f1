"""The path before and after each correction of a SLAM: as it had it, bounded, and outside the time of the scans."""

import io

import numpy as np
import pytest

from evalkit.core import se2, timing
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.path_correction import PathCorrection
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP
from evalkit.core.scan import Frame, Scan
from evalkit.core.trajectory import Trajectory
from evalkit.execution import one_run
from evalkit.execution.one_run import Request, record_run
from evalkit.odometry import path_corrections
from evalkit.odometry.frontend import make_odometry
from evalkit.odometry.path_corrections import PathRecorder
from evalkit.plugins import registry
from evalkit.results.final_files import format_paths, parse_paths
from evalkit.results.store import whole_records

AT = (3, 7, 10)


class Stretching:
    """Poses 1 m apart in x. Frames ``at`` move all earlier poses but the first by 0.1 m in y; it goes on there."""

    def __init__(self, at=AT, work=lambda: None, broken_after=99):
        self.at, self.work, self.broken_after = at, work, broken_after
        self.stamps, self.poses, self.asked = [], [], 0

    def update(self, frame):
        number = len(self.stamps)
        self.stamps.append(frame.scan.stamp_ns)
        if corrects := number in self.at:
            for pose in self.poses[1:]:
                pose[1] += 0.1
        y = 0.1 * sum(number >= at for at in self.at)
        self.poses.append([float(number), y, 0.0])
        return OdometryEstimate(Pose(*self.poses[-1]), corrected=corrects)

    def trajectory(self):
        self.asked += 1
        self.work()
        if self.asked > self.broken_after:
            raise RuntimeError("the graph is torn")
        return Trajectory(self.stamps, self.poses)


class Frames:
    def __init__(self, count):
        self.count = count

    def frames(self):
        return (Frame(Scan(index * 100_000_000, np.ones(2), np.zeros(2), 0.1, 9.0)) for index in range(self.count))


def run(slam, sequence):
    """The recorder and the records of a SLAM's run."""
    steps = io.BytesIO()
    recorder = PathRecorder(slam, lambda: whole_records(steps.getvalue()))
    record_run(slam, sequence.frames(), Request("slam", {}, "frames", {}), steps, recorder)
    return recorder, whole_records(steps.getvalue())


def test_each_correction_has_the_path_before_and_after_it():
    recorder, steps = run(Stretching(), Frames(12))
    assert [one.stamp_ns for one in recorder.corrections] == steps["stamp_ns"][list(AT)].tolist()
    for number, one in enumerate(recorder.corrections):
        assert one.stamps_ns.tolist() == steps["stamp_ns"][: AT[number]].tolist()
        # by hand: before the second correction (frame 7), poses 1 to 6 are at y = 0.1, and after it at 0.2
        assert one.before[1:, 1] == pytest.approx(0.1 * number)
        assert one.after[1:, 1] == pytest.approx(0.1 * (number + 1))
        assert one.moved_m.tolist() == pytest.approx([0.0] + [0.1] * (AT[number] - 1))
    assert recorder.left_out == ""


@pytest.mark.parametrize("work", [0, 200_000])
def test_the_path_before_is_the_trajectory_of_that_moment(work):
    """A second instance is asked after every scan of the same drive. With ``work``, loops close in slices."""
    spec = registry.backend("embedded-slam")
    settings = {one.name: one.default for one in spec.parameters} | {"work": work}
    loop = registry.dataset("loop").make(seed=1, laps=1.3, rate_hz=5.0)
    recorder, _ = run(make_odometry(spec, settings), loop)
    watched, seen = make_odometry(spec, settings), []
    for frame in loop.frames():
        corrected = watched.update(frame).corrected
        seen.append((frame.scan.stamp_ns, corrected, watched.trajectory()))
    expected = [(seen[at - 1][2], *one) for at, one in enumerate(seen) if one[1]]
    assert len(recorder.corrections) == len(expected) > 0
    for found, (before, stamp_ns, _, after) in zip(recorder.corrections, expected, strict=True):
        assert found.stamp_ns == stamp_ns
        rows = np.searchsorted(before.stamps_ns, found.stamps_ns)
        apart = se2.between(before.poses[rows], found.before)
        assert np.abs(apart).max() < 1e-9  # m, rad
        np.testing.assert_array_equal(after.poses[rows], found.after)
        assert found.moved_m.max() > 0.01
        everywhere = np.linalg.norm(after.poses[: len(before), :2] - before.poses[:, :2], axis=1)
        assert found.moved_m.max() == pytest.approx(everywhere.max(), abs=1e-9)


class Clock:
    """A clock on which only the work of a trajectory takes time: 0.2 s."""

    def __init__(self):
        self.now_ns = 0

    def work(self):
        self.now_ns += 200_000_000

    def perf_counter(self):
        return 1e-9 * self.now_ns

    def perf_counter_ns(self):
        return self.now_ns

    process_time_ns = perf_counter_ns


def test_a_slow_trajectory_is_in_no_time_of_a_scan_and_changes_no_answer(monkeypatch):
    quick, clock = run(Stretching(), Frames(12)), Clock()
    for module in (path_corrections, one_run, timing):
        monkeypatch.setattr(module, "time", clock)
    slow = run(Stretching(work=clock.work), Frames(12))
    assert slow[0]._asking_s == pytest.approx(0.2 * len(AT))
    for name in ("wall_ns", "cpu_ns", "harness_ns"):
        assert slow[1][name].max() == 0, name
    for name in ("stamp_ns", "x", "y", "theta", "corrected"):
        np.testing.assert_array_equal(quick[1][name], slow[1][name])


def test_corrections_and_their_poses_are_bounded(monkeypatch):
    monkeypatch.setattr(path_corrections, "MAX_CORRECTIONS", 2)
    monkeypatch.setattr(path_corrections, "MAX_POSES", 4)
    slam = Stretching((20, 40, 60))
    recorder, steps = run(slam, Frames(80))
    assert recorder.left_out == "the paths of at most 2 corrections are kept"
    assert slam.asked == 2
    assert [len(one.stamps_ns) for one in recorder.corrections] == [4, 4]
    for one, at in zip(recorder.corrections, (20, 40), strict=True):
        assert {0, at - 1} <= set(np.searchsorted(steps["stamp_ns"], one.stamps_ns).tolist())


def test_asking_ends_where_it_takes_too_long_or_fails(monkeypatch):
    broken, _ = run(Stretching(broken_after=1), Frames(12))
    assert (len(broken.corrections), broken.left_out) == (1, "no path after scan 8: RuntimeError: the graph is torn")
    clock = Clock()
    monkeypatch.setattr(path_corrections, "time", clock)
    monkeypatch.setattr(path_corrections, "MAX_ASKING_S", 0.3)
    slow, _ = run(Stretching(work=clock.work), Frames(12))
    assert (len(slow.corrections), slow.left_out) == (2, "asking for the paths took more than 0.3 s")


def test_a_correction_at_the_first_frame_has_no_earlier_path():
    recorder, _ = run(Stretching((0, 2)), Frames(4))
    assert [one.stamp_ns for one in recorder.corrections] == [200_000_000]


def test_path_corrections_are_stored_to_the_bit():
    recorder, steps = run(Stretching(), Frames(12))
    again = parse_paths(format_paths(recorder.corrections, steps["stamp_ns"]), steps["stamp_ns"])
    assert [one.stamp_ns for one in again] == [one.stamp_ns for one in recorder.corrections]
    for found, stored in zip(recorder.corrections, again, strict=True):
        for name in ("stamps_ns", "before", "after"):
            np.testing.assert_array_equal(getattr(found, name), getattr(stored, name))
    assert parse_paths(format_paths([], steps["stamp_ns"]), steps["stamp_ns"]) == ()


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda rows: rows[:, :7], "rows of 7 numbers, expected 8"),
        (lambda rows: rows[::-1], "corrections that are not in the order of time"),
        (lambda rows: np.where(rows == 10.0, 12.0, rows), "a number of a step that is not one of 0 to 11"),
        (lambda rows: np.where(rows == 10.0, 9.5, rows), "a number of a step that is not one of 0 to 11"),
        (lambda rows: rows * [1, 0, 1, 1, 1, 1, 1, 1], "stamps_ns: expected at least one, strictly increasing"),
        (lambda rows: rows * [1, 1, np.nan, 1, 1, 1, 1, 1], "expected finite poses"),
    ],
)
def test_damaged_path_corrections_are_refused(change, what):
    recorder, steps = run(Stretching(), Frames(12))
    body = io.BytesIO()
    np.save(body, change(np.load(io.BytesIO(format_paths(recorder.corrections, steps["stamp_ns"])))))
    with pytest.raises(ValueError, match=rf"path_corrections.npy is damaged: .*{what}"):
        parse_paths(body.getvalue(), steps["stamp_ns"])


def test_a_path_correction_is_of_earlier_frames():
    with pytest.raises(ValueError, match="all before stamp_ns"):
        PathCorrection(5, np.array([1, 5]), np.zeros((2, 3)), np.zeros((2, 3)))


def test_a_record_without_corrections_asks_nothing():
    slam = Stretching(())
    recorder, steps = run(slam, Frames(5))
    assert (recorder.corrections, slam.asked, steps.dtype) == ([], 0, STEP)
