"""Run tasks in worker processes or on a cluster and store each result at once, so that an interrupted run resumes."""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from queue import SimpleQueue
from types import MappingProxyType
from typing import Generic

from evalkit.core.errors import EvalkitError, MachineFault, StoreError, plain
from evalkit.execution import environment, task_time_limit
from evalkit.execution.dask_cluster import Call, Cluster, NoCluster, Slot
from evalkit.execution.subprocesses import STOP, WorkerPool
from evalkit.execution.task import R, Task
from evalkit.execution.task_store import TaskStore
from evalkit.io.output_files import REMEDY

OnDone = Callable[[str, float], None]
"""Called for each finished task with its name and the seconds it took, 0 if its result was stored already."""


@dataclass(frozen=True)
class TaskFailure:
    """Why a task has no result; ``timed_out``: its time limit ended it."""

    reason: str
    timed_out: bool = False


class TaskEnded(Exception):
    """The process of a task died: ``TaskEnded(reason, timed_out)``."""


class TasksFailed(EvalkitError):
    """Some tasks have no result; all others are stored: ``TasksFailed(folder, what)``; ``failures`` by task name."""

    failures: Mapping[str, TaskFailure] = MappingProxyType({})

    def __init__(self, folder: str, what: str) -> None:
        super().__init__(folder, what)

    @classmethod
    def from_failures(cls, folder: str, failures: Mapping[str, TaskFailure]) -> TasksFailed:
        """The error about these failures; its message names the first."""
        name, failure = next(iter(failures.items()))
        others = f" and {len(failures) - 1} more" if len(failures) > 1 else ""
        error = cls(folder, f"{name}{others} failed: {failure.reason}")
        error.failures = failures
        return error

    def __str__(self) -> str:
        folder, what = self.args
        return plain(f"{folder}: {what}; finished results are stored: repeat the command to continue")


def run_tasks(
    store: TaskStore,
    tasks: Iterable[Task[R]],
    workers: int = 1,
    on_done: OnDone = lambda _name, _seconds: None,
    cluster: Cluster | None = None,
) -> dict[str, R]:
    """The result of every task by name: loaded from the store, or computed by ``workers`` processes and stored.

    With a ``cluster``, its workers compute instead. A process that dies fails only the task that ended it,
    which runs once more unless a time limit ended it.

    Raises TasksFailed after all other tasks are stored, StoreError if the folder cannot be written, NoCluster if the
    code on a worker differs from the code here. Raises MachineFault where no process can be started here, after the
    tasks that run are stored.
    """
    every = list(tasks)
    _refuse_duplicates([task.name for task in every])
    collector = _Collector[R](store, on_done)
    collector.load(every)
    missing = [task for task in every if task.name not in collector.results]
    if cluster:
        _run_on_cluster(missing, cluster, collector)
    else:
        _run_locally(missing, workers, collector)
    if collector.faults:
        raise collector.faults[0]
    if collector.failures:
        raise TasksFailed.from_failures(str(store.folder), collector.failures)
    return {task.name: collector.results[task.name] for task in every}


@dataclass(frozen=True)
class _Collector(Generic[R]):
    """The results and failures so far, by task name, and the faults of the machine, which are of no task."""

    store: TaskStore
    on_done: OnDone
    results: dict[str, R] = field(default_factory=dict)
    failures: dict[str, TaskFailure] = field(default_factory=dict)
    faults: list[MachineFault] = field(default_factory=list)

    def load(self, tasks: Sequence[Task[R]]) -> None:
        """Load the results that are stored already."""
        for task in tasks:
            if (stored := self.store.load(task)) is not None:
                self.results[task.name] = stored
                self.on_done(task.name, 0.0)

    def collect(self, computed: Iterator[tuple[Task[R], Future[tuple[R, float]]]]) -> None:
        """Store the results of computed tasks, and the seconds they took."""
        for task, future in computed:
            try:
                result, seconds = future.result()
            except TaskEnded as ended:
                self.failures[task.name] = TaskFailure(*ended.args)
            except NoCluster:  # the worker has other code; the task has not failed
                raise
            except MachineFault as fault:
                self.faults.append(fault)
            except Exception as error:  # noqa: BLE001 - an exception of one task must not stop the others
                self.failures[task.name] = TaskFailure(f"{type(error).__name__}: {error}")
            else:
                self._save(task, result, seconds)

    def _save(self, task: Task[R], result: R, seconds: float) -> None:
        self.store.save(task, result)
        stored = self.store.load(task)  # as a resumed run will see it
        if stored is None:
            raise StoreError(str(self.store.path(task)), "was written but cannot be read back", REMEDY)
        self.results[task.name] = stored
        self.on_done(task.name, seconds)


