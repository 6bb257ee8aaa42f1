"""Foreign code starts only on systems that can terminate it, and every child terminates with its parent."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from concurrent import futures
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, queues

import psutil
import pytest

from evalkit.core.errors import NotInstalled
from evalkit.execution import subprocesses, usage


@pytest.mark.parametrize(
    ("wall_s", "waited_s", "exceeded"),
    [(9.0, 0.0, False), (11.0, 0.0, True), (28.0, 19.0, False), (28.0, 17.0, True), (31.0, 30.0, True)],
)
def test_time_that_a_run_waits_for_a_core_does_not_count_up_to_three_times_its_limit(wall_s, waited_s, exceeded):
    assert usage.Usage(wall_s, 1.0, 0, waited_s).exceeds_wall(10.0) is exceeded
    begin = usage.Usage(100.0, 50.0, 0, 40.0)
    assert usage.Usage(100.0 + wall_s, 51.0, 0, 40.0 + waited_s).exceeds_wall(10.0, begin) is exceeded


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux counts the time without a core")
def test_time_without_a_core_is_read_of_another_process(wait_for):
    """Two processes share one core: each waits while the other works; one that sleeps does not wait."""
    core = min(os.sched_getaffinity(0))
    spin = f"import os\nos.sched_setaffinity(0, {{{core}}})\nwhile True: pass"

    def waited_s(child):
        return (usage.read_waited_ns(child.pid) or 0) * 1e-9

    children = [subprocess.Popen([sys.executable, "-c", spin]) for _ in range(2)]
    sleeping = "import time; print(flush=True); time.sleep(600)"
    sleeper = subprocess.Popen([sys.executable, "-c", sleeping], stdout=subprocess.PIPE)
    try:
        assert wait_for(lambda: min(waited_s(one) for one in children) >= 0.1)
        sleeper.stdout.readline()  # it has started, which may have taken a while
        assert wait_for(lambda: psutil.Process(sleeper.pid).status() == psutil.STATUS_SLEEPING)
        before = waited_s(sleeper)
        time.sleep(0.1)
        assert waited_s(sleeper) - before < 0.05
    finally:
        for one in (*children, sleeper):
            one.kill()
            one.communicate()
    assert usage.read_waited_ns(sleeper.pid) is None


@pytest.mark.parametrize(
    ("wall_s", "cpu_s", "exceeded"),
    [
        (9.0, 9.0, False),
        (11.0, 10.0, True),  # had its time
        (11.0, 0.1, True),  # waits
        (11.0, 3.0, False),  # on a busy machine
        (31.0, 3.0, True),
    ],
)
def test_a_child_that_gets_too_little_cpu_time_has_three_times_its_limit(wall_s, cpu_s, exceeded):
    assert usage.Usage(wall_s, cpu_s, 0).exceeds(10.0) is exceeded
    begin = usage.Usage(100.0, 50.0, 0)
    assert usage.Usage(100.0 + wall_s, 50.0 + cpu_s, 0).exceeds(10.0, begin) is exceeded


def test_a_child_that_waits_for_a_core_without_any_cpu_time_has_three_times_its_limit():
    assert usage.Usage(11.0, 0.1, 0, 0.1).exceeds(10.0)  # it sleeps
    assert not usage.Usage(11.0, 0.1, 0, 5.0).exceeds(10.0)
    assert usage.Usage(31.0, 0.1, 0, 5.0).exceeds(10.0)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux counts the processes it has started")
def test_descendants_are_searched_only_after_the_system_has_started_a_process(tmp_path, monkeypatch, wait_for):
    """Each search lists all processes; one process more is found by the next."""
    (tmp_path / "sleeping.py").write_text(
        "import pathlib, subprocess, sys, time\n"
        "go = pathlib.Path(sys.argv[1], 'go')\n"
        "while not go.exists(): time.sleep(0.01)\n"
        "subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)']).wait()\n"
    )
    starts = usage.count_starts()
    subprocess.run([sys.executable, "-c", ""], check=True)
    assert usage.count_starts() > starts > 0
    planted = [100]
    monkeypatch.setattr(subprocesses, "count_starts", lambda: planted[0])
    monkeypatch.setattr(subprocesses, "COUNT_S", 0.0)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with subprocesses.ChildProcess("sleeping", tmp_path) as child:
        used = child.watch()
        assert wait_for(lambda: next(used) and len(child._members) >= 1)
        listed = []
        monkeypatch.setattr(psutil.Process, "children", _counting(psutil.Process.children, listed))
        next(used), next(used)
        assert (len(child._members), listed) == (1, [])
        (tmp_path / "go").touch()

        def finds_another():
            planted[0] += 1
            next(used)
            return len(child._members) == 2

        assert wait_for(finds_another)
        assert listed
        planted[0] = None  # a system that does not count
        searches = len(listed)
        next(used)
        assert len(listed) == searches + 1


def _counting(function, calls):
    def call(*arguments, **keywords):
        calls.append(arguments)
        return function(*arguments, **keywords)

    return call


def test_nothing_starts_on_a_system_without_process_groups(tmp_path, monkeypatch):
    subprocesses._require_process_groups()  # supported here
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("something was started"))
    with monkeypatch.context() as windows:
        windows.setattr(os, "name", "nt")
        with pytest.raises(NotInstalled, match=r"not supported .* use Linux, macOS, or Linux within Windows \(WSL\)"):
            subprocesses.ChildProcess("evalkit.execution.one_run", tmp_path)


ORPHAN = """
import multiprocessing, os, signal, time
from evalkit.execution import parent

