"""The task runner: stored results, time limits, and tasks that end their process."""

import ctypes
import importlib
import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest

from evalkit.core.errors import MachineFault
from evalkit.execution import environment, subprocesses, task_time_limit
from evalkit.execution.dask_cluster import Cluster, NoCluster, Slot
from evalkit.execution.sandbox import make_sandboxed_task
from evalkit.execution.task import make_task
from evalkit.execution.task_runner import TasksFailed, on_worker, run_tasks
from evalkit.execution.task_store import TaskStore


def square(number, log=""):
    if log:
        with Path(log).open("a") as file:
            file.write(f"{number}\n")
    return {"square": number * number, "row": np.arange(number)}


def refuse(why):
    raise ValueError(why)


def die():
    os.kill(os.getpid(), signal.SIGKILL)


def hang(how):
    {"sleeps": lambda: time.sleep(900), "spins": lambda: sum(itertools.repeat(0)),
     "holds": lambda: ctypes.PyDLL(None).sleep(900)}[how]()  # fmt: skip


def hang_after(started):
    part = Path(f"{started}.part")
    part.write_text(str(os.getpid()))
    part.rename(started)
    time.sleep(900)


def give_up():
    raise TimeoutError("no answer")


MEETING = threading.Barrier(2)


def place(meets=False):
    if meets:
        MEETING.wait(300.0)
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [0]
    return {"pid": os.getpid(), "cores": cores}


def wait_from_the_third_on(number, log):
    while number >= 3 and not Path(f"{log}.go").exists():
        time.sleep(0.01)
    return square(number, log)


