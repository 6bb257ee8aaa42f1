"""Child processes: start foreign code, measure and watch it, terminate it with all its descendants; process pools.

Every child terminates when its parent dies. A child that runs foreign code is marked by an environment variable, so
that descendants that leave its session are found as well.
"""

from __future__ import annotations

import contextlib
import os
import platform
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextvars import ContextVar
from io import RawIOBase
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess
from pathlib import Path
from queue import Empty, SimpleQueue
from types import ModuleType
from typing import Any, ParamSpec, TypeVar

import psutil

from evalkit.core.errors import MachineFault, NotInstalled
from evalkit.execution import supervisor
from evalkit.execution.environment import SINGLE_THREAD
from evalkit.execution.parent import poll_parent
from evalkit.execution.supervisor import PARENT
from evalkit.execution.usage import Usage, count_starts, read_waited_ns
from evalkit.plugins.registry import MARK

Parameters = ParamSpec("Parameters")
R = TypeVar("R")

STOP: ContextVar[threading.Event | None] = ContextVar("STOP", default=None)
"""An event that ends the children of this thread when it is set."""

POLL_S = 0.05
"""Interval between two measurements of a child."""

COUNT_S = 0.5
"""Interval between two searches for the descendants of a child, which inspect every process of the system. None is made
where the system has started no process since the last one.
"""

_THREAD_POLL_S = 1.0
"""Interval between two looks at the thread of an executor that has not answered."""

TAIL_BYTES = 4096
"""Length of the end of the output that is searched for the last line."""

MAX_OUTPUT_BYTES = 16 * 2**20
"""Maximum size of the output of a child; the beginning of a longer output is deleted."""

OUTPUT = "output.txt"
"""File in the folder of a child with its standard output and standard error."""


class ChildProcess:
    """``python -m module folder`` in a session of its own; a context manager that terminates it with all descendants.

    A supervisor between this process and the child finds descendants that leave its session and its parents. The
    output goes to ``OUTPUT`` in the folder. ``threads``: number of threads that numeric libraries may start. Processes
    that an earlier, killed evalkit left behind in this folder are terminated first. Raises NotInstalled on a system
    without process groups: a run that hangs or leaves processes behind would disturb the next measurement.
    """

    def __init__(self, module: str, folder: Path, threads: int = 1) -> None:
        _require_process_groups()
        self._folder = folder
        _kill_marked(folder)
        environment = {**os.environ, **dict.fromkeys(SINGLE_THREAD, str(threads))}
        environment |= {MARK: _mark(folder), PARENT: str(os.getpid())}
        # kept open: a path may lead elsewhere once foreign code runs; for appending: see _truncate_output
        self._output = open(_open_output(folder / OUTPUT), "a+b", buffering=0)  # noqa: SIM115 - a descriptor
        self._process = subprocess.Popen(  # -P: modules in the working directory must not shadow others
            [sys.executable, "-P", "-m", supervisor.__name__, module, str(folder)], stdin=subprocess.DEVNULL,
            stdout=self._output, stderr=self._output, start_new_session=True, env=environment,
        )  # fmt: skip
        self._started_at = self._searched_at = time.monotonic()
        self._starts: int | None = None  # of processes, at the last search
        self._members: list[psutil.Process] = []
        self._seen: set[psutil.Process] = set()  # members that live, also where their supervisor does not
        self._cpu_s, self._waited_s, self._last_line = 0.0, 0.0, ""

    def __enter__(self) -> ChildProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self._terminate()
        self._truncate_output()  # it may have grown since the last measurement
        self._last_line = _read_last_line(self._output)
        self._output.close()

    @property
    def returncode(self) -> int:
        """The return code of the ended process, negative for a signal."""
        return self._process.returncode

    def watch(self) -> Iterator[Usage]:
        """Yield the resources used so far, every ``POLL_S``, until the process ends.

        Raises CancelledError when the event of ``STOP`` is set.
        """
        stop = STOP.get()
        while self._process.poll() is None:
            if stop is not None and stop.is_set():
                raise CancelledError
            time.sleep(POLL_S)
            self._truncate_output()
            yield self._measure()

    def describe_end(self) -> str:
        """How the process ended, by its return code, and the last line of its output."""
        code, last = self.returncode, f"; last output: {self._last_line}" if self._last_line else ""
        if code < 0:
            hint = " (by the system, where memory ran out)" if -code == signal.SIGKILL else ""
            return f"the process was terminated by {signal_name(-code)}{hint}{last}"
        return f"the process exited with code {code}{last}"

    def _measure(self) -> Usage:
        if not self._members or time.monotonic() - self._searched_at > COUNT_S:
            self._search()
        memory, cpu_s, waited_s = 0, 0.0, 0.0
        for member in self._members:
            with contextlib.suppress(psutil.Error):  # ended meanwhile
                memory += int(member.memory_info().rss)
                times = member.cpu_times()
                cpu_s += times.user + times.system + times.children_user + times.children_system
                waited_s = max(waited_s, (read_waited_ns(member.pid) or 0) * 1e-9)
        self._cpu_s = max(self._cpu_s, cpu_s)  # an ended child is not counted until its parent has waited for it
        self._waited_s = max(self._waited_s, waited_s)
        return Usage(time.monotonic() - self._started_at, self._cpu_s, memory, self._waited_s)

    def _search(self) -> None:
        """Find the descendants of the supervisor, unless all are known and the system has started no process since."""
        self._searched_at, starts = time.monotonic(), count_starts()
        known = starts is not None and starts == self._starts
        if known and self._members and all(member.is_running() for member in self._members):
            return
        with contextlib.suppress(psutil.Error):  # ended meanwhile
            self._members = psutil.Process(self._process.pid).children(recursive=True)
            self._seen = {member for member in self._seen if member.is_running()} | set(self._members)
            self._starts = starts

    def _terminate(self) -> None:
        """End the process and its descendants by the supervisor, then all processes of its session and its mark."""
        process = self._process
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(2.0 * supervisor.CLEANING_S)
        if process.poll() is None:  # its process id is not reused yet
            with contextlib.suppress(psutil.Error):  # ended meanwhile
                for child in psutil.Process(process.pid).children(recursive=True):
                    child.kill()
        with contextlib.suppress(ProcessLookupError, PermissionError):  # none left, which macOS calls not permitted
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        for member in self._seen:  # of a supervisor that foreign code has killed
            with contextlib.suppress(psutil.Error):
                for one in (*member.children(recursive=True), member):
                    one.kill()
        _kill_marked(self._folder)

    def _truncate_output(self) -> None:
        """Keep only the end of an output that has grown too long; the child continues to append."""
        with contextlib.suppress(OSError):  # a full disk
            if self._output.seek(0, os.SEEK_END) > MAX_OUTPUT_BYTES:
                self._output.seek(-TAIL_BYTES, os.SEEK_END)
                tail = self._output.read(TAIL_BYTES)
                self._output.truncate(0)
                self._output.write(tail or b"")


