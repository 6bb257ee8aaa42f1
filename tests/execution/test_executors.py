"""Runs executed by the workers of a cluster: results equal to local ones, also if workers are killed."""

import json
import os
import signal
import subprocess
import sys
import threading

import numpy as np
import psutil
import pytest

from evalkit.config.experiment_file import experiment_from_tables
from evalkit.core.errors import NotInstalled, StoreError
from evalkit.core.run_result import STEP, RunResult
from evalkit.execution import dask_cluster, environment, executors, run_task
from evalkit.execution.dask_cluster import Cluster, NoCluster
from evalkit.execution.executors import DaskExecutor, LocalExecutor
from evalkit.execution.scheduler import Scheduler
from evalkit.results.store import Store

pytestmark = pytest.mark.slow

COSTS = ("wall_ns", "cpu_ns", "conversion_ns", "harness_ns", "device_ns", "preparation_ns")


class RecordedProgress:
    """Progress that records how many runs were active at the same time."""

    def __init__(self, on_start=lambda spec: None):
        self._on_start, self.open, self.most = on_start, 0, 0

    def started(self, spec):
        self.open += 1
        self.most = max(self.most, self.open)
        self._on_start(spec)

    def answered(self, spec, scans): ...

    def finished(self, spec, result):
        self.open -= 1


def plan(*faults, timed=True, **sequence):
    """Return an experiment with a method for every fault."""
    content = {
        "timed": timed,
        "method": [{"use": "faulty", "label": f"{k} {fault}", "fault": fault} for k, fault in enumerate(faults)],
        "sequence": [{"use": "straight", **sequence}],
        "mapper": {"resolution_m": 0.25},
        "limits": {"run_s": 600.0, "scan_s": 300.0},
    }
    return experiment_from_tables(content, "t.toml", "t", "compare t.toml")


@pytest.fixture(scope="module")
def workers(strangers):
    """Start a cluster of two processes that offer to measure times."""
    distributed = pytest.importorskip("distributed")
    pytest.importorskip("cryptography")
    with dask_cluster._local(2) as local:
        yield local
    assert distributed


def run_on_cluster(workers):
    return DaskExecutor(Cluster(workers.scheduler_address, timed=True, security=workers.security))


def rows(plan, folder, executor=None, resume=False, progress=None, rerun=frozenset()):
    scheduler = Scheduler(Store(folder), progress or RecordedProgress(), resume=resume, rerun=rerun)
    made = scheduler.run_and_load(plan, executor or LocalExecutor(2))
    return {record.method: record for record in made}


def reasons(made):
    """Return the reasons of the runs."""
    return [record.result.reason for record in made.values()]


def pids(workers):
    """Return the process ids of the living workers."""
    return {nanny.pid for nanny in workers.workers.values() if nanny.pid}


HELLO = """import json, sys
hello = {"protocol": 1, "kind": "odometry", "parameters": [], "device": sys.argv[1]}
for line in sys.stdin:
    print(json.dumps(hello), flush=True)
"""


@pytest.mark.parametrize(("devices", "wait_s", "together"), [(["one"] * 4, 0.5, False), (["one", "other"], 60.0, True)])
def test_runs_are_executed_at_a_time_only_on_different_devices(tmp_path, monkeypatch, devices, wait_s, together):
    """A device has one session. Each run waits inside for another one."""
    meeting, met = threading.Barrier(2), []

    def execute(*_arguments):
        try:
            meeting.wait(wait_s)
        except threading.BrokenBarrierError:
            met.append(False)
        else:
            met.append(True)
        return RunResult(np.zeros(0, dtype=STEP), 0)

    monkeypatch.setattr(run_task, "execute_run", execute)
    (tmp_path / "board.py").write_text(HELLO)
    uses = [f"exec:{sys.executable} -I -S {tmp_path / 'board.py'} {name}" for name in devices]
    methods = [{"use": use, "label": str(number)} for number, use in enumerate(uses)]
    boards = experiment_from_tables({"method": methods, "sequence": [{"use": "room"}]}, "t.toml", "t", "compare t.toml")
    scheduler = Scheduler(Store(tmp_path / "out"), RecordedProgress())
    assert len(list(scheduler.run(boards, LocalExecutor(len(devices))))) == len(devices)
    assert met == [together] * len(devices)


