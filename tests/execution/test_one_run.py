"""A run executed by the worker, in this process: its times, files and notes."""

import errno
import gc
import io
import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from evalkit import metrics
from evalkit.core.errors import MachineFault
from evalkit.core.ground_truth import Truth
from evalkit.core.odometry_estimate import OdometryEstimate, StageEstimate
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, Score
from evalkit.core.scan import Frame, Scan
from evalkit.core.timing import CallTiming
from evalkit.execution import one_run
from evalkit.execution.one_run import Request
from evalkit.metrics.metric import Evidence
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.specs import OdometrySpec
from evalkit.plugins.stored_frames import write_frames
from evalkit.results.final_files import CLOSURES, FINAL, PATHS, parse_final, parse_paths
from evalkit.results.store import whole_records

pytestmark = pytest.mark.usefixtures("strangers")

ROOM = {"laps": 0.02, "seed": 3}


def execute_request(folder, backend="wheel-odometry", parameters=None, dataset="straight", sequence=None):
    if dataset == "straight":
        sequence = {"scans": 12, "backwards": 0, "file": "", "breaks": False, "reads_until": "", **(sequence or {})}
    request = Request(backend, parameters or {}, dataset, sequence or {})
    result, steps = one_run.execute_request(request, folder), folder / "steps.bin"
    return result, whole_records(steps.read_bytes() if steps.exists() else b"")


def test_the_warm_up_is_another_instance_so_the_first_answer_is_the_identity(tmp_path):
    outcome, steps = execute_request(tmp_path)
    assert (outcome.status, outcome.reason, outcome.expected, outcome.warm_up_scans) == ("complete", "", 12, 5)
    assert steps[["x", "y", "theta"]][0].tolist() == (0.0, 0.0, 0.0)
    assert steps["x"].tolist() == pytest.approx([0.1 * k for k in range(12)])
    assert json.loads((tmp_path / "started.json").read_text()) == {"expected": 12, "every": 1, "warm_up_scans": 5}


def test_a_run_of_a_comparison_loads_no_library_that_it_does_not_use(tmp_path):
    """Neither what reads or simulates the data, nor what searches the installed packages, nor pools of processes."""
    sha256 = write_frames(registry.dataset("room").open(ROOM), tmp_path / "frames", tmp_path)
    address = registry.find_address("backends", "wheel-odometry")
    program = (
        "import json, sys\nfrom pathlib import Path\nfrom evalkit.execution import one_run\n"
        f"frames = one_run.FramesFile({str(tmp_path / 'frames')!r}, {sha256!r})\n"
        f"request = one_run.Request('wheel-odometry', {{}}, 'room', {ROOM!r}, None, frames, {address!r})\n"
        "result = one_run.execute_request(request, Path(sys.argv[1]))\n"
        "print(json.dumps([result.reason, *sys.modules]))"
    )
    ended = subprocess.run([sys.executable, "-c", program, tmp_path], capture_output=True, text=True, check=True)
    reason, *loaded = json.loads(ended.stdout)
    assert reason == ""
    heavy = {
        "scipy", "pandas", "matplotlib", "numpy.ma", "evalkit.odometry.map_localisation", "evalkit.metrics",
        "evalkit_datasets", "importlib.metadata", "multiprocessing", "concurrent.futures",
    }  # fmt: skip
    assert heavy & set(loaded) == set()


def test_garbage_is_collected_from_the_warm_up_on_and_not_among_what_is_loaded(tmp_path):
    frozen = gc.get_freeze_count()
    execute_request(tmp_path)
    assert gc.get_freeze_count() == frozen  # a process that collects garbage already goes on as it is
    gc.disable()
    try:
        execute_request(tmp_path)
        assert gc.isenabled()
        assert gc.get_freeze_count() > frozen + 1000
    finally:
        gc.enable()
        gc.unfreeze()


def test_a_sequence_shorter_than_the_warm_up_is_all_warm_up_and_all_run(tmp_path):
    outcome, steps = execute_request(tmp_path, sequence={"scans": 3})
    assert (outcome.warm_up_scans, outcome.expected, len(steps)) == (3, 3, 3)