def _open_output(path: Path) -> int:
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0), 0o666)


def _mark(folder: Path) -> str:
    """The value of ``MARK`` for processes started in a folder; the same in every evalkit."""
    return str(uuid.uuid5(uuid.NAMESPACE_URL, folder.absolute().as_uri()))


def _kill_marked(folder: Path) -> None:
    """Kill all processes that carry the mark of a folder, also those whose parents have ended."""
    mark = _mark(folder)
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):  # of another user, or ended meanwhile
            if process.environ().get(MARK) == mark:
                process.kill()


def _read_last_line(output: RawIOBase) -> str:
    """The last readable line of an output, which may be a very long file; "" if there is none."""
    output.seek(max(output.seek(0, os.SEEK_END) - TAIL_BYTES, 0))
    text = (output.read(TAIL_BYTES) or b"").decode("utf-8", errors="replace")
    lines = ["".join(char for char in line if char.isprintable()).strip() for line in text.splitlines()]
    return next((line[:300] for line in reversed(lines) if line), "")


def signal_name(number: int) -> str:
    """The name of a signal, or "signal N" where the system has no name for it."""
    try:
        return signal.Signals(number).name
    except ValueError:  # most real-time signals have none
        return f"signal {number}"


def _require_process_groups() -> None:
    if os.name != "posix":
        what = f"runs are not supported on {platform.system()}: it has no process groups to end a back end with"
        raise NotInstalled("evalkit", what, "use Linux, macOS, or Linux within Windows (WSL)")