def test_a_cluster_gives_the_same_records_as_this_machine_to_the_bit(workers, tmp_path):
    faults = ("none", "raise", "segfault", "far", "nan")
    here = rows(plan(*faults), tmp_path / "here")
    away = rows(plan(*faults), tmp_path / "away", run_on_cluster(workers))
    assert list(here) == list(away)
    timeless = [name for name in STEP.names if name not in COSTS]
    for one, other in zip(here.values(), away.values(), strict=True):
        assert one.key == other.key
        assert (one.result.status, one.result.reason, one.result.expected) == (
            other.result.status, other.result.reason, other.result.expected,
        )  # fmt: skip
        for name in timeless:
            assert one.result.steps[name].tobytes() == other.result.steps[name].tobytes(), name
        assert (other.result.steps["cpu_ns"] > 0).all()
        ours, theirs = one.scores, other.scores
        assert ours.alignment == theirs.alignment
        assert ours.by_metric.keys() == theirs.by_metric.keys()
        timed = {name for name in ours.by_metric if name.startswith(("cpu_", "wall_", "harness_", "device_"))}
        for name in (
            ours.by_metric.keys()
            - timed
            - {"conversion_percent", "preparation_percent", "real_time_factor", "peak_memory_mib"}
        ):
            assert ours.by_metric[name] == theirs.by_metric[name], name
        assert (ours.grid is None) == (theirs.grid is None)
        if ours.grid is not None:
            assert ours.grid.log_odds.tobytes() == theirs.grid.log_odds.tobytes()
        assert (
            np.array_equal(ours.errors_m, theirs.errors_m, equal_nan=True) or ours.errors_m is theirs.errors_m is None
        )
    files = {path.relative_to(tmp_path / "here") for path in (tmp_path / "here").rglob("*.*") if path.is_file()}
    assert files == {path.relative_to(tmp_path / "away") for path in (tmp_path / "away").rglob("*.*") if path.is_file()}
    provenance = away["0 none"].result.provenance
    assert provenance["runs at a time"] == "2"
    assert provenance["processor"] == environment.machine()["processor"]
    assert Store(tmp_path / "away").load_result(away["0 none"].key).provenance == provenance
    assert provenance["core"] in (*environment.cores(), None)


@pytest.mark.thorough
def test_a_killed_worker_loses_no_run_and_at_most_two_runs_are_active(workers, tmp_path):
    before = pids(workers)
    waits = plan("wait", "none", "none", "none", "none", "raise")
    killed = []

    def kill(spec):
        if not killed:
            killed.append(min(before))
            threading.Timer(1.5, os.kill, (killed[0], signal.SIGKILL)).start()

    progress = RecordedProgress(kill)
    made = rows(waits, tmp_path, run_on_cluster(workers), progress=progress)
    assert [record.result.status for record in made.values()] == [*["complete"] * 5, "failed"], reasons(made)
    assert killed[0] not in pids(workers)
    assert progress.most <= 3  # two threads, and one run that was lost


@pytest.mark.thorough
def test_a_run_that_kills_two_workers_is_quarantined_and_others_complete(workers, tmp_path):
    deadly = plan("none", "kill-parent", "none", "none")
    made = rows(deadly, tmp_path, run_on_cluster(workers))
    assert [record.result.status for record in made.values()] == ["complete", "crashed", "complete", "complete"], (
        reasons(made)
    )
    reason = made["1 kill-parent"].result.reason
    assert reason.startswith("quarantined: killed its worker twice (tls://127.0.0.1:")
    assert reason.endswith("); --rerun crashed runs it again")
    assert reason.count("tls://") == 2
    alive = pids(workers)
    again = rows(deadly, tmp_path, run_on_cluster(workers), resume=True)
    assert again["1 kill-parent"].result.reason == reason
    assert pids(workers) == alive
    only = deadly.select([], ["1 kill-parent"], [])
    last = rows(only, tmp_path, run_on_cluster(workers), resume=True, rerun=frozenset({"crashed"}))
    assert last["1 kill-parent"].result.reason != reason  # other workers, the same result


def test_local_attempts_are_cleared_once_a_worker_has_executed_the_run(workers, tmp_path):
    store, asked = Store(tmp_path), plan("none", timed=False)
    key = next(iter(asked.runs())).key
    store.write(tmp_path / "attempts" / f"{key}.json", json.dumps(["process 1 on a", "process 2 on a"]))
    assert store.attempts(key) == ("process 1 on a", "process 2 on a")
    assert rows(asked, tmp_path, run_on_cluster(workers), resume=True)["0 none"].result.status == "complete"
    assert store.attempts(key) == ()


def test_an_untimed_experiment_stores_no_times(workers, tmp_path):
    untimed = rows(plan("none", timed=False), tmp_path, run_on_cluster(workers))["0 none"]
    assert untimed.scores.by_metric["cpu_median_ms"].reason == "not timed: executed where times do not count"
    assert untimed.scores.by_metric["peak_memory_mib"].value > 0
    assert not untimed.result.steps["wall_ns"].any()
    timed = rows(plan("none"), tmp_path, run_on_cluster(workers), resume=True)["0 none"]
    assert timed.scores.by_metric["cpu_median_ms"].value > 0