def test_an_odometry_has_no_residuals_and_a_registration_has_those_of_both_stages(tmp_path):
    _, steps = execute_request(tmp_path)
    assert np.isnan(steps["s2s_error"]).all()
    assert (steps["s2m_inliers"] == 0).all()
    parameters = frontend.complete_parameters("t", registry.backend("paper"), {})
    (tmp_path / "paper").mkdir()
    outcome, steps = execute_request(tmp_path / "paper", "paper", parameters, "room", ROOM)
    assert outcome.status == "complete"
    assert np.isnan(steps["s2s_error"][0])
    assert (steps["s2s_error"][1:] > 0).all()
    assert (steps["s2m_inliers"][1:] > 100).all()
    assert (steps["s2s_accepted"][0], steps["s2m_accepted"][0], steps["s2m_converged"][0]) == (-1, -1, -1)
    assert (steps["s2s_accepted"][1:] == 1).all()
    assert (steps["s2m_accepted"][1:] == 1).all()
    assert set(steps["s2m_converged"][1:].tolist()) <= {0, 1}


def shares(outcome, steps):
    run = replace(outcome, steps=steps)
    found = metrics.compute_scores(Evidence(run, Truth("none")))
    return found["guess_kept_percent"], found["not_converged_percent"]


def test_a_method_without_registrations_is_complete_and_kept_every_guess(tmp_path):
    given = {"max_correspondence_m": 0.0001}
    parameters = frontend.complete_parameters("t", registry.backend("paper"), given)
    outcome, steps = execute_request(tmp_path, "paper", parameters, "room", ROOM)
    assert outcome.status == "complete"
    assert shares(outcome, steps)[0] == Score(100.0, len(steps) - 1)


def test_an_odometry_without_reports_is_marked_as_not_reporting(tmp_path):
    assert {score.reason for score in shares(*execute_request(tmp_path))} == {"not reported by the back end"}


class Doubtful:
    """Odometry that does not accept every other result."""

    def __init__(self):
        self.scans = 0

    def update(self, frame):
        self.scans += 1
        return OdometryEstimate(Pose(), accepted=self.scans % 2 == 0 if self.scans > 1 else None)


def test_an_odometry_can_report_whether_its_result_is_accepted(tmp_path, monkeypatch):
    spec = OdometrySpec(Doubtful, "for a test", "none", "MIT")
    monkeypatch.setattr(registry, "backend", lambda *_: spec)
    outcome, steps = execute_request(tmp_path)
    assert steps["s2m_accepted"].tolist() == [-1, *[1, 0] * 5, 1]
    assert (steps["s2s_accepted"] == -1).all()
    assert [score.value for score in shares(outcome, steps)] == [pytest.approx(500.0 / 11.0), None]


class TwoStaged:
    """Odometry that reports two stages, like the front end."""

    def update(self, frame):
        stages = {"s2s": StageEstimate(True, True, 7, 0.02, 90), "s2m": StageEstimate(False, False, 40, 0.05, 12)}
        return OdometryEstimate(Pose(), stages)


def test_an_odometry_can_report_its_stages(tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "backend", lambda *_: OdometrySpec(TwoStaged, "a test", "none", "MIT"))
    _, steps = execute_request(tmp_path)
    assert set(steps[["s2s_iterations", "s2s_inliers", "s2s_accepted", "s2s_converged"]].tolist()) == {(7, 90, 1, 1)}
    assert set(steps[["s2m_iterations", "s2m_inliers", "s2m_accepted", "s2m_converged"]].tolist()) == {(40, 12, 0, 0)}
    assert set(steps["s2m_error"].tolist()) == {0.05}


@pytest.mark.parametrize("number", [(bool, int, float), (np.bool_, np.int64, np.float32), (int, float, np.float64)])
def test_a_record_holds_what_numpy_makes_of_its_values(number):
    flag, count, real = number
    stage = StageEstimate(flag(1), flag(0), count(7), real(0.25), count(300))
    estimate = OdometryEstimate(Pose(real(1.5), 2.0, -0.5), {"s2s": stage, "s2m": stage}, corrected=flag(1))
    frame = Frame(Scan(123, np.ones(2), np.zeros(2), 0.1, 9.0))
    record = one_run._record_step(frame, estimate, CallTiming(5, 4, 3, 2, 1), 6)
    expected = (123, 1.5, 2.0, -0.5, 5, 4, 3, 6, 2, 1, 0.25, 7, 300, 0.25, 7, 300, 1, 0, 1, 0, 1)
    assert np.frombuffer(record, STEP).tolist() == [expected]