class WorkerPool:
    """Spawned processes that compute one call at a time and terminate with their parent; one that dies is replaced.

    ``cores``: one per process to pin it to; None: not pinned.
    """

    def __init__(self, cores: Sequence[int | None]) -> None:
        self._idle: SimpleQueue[tuple[Executor, int | None]] = SimpleQueue()
        self._count = len(cores)
        self._busy: set[Executor] = set()
        self._killed = False
        for core in cores:
            self._idle.put((start_process(core), core))

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Wait for the calls and terminate the processes."""
        for _ in range(self._count):
            self._idle.get()[0].shutdown(wait=True)

    def kill(self) -> None:
        """End the calls by killing their processes, and refuse all later ones."""
        self._killed = True
        idle: list[tuple[Executor, int | None]] = []
        try:
            while len(idle) < self._count:
                for executor in tuple(self._busy):
                    _kill_processes(executor)
                with contextlib.suppress(Empty):  # a process was being started
                    idle.append(self._idle.get(timeout=POLL_S))
        finally:
            for one in idle:
                self._idle.put(one)

    def run(self, function: Callable[Parameters, R], *arguments: Parameters.args, **keywords: Parameters.kwargs) -> R:
        """Call a function in an idle process. Raises BrokenProcessPool if the call ends its process.

        Raises CancelledError after ``kill``.
        """
        process, core = self._idle.get()
        self._busy.add(process)
        try:
            if self._killed:
                raise CancelledError
            return _wait(process, _submit(process, function, *arguments, **keywords))
        except BrokenProcessPool:
            if not self._killed:
                _kill_processes(process)
                process.shutdown(wait=False)
                self._busy.remove(process)
                process = start_process(core)
            raise
        finally:
            self._busy.discard(process)
            self._idle.put((process, core))

    def check(self, where: str, remedy: str) -> None:
        """Raise MachineFault if a process does not run even a trivial call: then it was no call that ended another."""
        try:
            self.run(os.getpid)
        except BrokenProcessPool:
            raise MachineFault(where, "no process can be started here", remedy) from None


def start_process(core: int | None) -> Executor:
    """A pool of one spawned process on a core; None: not pinned. Raises MachineFault where none can be started."""
    try:
        return ProcessPoolExecutor(1, mp_context=_Context(), initializer=_initialise_worker, initargs=(core,))
    except OSError as error:  # a full /dev/shm has no place for its semaphores
        raise MachineFault.of("a process of evalkit", error) or error from error


def _submit(
    executor: Executor, function: Callable[Parameters, R], *arguments: Parameters.args, **keywords: Parameters.kwargs
) -> Future[R]:
    try:
        return executor.submit(function, *arguments, **keywords)
    except RuntimeError as error:  # also of its thread, where no thread can be started
        raise BrokenProcessPool(str(error)) from error


def _wait(executor: Executor, future: Future[R]) -> R:
    """The result of a call. Raises BrokenProcessPool also if the executor's thread has ended, which would answer it.

    That thread starts another one at its first call, and ends without a word where none can be started.
    """
    thread: threading.Thread | None = getattr(executor, "_executor_manager_thread", None)
    while not wait([future], _THREAD_POLL_S).done:
        if thread is not None and not thread.is_alive() and not future.done():
            raise BrokenProcessPool("the thread that watches the process has ended")
    return future.result()


def _kill_processes(executor: Executor) -> None:
    for process in tuple((getattr(executor, "_processes", None) or {}).values()):
        process.kill()


class _Process(SpawnProcess):
    """A spawned process that does not import the caller's main module: a script needs no main guard."""

    @staticmethod
    def _Popen(process_obj: BaseProcess) -> Any:  # noqa: N802 - the hook of multiprocessing
        with _STARTING, _terminal_signals_blocked():
            main, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
            try:
                return SpawnProcess._Popen(process_obj)
            finally:
                sys.modules["__main__"] = main


class _Context(SpawnContext):
    Process = _Process


_STARTING = threading.Lock()

_OF_TERMINAL = [getattr(signal, name) for name in ("SIGINT", "SIGHUP") if hasattr(signal, name)]
"""Signals that a terminal sends to all processes of a command: by Ctrl-C, and where it is closed."""


@contextlib.contextmanager
def _terminal_signals_blocked() -> Iterator[None]:
    """Block them in this thread, and in the processes that it starts: until these ignore them, they would end there."""
    if os.name != "posix":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _OF_TERMINAL)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _initialise_worker(core: int | None) -> None:
    """Leave the signals of a terminal to the parent, terminate with it, and pin this process to a core."""
    for number in _OF_TERMINAL:
        signal.signal(number, signal.SIG_IGN)
    if os.name == "posix":
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _OF_TERMINAL)
    poll_parent()
    if core is not None:
        os.sched_setaffinity(0, {core})