def test_times_are_measured_only_on_workers_with_the_timed_resource(strangers, tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=2,
        processes=False,
        dashboard_address=None,
        memory_limit=0,
        silence_logs=50,
        worker_dashboard_address=None,
    ) as local:
        executor = DaskExecutor(Cluster(local.scheduler_address, timed=True))
        with pytest.raises(NoCluster, match="is not offered for measuring times: start workers with --nthreads 1"):
            rows(plan("none"), tmp_path, executor)


def test_without_dask_the_extra_is_named(monkeypatch, tmp_path):
    def absent(name):
        raise ImportError(f"No module named '{name}'")

    monkeypatch.setattr(dask_cluster, "import_module", absent)
    with pytest.raises(NotInstalled, match=r"pip install 'evalkit\[dask\]'"):
        list(Cluster().answers([]))


def test_an_unreachable_scheduler_is_named(monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(dask_cluster, "CONNECT_S", 0.5)
    with pytest.raises(NoCluster, match=r"tcp://127\.0\.0\.1:9: no scheduler answers"):
        list(Cluster("tcp://127.0.0.1:9", insecure=True).answers([]))


def test_a_scheduler_without_encryption_is_refused_unless_asked_for():
    pytest.importorskip("distributed")
    with pytest.raises(NoCluster, match=r"tcp://10\.0\.0\.1:8786: it has no TLS: .* or add --insecure"):
        list(Cluster("tcp://10.0.0.1:8786").answers([]))


def test_nobody_without_the_keys_reaches_the_cluster_that_evalkit_starts(workers):
    distributed = pytest.importorskip("distributed")
    assert workers.scheduler_address.startswith("tls://127.0.0.1:")
    plain = workers.scheduler_address.replace("tls://", "tcp://")
    with pytest.raises((OSError, TimeoutError)):
        distributed.Client(plain, timeout=1.0, set_as_default=False)
    other = distributed.Security.temporary()  # keys of somebody else
    with pytest.raises((OSError, TimeoutError)):
        distributed.Client(workers.scheduler_address, timeout=1.0, set_as_default=False, security=other)


@pytest.mark.thorough
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_worker_survives_the_end_of_evalkit(strangers, tmp_path, wait_for, number):
    pytest.importorskip("distributed")
    (tmp_path / "small.toml").write_text(
        '[[method]]\nuse = "faulty"\nfault = "hang"\n[mapper]\nresolution_m = 0.25\n[[sequence]]\nuse = "straight"\n'
    )
    words = [
        "compare",
        "--no-page",
        str(tmp_path / "small.toml"),
        "--out",
        str(tmp_path / "out"),
        "--engine",
        "dask",
        "-j",
        "1",
    ]
    mine = subprocess.Popen(
        [sys.executable, "-c", "from evalkit.cli import main; main()", *words],
        env={**os.environ, "EVALKIT_TEST": str(tmp_path)}, stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip
    assert wait_for(lambda: any("evalkit.execution.one_run" in line for line in lines(tmp_path)))
    if number == signal.SIGINT:
        os.killpg(mine.pid, number)  # like a terminal
    else:
        mine.send_signal(number)
    mine.communicate(timeout=600.0)
    assert wait_for(lambda: not lines(tmp_path)), lines(tmp_path)


def lines(folder):
    """Return the command lines of all processes started with a mark."""
    found = []
    for process in psutil.process_iter():
        try:
            if process.environ().get("EVALKIT_TEST") == str(folder) and process.status() != psutil.STATUS_ZOMBIE:
                found.append(" ".join(process.cmdline()))
        except psutil.Error:
            continue
    return found


@pytest.mark.parametrize("kind", ["link", "dangling", "writable"])
def test_no_core_is_locked_in_a_folder_that_others_can_fill_with_links(tmp_path, monkeypatch, kind):
    """They would lead to files of this user, which a lock opens for writing."""
    monkeypatch.setattr(executors.tempfile, "gettempdir", lambda: str(tmp_path))
    with executors._lock_core() as core:
        assert core is None or core in environment.cores()
    place = tmp_path / f"evalkit-cores-{os.getuid()}"
    assert place.stat().st_mode & 0o777 == 0o700
    place.rename(tmp_path / "theirs")
    if kind == "writable":
        place.mkdir()
        place.chmod(0o777)
    else:
        place.symlink_to(tmp_path / ("theirs" if kind == "link" else "nothing"))
    with pytest.raises(StoreError, match="set TMPDIR to a folder of your own"), executors._lock_core():
        pytest.fail("a core was locked")
