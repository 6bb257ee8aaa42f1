"""One run in its own process: every way to end gives a result with a reason and leaves no process behind."""

import json
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from evalkit.config.limits import Limits
from evalkit.core.errors import StoreError
from evalkit.core.run_result import NO_STEPS
from evalkit.execution import run_process, subprocesses
from evalkit.execution.one_run import Request
from evalkit.metrics import runtime

pytestmark = pytest.mark.slow

AT, SCANS = 8, 12
HASTE = Limits(run_s=600.0, scan_s=300.0, memory_mib=1024)
"""Limits that a run keeps on the busiest machine."""

LIMITS = {
    "hang": replace(HASTE, scan_s=1.0),
    "child": replace(HASTE, scan_s=1.0),
    "spin": replace(HASTE, run_s=3.0),
    "leak": replace(HASTE, memory_mib=300),
    "hold": replace(HASTE, scan_s=1.0),
    "daemon": replace(HASTE, scan_s=1.0),
    "spin-in-child": replace(HASTE, scan_cpu_s=1.0),
    "leak-in-child": replace(HASTE, memory_mib=300),
}
"""Limits of the runs with a fault, from its scan on."""


class LimitsFromScan:
    """``HASTE`` until a scan is answered, then others: no run misses them before, however late it gets a core."""

    def __init__(self, scan, limits):
        self._scan, self._limits, self._now = scan, limits, HASTE

    def hear(self, answered):
        """Take the number of answered scans."""
        if answered >= self._scan:
            self._now = self._limits

    def __getattr__(self, name):
        return getattr(self._now, name)


def request(fault="none", at=AT, **dataset):
    sequence = {"scans": SCANS, "backwards": 0, "file": "", "breaks": False, "reads_until": "", **dataset}
    return Request("faulty", {"fault": fault, "at": at}, "straight", sequence)


def execute_run(folder, wanted, limits=HASTE, heard=lambda _: None, stop=None):
    folder.mkdir()
    return run_process.run(wanted, folder, limits, heard, stop or threading.Event())


def execute_run_limited_at(scan, folder, wanted, limits):
    later = LimitsFromScan(scan, limits)
    return execute_run(folder, wanted, later, later.hear)


EXPECTED = (
    ("none", "complete", ""),
    ("segfault", "crashed", "SIGSEGV"),
    ("sigkill", "crashed", "SIGKILL (by the system, where memory ran out)"),
    ("unnamed-signal", "crashed", "signal "),
    ("abort", "crashed", "SIGABRT"),
    ("exit", "failed", "exited with code 3"),
    ("sys-exit", "failed", "exited with code 0"),
    ("raise", "failed", "RuntimeError: lost the plot"),
    ("memory-error", "out-of-memory", "cannot allocate 7 TiB"),
    ("hang", "timeout", f"no answer for 1 s after scan {AT}"),
    ("spin", "timeout", "not finished after 3 s"),
    ("leak", "out-of-memory", "used more than 300 MiB"),
    ("nan", "failed", "pose: not finite"),
    ("unchecked-nan", "failed", "a pose that is not finite: (nan, 0.0, 0.0)"),
    ("farthest", "failed", f"farther away than 10,000,000 m: (1e+300, -1e+300); at scan {AT + 1} "),
    ("no-pose", "failed", "update() returned a tuple, expected an evalkit.OdometryEstimate"),
    ("child", "timeout", "no answer"),
    ("orphan", "failed", "left a child behind"),
    ("garbage", "failed", "code 9; last output: [2J the wheel is off"),
    ("chdir", "complete", ""),
    ("remove-folder", "failed", "folder was removed"),
    ("forge", "failed", "outcome.json contains no valid outcome"),
    ("claim-interruption", "failed", "outcome.json contains no valid outcome"),
    ("claim-numbers", "complete", ""),
    ("scribble", "failed", f"steps.bin is damaged after {AT} answers"),
    ("swell", "failed", f"steps.bin is damaged after {AT} answers"),
    ("pipe", "failed", "outcome.json contains no valid outcome"),
    ("links", "failed", "code 9"),
    ("linger", "complete", ""),
    ("hold", "timeout", f"no answer for 1 s after scan {AT}"),
    ("daemon", "timeout", "no answer for 1 s"),
    ("spin-in-child", "timeout", f"no answer for 1 s of CPU time after scan {AT}"),
    ("leak-in-child", "out-of-memory", "used more than 300 MiB"),
    ("flood", "failed", "code 9; last output: the wheel is off"),
    ("hidden", "complete", ""),
    ("hidden-exit", "failed", "code 9"),
    ("kill-supervisor", "crashed", "terminated by SIGKILL"),
    ("matrix", "failed", "update() returned a ndarray, expected an evalkit.OdometryEstimate"),
)
"""Every fault with the status it ends in and what the reason says."""