def late():
    os.kill(multiprocessing.parent_process().pid, signal.SIGKILL)
    while os.getppid() == multiprocessing.parent_process().pid:
        time.sleep(0.01)
    parent.poll_parent()
    time.sleep(600)

if __name__ == "__main__":
    child = multiprocessing.get_context("spawn").Process(target=late)
    child.start()
    print(child.pid, flush=True)
    child.join()
"""


def test_a_process_that_polls_only_after_its_parent_was_killed_terminates_too(tmp_path, has_ended):
    (tmp_path / "orphan.py").write_text(ORPHAN)
    said = tmp_path / "said"
    with said.open("wb") as out:  # no pipe, which the orphan would keep open
        subprocess.run([sys.executable, tmp_path / "orphan.py"], stdout=out, check=False)
    orphan = int(said.read_text())
    try:
        assert has_ended(orphan)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(orphan, signal.SIGKILL)


ESCAPE = """
import os, signal, sys, time
from pathlib import Path
supervisor = os.getppid()
if os.fork() == 0:
    os.setsid()
    if os.fork() == 0:
        Path(sys.argv[1], "escaped").write_text(str(os.getpid()))
        os.execve("/bin/sleep", ["sleep", "600"], {})
    os._exit(0)
os.wait()
for _ in range(30_000):  # at most five minutes
    if Path(sys.argv[1], "found").exists():
        break
    time.sleep(0.01)
os.kill(supervisor, signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere orphans are found by their environment only")
def test_a_process_that_left_everything_terminates_although_its_supervisor_was_killed(tmp_path, monkeypatch, has_ended):
    """It has another session, another parent and no environment, and evalkit's own process above it is gone.

    Its supervisor is killed once a search for descendants has found it.
    """
    left = tmp_path / "escaped"
    (tmp_path / "escape.py").write_text(ESCAPE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with subprocesses.ChildProcess("escape", tmp_path) as child:
        for _ in child.watch():
            if left.exists() and left.read_text() in {str(one.pid) for one in child._members}:
                (tmp_path / "found").touch()
    assert child.returncode == -signal.SIGKILL
    escaped = int(left.read_text())
    try:
        assert has_ended(escaped)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(escaped, signal.SIGKILL)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_terminal_that_interrupts_a_command_ends_no_process_that_is_starting(monkeypatch, number):
    """Else its traceback is printed between the lines of the command."""
    start = subprocesses.SpawnProcess._Popen

    def start_and_interrupt(process):
        started = start(process)
        os.kill(started.pid, number)
        return started

    monkeypatch.setattr(subprocesses.SpawnProcess, "_Popen", start_and_interrupt)
    with subprocesses.start_process(None) as pool:
        assert pool.submit(signal.getsignal, number).result() == signal.SIG_IGN
    assert number not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def _start_no_thread(*_):
    raise RuntimeError("can't start new thread")


@pytest.mark.parametrize(
    ("place", "name"),
    [(queues.Queue, "_start_thread"), (futures.process._ExecutorManagerThread, "start")],
    ids=["second", "first"],
)
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_pool_that_cannot_start_a_thread_does_not_wait_for_ever_and_works_once_it_can(
    place, name, monkeypatch, wait_for
):
    """The executor of a process has two threads; it starts the second in the first, which ends where that fails.

    Python 3.12 and later notice it themselves.
    """
    monkeypatch.setattr(subprocesses, "_THREAD_POLL_S", 0.05)
    before = set(active_children())
    with subprocesses.WorkerPool([None]) as pool:
        with monkeypatch.context() as limited:
            limited.setattr(place, name, _start_no_thread)
            with pytest.raises(BrokenProcessPool):
                pool.run(os.getpid)
        assert wait_for(lambda: set(active_children()) <= before)
        assert pool.run(os.getpid) != os.getpid()