def test_a_slam_leaves_its_corrected_poses_and_loop_closures_beside_its_steps(tmp_path):
    outcome, steps = execute_request(tmp_path, "faulty-slam", {"fault": "none"})
    assert (outcome.status, outcome.reason, len(steps)) == ("complete", "", 12)
    assert steps["y"].tolist() == [0.0] * 12
    assert steps["corrected"].tolist() == [0] * 7 + [1] + [0] * 4
    files = {name: (tmp_path / name).read_bytes() for name in (FINAL, CLOSURES)}
    final, closures = parse_final(files, steps["stamp_ns"])
    assert final.poses[:, 1].tolist() == [0.0, *[0.01] * 11]
    assert [(one.accepted, one.reason) for one in closures] == [(False, "score 0.2 < 0.6"), (True, "score 0.9")]
    assert outcome.final_cpu_ns > 0
    (correction,) = parse_paths((tmp_path / PATHS).read_bytes(), steps["stamp_ns"])
    assert correction.stamp_ns == steps["stamp_ns"][7]
    assert correction.moved_m.tolist() == [0.0, *[0.01] * 6]


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("missing", "ValueError: trajectory() returned 11 poses for 12 answered frames"),
        ("nan", "ValueError: trajectory() returned a pose that is not finite"),
        ("list", "TypeError: trajectory() returned a list, expected an evalkit.Trajectory"),
        ("raise", "RuntimeError: the graph is torn"),
        ("stranger", "ValueError: loop_closures() refers at index 1 to -1 ns, where no frame was answered"),
    ],
)
def test_a_slam_with_a_wrong_end_has_failed_and_keeps_its_answers(tmp_path, fault, reason):
    outcome, steps = execute_request(tmp_path, "faulty-slam", {"fault": fault})
    assert (outcome.status, outcome.reason, len(steps)) == ("failed", reason, 12)
    assert outcome.paths_left_out.startswith("" if fault == "stranger" else "no path after scan 8: ")
    assert not (tmp_path / FINAL).exists()


@pytest.mark.parametrize(
    ("at", "place", "warm_up_scans"),
    [(3, "at scan 4 of the warm-up (stamp 300000000 ns)", 3), (8, "at scan 9 (stamp 800000000 ns)", 5)],
)
def test_an_exception_names_its_scan(tmp_path, at, place, warm_up_scans):
    outcome, steps = execute_request(tmp_path, "faulty", {"fault": "raise", "at": at})
    assert outcome.reason == f"RuntimeError: lost the plot; {place}"
    assert (outcome.warm_up_scans, len(steps)) == (warm_up_scans, 0 if at == 3 else at)


def test_the_notes_of_the_sequence_are_stored(tmp_path):
    outcome, _ = execute_request(tmp_path, dataset="room", sequence=ROOM)
    assert outcome.notes["invalid ranges"] > 0


def test_missing_libraries_and_missing_data_have_their_own_statuses(tmp_path):
    outcome, steps = execute_request(tmp_path, "absent")
    assert outcome.status == "not-installed"
    assert outcome.reason == "absent: not installed; the library 'nowhere' is not installed; pip install nowhere"
    assert len(steps) == 0
    outcome, _ = execute_request(tmp_path, sequence={"file": str(tmp_path / "gone")})
    assert outcome.status == "data-missing"


class FullDisk(io.RawIOBase):
    """A file on a disk that is full after some bytes: the write that does not fit is cut short, the next one fails."""

    def __init__(self, space):
        self.space, self.content = space, b""

    def writable(self):
        return True

    def write(self, data):
        if not self.space:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written = bytes(data)[: self.space]
        self.space -= len(written)
        self.content += written
        return len(written)


@pytest.mark.parametrize("space", [3 * STEP.itemsize, 3 * STEP.itemsize + 7])
def test_a_full_disk_is_a_fault_of_the_machine_and_no_record_begins_inside_another(space):
    parameters = {"scans": 12, "backwards": 0, "file": "", "breaks": False, "reads_until": ""}
    sequence = registry.dataset("straight").make(**parameters)
    odometry = registry.backend("faulty").make(fault="none", at=0)
    disk = FullDisk(space)
    with pytest.raises(MachineFault, match="repeat with --resume") as raised:
        one_run.record_run(odometry, sequence.frames(), one_run.Request("faulty", {}, "straight", {}), disk)
    assert one_run.cause_of(raised.value)[0] == "machine fault"
    assert len(whole_records(disk.content)) == 3
    assert one_run.cause_of(OSError(errno.ENOSPC, "in the back end's own code"))[0] == "exception"


def test_a_perturbed_recording_changes_the_lengths_of_the_back_end_and_no_other_parameter():
    values = frontend.complete_parameters("t", registry.backend("paper"), {})
    request = Request("paper", values, "straight", {"nuisance": 3})
    changed = one_run.find_run_parameters(request)
    lengths = {one.name for one in frontend.settable_parameters(registry.backend("paper")) if one.unit == "m"}
    different = {name for name in values if changed[name] != values[name]}
    assert different
    assert different <= lengths
    assert all(changed[name] == pytest.approx(values[name], rel=0.01) for name in different)
    assert one_run.find_run_parameters(replace(request, dataset_parameters={})) == values