@pytest.fixture
def squares(monkeypatch):
    """Make the functions of tasks importable in the worker processes."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    monkeypatch.syspath_prepend(str(Path(__file__).parent))

    module = importlib.import_module("test_task_runner")

    def make(name, function, **arguments):
        return make_task(name, getattr(module, function), **arguments)

    return make


def test_results_are_by_name_in_the_order_of_the_tasks(squares, tmp_path):
    found = run_tasks(TaskStore(tmp_path), [squares("three", "square", number=3), squares("two", "square", number=2)])
    assert list(found) == ["three", "two"]
    assert found["three"]["square"] == 9
    assert found["three"]["row"].tolist() == [0, 1, 2]


def test_tasks_that_start_their_own_process_need_no_other_and_each_has_a_core(squares, tmp_path):
    usable = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else {0}
    two = [squares(f"n{n}", "place", meets=True) for n in range(2)]  # at the same time
    tasks = [replace(one, own_process=True) for one in (squares("one", "place"), *two)]
    found = run_tasks(TaskStore(tmp_path), tasks, workers=2)
    assert {one["pid"] for one in found.values()} == {os.getpid()}
    assert all(len(one["cores"]) == 1 for one in found.values())
    assert len({one["cores"][0] for one in found.values()}) == min(2, len(usable))
    assert not hasattr(os, "sched_getaffinity") or os.sched_getaffinity(0) == usable  # of this thread
    mixed = run_tasks(TaskStore(tmp_path / "mixed"), [tasks[0], squares("other", "place")])
    assert os.getpid() not in {one["pid"] for one in mixed.values()}


def test_stored_results_are_not_computed_again(squares, tmp_path):
    log = tmp_path / "log"
    tasks = [squares(f"n{n}", "square", number=n, log=str(log)) for n in range(4)]
    run_tasks(TaskStore(tmp_path / "kept"), tasks[:2])
    again = run_tasks(TaskStore(tmp_path / "kept"), tasks)
    assert sorted(log.read_text().split()) == ["0", "1", "2", "3"]
    assert [result["square"] for result in again.values()] == [0, 1, 4, 9]


def test_more_workers_than_tasks_start_no_more_processes(squares, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(environment, "core_of_each", lambda processes: asked.append(processes) or [None] * processes)
    run_tasks(TaskStore(tmp_path), [squares(f"n{n}", "square", number=n) for n in range(2)], workers=500)
    assert asked == [2]


def test_the_key_changes_with_the_arguments(squares):
    assert squares("n", "square", number=1).key != squares("n", "square", number=2).key


def test_a_damaged_result_is_computed_again(squares, tmp_path):
    store, task = TaskStore(tmp_path), squares("n", "square", number=5)
    run_tasks(store, [task])
    store.path(task).write_bytes(store.path(task).read_bytes()[:40])
    assert run_tasks(store, [task])["n"]["square"] == 25


def test_a_pipe_or_a_link_in_place_of_a_result_is_none(squares, tmp_path):
    """A pipe would block, and a link lead out of a folder from somebody else."""
    store, task = TaskStore(tmp_path), squares("n", "square", number=5)
    run_tasks(store, [task])
    store.path(task).rename(tmp_path / "elsewhere")
    store.path(task).symlink_to(tmp_path / "elsewhere")
    assert store.load(task) is None
    store.path(task).unlink()
    os.mkfifo(store.path(task))
    assert store.load(task) is None


def test_a_task_that_raises_is_reported_and_does_not_stop_others(squares, tmp_path):
    tasks = [squares("bad", "refuse", why="no such wall"), squares("good", "square", number=2)]
    with pytest.raises(TasksFailed, match="bad failed: ValueError: no such wall"):
        run_tasks(TaskStore(tmp_path), tasks)
    assert TaskStore(tmp_path).load(tasks[1])["square"] == 4
    assert not list(tmp_path.glob("*.running"))


def test_a_task_that_ends_its_process_is_reported_and_does_not_stop_others(squares, tmp_path):
    tasks = [squares("deadly", "die"), *(squares(f"n{n}", "square", number=n) for n in range(3))]
    with pytest.raises(TasksFailed, match="deadly failed: it ended its process"):
        run_tasks(TaskStore(tmp_path), tasks)
    assert all(TaskStore(tmp_path).load(task) for task in tasks[1:])


def test_a_system_that_starts_no_process_is_no_failure_of_a_task_and_what_was_computed_is_kept(
    squares, tmp_path, monkeypatch
):
    class Broken(ThreadPoolExecutor):
        def submit(self, *_arguments):
            raise BrokenProcessPool("no process")

    started = []

    def start_one(core):
        started.append(core)
        return subprocesses.ProcessPoolExecutor(1) if len(started) == 1 else Broken(1)

    store = TaskStore(tmp_path)
    numbers = [squares(f"n{n}", "square", number=n) for n in range(9)]
    with monkeypatch.context() as limited:
        limited.setattr(subprocesses, "start_process", start_one)
        with pytest.raises(MachineFault, match=r"no process can be started here; free .* repeat the command: finished"):
            run_tasks(store, [numbers[0], squares("deadly", "die"), *numbers[1:]])
    assert len(started) == 3  # the tasks behind it were not tried
    assert [store.load(task) is not None for task in numbers] == [True] + 8 * [False]
    assert len(run_tasks(store, numbers)) == 9


@pytest.mark.parametrize("how", ["sleeps", "spins", "holds"])
def test_a_task_that_hangs_is_ended_once_and_does_not_stop_others(squares, tmp_path, how):
    hanging = squares("hanging", "hang", how=how).with_limit(1.0)
    tasks = [hanging, *(squares(f"n{n}", "square", number=n) for n in range(3))]
    begun = time.monotonic()
    with pytest.raises(TasksFailed, match="hanging failed: not finished after 1 s; it was in "):
        run_tasks(TaskStore(tmp_path), tasks)
    assert time.monotonic() - begun < 600  # not 900
    assert all(TaskStore(tmp_path).load(task) for task in tasks[1:])
    assert not list(tmp_path.glob("*.running"))


@pytest.mark.parametrize("own_process", [False, True])
def test_an_interrupt_ends_the_tasks_that_run(squares, tmp_path, wait_for, own_process):
    """A task that never returns, in a process of the pool or in a sandbox; a task that waits does not start."""
    started, log = tmp_path / "started", tmp_path / "log"
    waiting = squares("waiting", "square", number=2, log=str(log))
    tasks = [squares("endless", "hang_after", started=str(started)), waiting]
    if own_process:
        tasks = [make_sandboxed_task(task, 900.0, 4096) for task in tasks]

    def interrupt():
        wait_for(started.exists)
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        run_tasks(TaskStore(tmp_path / "kept"), tasks)
    thread.join()
    assert wait_for(lambda: not psutil.pid_exists(int(started.read_text())))
    assert not log.exists()


def test_a_second_time_limit_in_a_process_waits_for_the_first(tmp_path):
    inside, order = threading.Event(), []

    def second():
        inside.wait()
        with task_time_limit.time_limit(tmp_path / "second", 60.0):
            order.append("second")

    thread = threading.Thread(target=second)
    thread.start()
    with task_time_limit.time_limit(tmp_path / "first", 60.0):
        inside.set()
        thread.join(0.2)
        order.append("first")
    thread.join()
    assert order == ["first", "second"]
    assert list(tmp_path.iterdir()) == []


def test_the_key_does_not_change_with_the_time_limit(squares):
    task = squares("n", "square", number=1)
    assert task.with_limit(5.0).key == task.key


def test_two_tasks_with_one_name_are_an_error(squares, tmp_path):
    with pytest.raises(ValueError, match="two are named 'n'"):
        run_tasks(TaskStore(tmp_path), [squares("n", "square", number=1), squares("n", "square", number=2)])


def test_a_killed_study_resumes_without_repeating(squares, tmp_path, wait_for):
    script = tmp_path / "study.py"
    script.write_text(
        "from pathlib import Path\nfrom test_task_runner import wait_from_the_third_on\n"
        "from evalkit.execution.task import make_task\nfrom evalkit.execution.task_runner import run_tasks\n"
        "from evalkit.execution.task_store import TaskStore\n"
        f"log, folder = {str(tmp_path / 'log')!r}, Path({str(tmp_path / 'kept')!r})\n"
        "tasks = [make_task(f'n{n}', wait_from_the_third_on, number=n, log=log) for n in range(6)]\n"
        "if __name__ == '__main__':\n    run_tasks(TaskStore(folder), tasks)\n"
    )
    study = subprocess.Popen([sys.executable, script], start_new_session=True)
    assert wait_for(lambda: len(list((tmp_path / "kept").glob("*.npz"))) == 3)
    os.killpg(study.pid, signal.SIGKILL)
    study.wait()
    kept = len(list((tmp_path / "kept").glob("*.npz")))
    computed = len((tmp_path / "log").read_text().split())
    assert kept == computed == 3
    (tmp_path / "log.go").touch()
    subprocess.run([sys.executable, script], check=True)
    assert len((tmp_path / "log").read_text().split()) - computed == 6 - kept


def test_a_worker_with_other_code_stops_the_run_instead_of_failing_tasks(squares, tmp_path, monkeypatch):
    monkeypatch.setenv("EVALKIT_HOST", "rack-3")
    task = squares("three", "square", number=3)

    class Stale(Cluster):
        def answers(self, calls):
            for call in calls:
                outcome = Future()
                try:
                    on_worker(task, "three-of-other-code", Slot("", "", 1))
                except NoCluster as error:
                    outcome.set_exception(error)
                yield call, outcome

    with pytest.raises(NoCluster, match="rack-3: the code on this worker is different; install the same versions"):
        run_tasks(TaskStore(tmp_path), [task], cluster=Stale())


@pytest.mark.thorough
def test_a_cluster_computes_the_same_and_a_task_that_ends_two_workers_is_reported(squares, tmp_path):
    pytest.importorskip("distributed")
    pytest.importorskip("cryptography")
    tasks = [squares("three", "square", number=3), squares("deadly", "die"), squares("bad", "refuse", why="no")]
    tasks.append(squares("slow", "give_up"))
    with pytest.raises(TasksFailed) as failed:
        run_tasks(TaskStore(tmp_path), tasks, cluster=Cluster(workers=1))
    assert failed.value.failures["deadly"].reason.startswith("WorkerLost: killed its worker twice (tls://")
    assert failed.value.failures["bad"].reason == "ValueError: no"
    assert failed.value.failures["slow"].reason == "TimeoutError: no answer"  # its own limit, not that of the cluster
    kept = TaskStore(tmp_path).load(tasks[0])
    assert kept["square"] == 9
    assert kept["row"].tolist() == [0, 1, 2]


def test_a_function_inside_another_is_an_error():
    def inner():
        return {}

    with pytest.raises(ValueError, match="no function at the top level of a module"):
        make_task("inner", inner)


def test_arguments_that_do_not_fit_the_function_are_an_error(squares):
    with pytest.raises(TypeError, match="missing a required argument: 'number'"):
        squares("n", "square")
    with pytest.raises(TypeError, match="an argument of a task is a set"):
        _ = squares("n", "square", number={1}).key


def test_the_key_changes_with_the_modules_that_the_result_depends_on(squares):
    task = squares("n", "square", number=1)
    assert task.depending_on("evalkit.design.designs").key != task.key