def test_a_slam_that_hangs_when_asked_for_its_poses_ends_at_the_limit(tmp_path, strangers):
    sequence = request().dataset_parameters
    slam = Request("faulty-slam", {"fault": "hang"}, "straight", sequence)
    result = execute_run_limited_at(8, tmp_path / "hang", slam, replace(HASTE, scan_s=1.0))
    assert (result.status, result.reason) == ("timeout", "no answer for 1 s after scan 8")  # its eighth update corrects
    assert (len(result.steps), result.final) == (8, None)
    result = execute_run(tmp_path / "end", replace(slam, backend_parameters={"fault": "none"}))
    assert (result.status, len(result.steps), len(result.loop_closures)) == ("complete", SCANS, 2)
    assert result.final.poses[1:, 1].tolist() == [0.01] * (SCANS - 1)
    assert result.final_cpu_ns > 0
    (correction,) = result.path_corrections
    assert correction.stamp_ns == result.steps["stamp_ns"][7]
    assert (correction.before[:, 1].tolist(), correction.after[:, 1].tolist()) == ([0.0] * 7, [0.0] + [0.01] * 6)
    assert result.remarks == (f"no room after {SCANS} scans",)


def test_a_run_whose_process_the_system_does_not_start_has_not_failed(tmp_path, strangers, monkeypatch):
    (tmp_path / "sitecustomize.py").write_text(
        "import errno, os\n"
        "def fork():\n"
        "    raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))\n"
        "os.fork = fork\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    result = execute_run(tmp_path / "run", request())
    assert result.status == "interrupted"
    assert result.reason.startswith("its process could not be started; free disk, memory")


FAULTS = tuple(fault for fault, _, _ in EXPECTED)


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """Return the root of the folders of ``runs``."""
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def earlier():
    """Return the children that this process has of other tests."""
    return set(psutil.Process().children(recursive=True))


@pytest.fixture(scope="module")
def runs(strangers, root, earlier):
    """Execute the runs of all faults at once, because they mostly wait."""

    def one(fault):
        folder = root / fault
        folder = Path(os.path.relpath(folder)) if fault == "chdir" else folder
        return execute_run_limited_at(AT, folder, request(fault), LIMITS.get(fault, HASTE))

    with ThreadPoolExecutor(4) as threads:
        return dict(zip(FAULTS, threads.map(one, FAULTS), strict=True))


@pytest.mark.parametrize("every", [1, 2])
def test_a_subsampled_recording_keeps_the_rate_of_its_sensor(tmp_path, every):
    beams = " ".join(["2.0"] * 180)
    lines = [f"FLASER 180 {beams} 0 0 0 0 0 0 {0.1 * k:.1f} robot {0.1 * k:.1f}" for k in range(1, SCANS + 1)]
    (tmp_path / "drive.log").write_text("\n".join(lines) + "\n")
    sequence = {"path": str(tmp_path / "drive.log"), "odometry": "scan-poses", "every": every}
    wanted = Request("wheel-odometry", {}, "carmen", sequence)
    run = execute_run(tmp_path / "run", wanted)
    assert (run.status, run.reason, run.every, len(run.steps)) == ("complete", "", every, SCANS // every)
    assert runtime.period_ns(run) == pytest.approx(1e8, rel=1e-6)


@pytest.mark.parametrize(("fault", "status", "reason"), EXPECTED)
def test_every_fault_has_its_status_and_a_reason_that_describes_it(runs, fault, status, reason):
    assert runs[fault].status == status, runs[fault].reason
    assert reason in runs[fault].reason
    assert runs[fault].reason.isprintable()
    assert bool(runs[fault].reason) == (status != "complete")


@pytest.mark.parametrize("fault", sorted(set(FAULTS) - {"none", "chdir", "linger", "remove-folder", "hidden"}))
def test_answers_before_the_fault_are_kept(runs, fault):
    run = runs[fault]
    assert run.steps["x"].tolist() == pytest.approx([0.1 * k for k in range(AT)])
    assert run.expected == SCANS
    assert run.warm_up_scans == 5


def test_answers_survive_a_removed_folder(runs):
    assert runs["remove-folder"].steps["x"].tolist() == pytest.approx([0.1 * k for k in range(AT + 1)])


def test_a_run_that_completes_has_every_scan_once_and_in_order(runs):
    run = runs["none"]
    assert run.steps["stamp_ns"].tolist() == [k * 100_000_000 for k in range(SCANS)]
    assert (run.steps["wall_ns"] > 0).all()
    assert (run.steps["harness_ns"][1:] > 0).all()


def test_no_fault_leaves_a_process_behind(runs, root, earlier, wait_for, has_ended):
    assert (root / "daemon" / "request.json").exists()
    assert wait_for(lambda: find_processes(root) == [])
    for fault in ("hidden", "hidden-exit"):
        assert has_ended(int((root / fault / "hidden.pid").read_text()))
    assert wait_for(lambda: set(psutil.Process().children(recursive=True)) <= earlier)  # whatever their names


def find_processes(folder):
    """Return the processes with a folder, or a path inside it, on their command line."""
    return [process.pid for process in psutil.process_iter(["cmdline"]) if str(folder) in str(process.info["cmdline"])]


def test_numbers_that_a_back_end_writes_as_its_outcome_do_not_replace_those_of_the_run(strangers, tmp_path):
    run = execute_run(tmp_path / "run", request("claim-numbers"))
    assert (run.expected, run.every, dict(run.notes), run.remarks) == (SCANS, 1, {}, ())
    assert run.peak_memory_bytes > 0
    assert len(run.steps) == AT


def test_links_that_a_back_end_plants_are_not_followed(strangers, tmp_path):
    victim = tmp_path / "victim.txt"
    victim.write_text("mine")
    run = execute_run(tmp_path / "run", request("links"))
    assert run.status == "failed"
    assert len(run.steps) == AT
    assert victim.read_text() == "mine"


def test_endless_output_does_not_fill_the_disk(runs, root):
    assert (root / "flood" / run_process.OUTPUT).stat().st_size < 2 * subprocesses.MAX_OUTPUT_BYTES


def test_the_memory_of_a_run_excludes_its_parent_process(strangers, tmp_path):
    ballast = bytearray(400 * 2**20)  # Linux passes the peak of the parent on to its children in ru_maxrss
    ballast[::4096] = b"x" * len(ballast[::4096])
    run = execute_run(tmp_path / "run", request())
    assert len(ballast) > run.peak_memory_bytes > 10 * 2**20


@pytest.mark.parametrize(
    ("fault", "place"),
    [
        ("segfault", f"; after {AT} answers, the last to the scan with stamp 700000000 ns"),
        ("raise", f"; at scan {AT + 1} ("),
        ("spin", f"; after {AT} answers, "),
        ("hang", f" after scan {AT}"),
    ],
)
def test_a_failed_run_names_where_it_ended(runs, fault, place):
    assert place in runs[fault].reason


def test_a_crash_in_the_warm_up_reports_the_number_of_scans(strangers, tmp_path):
    run = execute_run(tmp_path / "run", request("exit", at=2))
    assert run.reason.endswith("; in the warm-up with the first 5 scans")
    assert (run.status, len(run.steps), run.expected, run.warm_up_scans) == ("failed", 0, SCANS, 0)


def test_a_run_without_an_answer_ended_while_its_data_were_read_in_the_warm_up_or_at_the_first_scan():
    started = {"expected": 3}
    assert run_process._describe_place({"expected": 0}, NO_STEPS) == ""
    assert run_process._describe_place(started, NO_STEPS) == "in the warm-up with the first 3 scans"
    assert run_process._describe_place(started | {"warm_up_scans": 3}, NO_STEPS) == "at the first scan"


def test_decreasing_stamps_are_a_failure_that_names_the_scan(strangers, tmp_path):
    run = execute_run(tmp_path / "run", request(backwards=6))
    assert run.status == "failed"
    assert run.reason.startswith("straight: scan 7: stamp 0 ns is not later than the one before, 500000000 ns; ")
    assert len(run.estimate) == 6


def test_a_deleted_file_is_missing_data(strangers, tmp_path):
    run = execute_run(tmp_path / "run", request(file=str(tmp_path / "gone")))
    assert (run.status, run.reason) == ("data-missing", f"straight: {tmp_path / 'gone'} is gone; bring it back")


def test_an_interrupted_run_keeps_its_answers(strangers, tmp_path):
    stop = threading.Event()
    run = execute_run(
        tmp_path / "run", request("hang"), heard=lambda scans: stop.set() if scans == AT else None, stop=stop
    )
    assert (run.status, run.reason, len(run.steps)) == ("interrupted", "interrupted", AT)


def test_modules_in_the_working_directory_do_not_shadow_others(strangers, tmp_path, monkeypatch):
    (tmp_path / "numpy.py").write_text("raise SystemExit('wrong numpy')")
    monkeypatch.chdir(tmp_path)
    assert execute_run(tmp_path / "run", request()).status == "complete"


def test_the_request_is_stored_with_the_answers(strangers, tmp_path):
    execute_run(tmp_path / "run", request("raise", at=0))
    assert json.loads((tmp_path / "run" / "request.json").read_text())["backend_parameters"]["fault"] == "raise"
    assert "lost the plot" in (tmp_path / "run" / "output.txt").read_text()


def test_a_folder_that_cannot_be_written_is_a_store_error(tmp_path):
    with pytest.raises(StoreError, match=r"absent: cannot be written \(No such file or directory\); name another"):
        run_process.run(request(), tmp_path / "absent", HASTE, lambda _: None, threading.Event())


def test_indexing_a_long_recording_does_not_count_as_a_missing_answer(strangers, tmp_path, monkeypatch):
    """It ends once the time without an answer, which a limit is compared with, has been seen to begin again."""
    begun_again = tmp_path / "begun again"

    def watch(_limits, used, last_answer, _peak_bytes, answered):
        if answered == 0 and last_answer.wall_s == used.wall_s > 0.0:
            begun_again.touch()

    monkeypatch.setattr(run_process, "_broken_limit", watch)
    run = execute_run(tmp_path / "run", request(reads_until=str(begun_again)))
    assert (run.status, run.reason) == ("complete", "")
    assert begun_again.exists()