def _run_locally(tasks: list[Task[R]], workers: int, collector: _Collector[R]) -> None:
    """Run tasks in processes with one thread and one core each; where all start processes themselves, in theirs."""
    if not tasks:
        return
    collector.store.create()
    workers = min(workers, len(tasks))
    os.environ.update(environment.SINGLE_THREAD)  # inherited by the processes
    own_processes = all(task.own_process for task in tasks)
    stop = threading.Event()
    cores = () if own_processes else environment.core_of_each(workers)
    with WorkerPool(cores) as pool, ThreadPoolExecutor(workers) as threads:
        try:
            if own_processes:
                idle = environment.queue_cores(workers)
                futures = {threads.submit(_run_on_core, idle, task, stop): task for task in tasks}
            else:
                note = collector.store.note
                futures = {threads.submit(_run_in_pool, pool, task, note(task), stop): task for task in tasks}
            collector.collect((futures[future], future) for future in as_completed(futures))
        except BaseException:  # an interrupt or an unwritable folder
            stop.set()
            pool.kill()
            threads.shutdown(wait=True, cancel_futures=True)
            raise


def _run_on_core(idle: SimpleQueue[int | None], task: Task[R], stop: threading.Event) -> tuple[R, float]:
    """Run a task that starts its own process in this thread, on an idle core, until ``stop`` is set."""
    STOP.set(stop)
    core = idle.get()
    try:
        if core is not None:
            os.sched_setaffinity(0, {core})  # of this thread; the process inherits it
        return task.run()
    finally:
        idle.put(core)


def _run_in_pool(pool: WorkerPool, task: Task[R], note: Path, stop: threading.Event) -> tuple[R, float]:
    """Run a task in a process.

    Raises TaskEnded, or MachineFault where no process can be started. Then ``stop`` is set, and later tasks are not
    run: each raises CancelledError.
    """
    if stop.is_set():
        raise CancelledError
    try:
        return _run_twice(pool, task, note)
    except MachineFault:
        stop.set()
        raise


def _run_twice(pool: WorkerPool, task: Task[R], note: Path) -> tuple[R, float]:
    """Run a task in a process; once more if the process died, unless its time limit ended it."""
    for _ in range(2):
        try:
            return pool.run(_run_with_note, task, note)
        except BrokenProcessPool:
            if timeout := task_time_limit.take_note(note, task.limit_s):
                raise TaskEnded(timeout, True) from None
            pool.check("tasks", f"{MachineFault.FREE} the command: finished results are stored")
    raise TaskEnded("it ended its process", False)


def _run_on_cluster(tasks: list[Task[R]], cluster: Cluster, collector: _Collector[R]) -> None:
    """Run tasks on a cluster's workers; the cluster itself repeats a task that lost its worker."""
    by_key = {task.key: task for task in tasks}
    calls = (Call(key, on_worker, (task, key)) for key, task in by_key.items())
    with closing(cluster.answers(calls)) as answers:
        collector.collect((by_key[call.name], future) for call, future in answers)


def on_worker(task: Task[R], key: str, _slot: Slot) -> tuple[R, float]:
    """Run a task on a cluster's worker; its time limit ends the worker.

    Raises NoCluster if the code on the worker differs from the code that computed ``key``.
    """
    if task.key != key:
        what = "the code on this worker is different"
        raise NoCluster(environment.host_name(), what, "install the same versions on every worker, and restart them")
    with tempfile.TemporaryDirectory(prefix="evalkit-") as folder:
        return _run_with_note(task, Path(folder) / "note")


def _run_with_note(task: Task[R], note: Path) -> tuple[R, float]:
    with task_time_limit.time_limit(note, task.limit_s):
        return task.run()


def _refuse_duplicates(names: list[str]) -> None:
    duplicates = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
    if duplicates:
        raise ValueError(f"tasks: two are named {duplicates[0]!r}")
