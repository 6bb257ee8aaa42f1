"""Executors of runs: the cores of this machine, or the workers of a Dask cluster."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
import threading
import uuid
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from multiprocessing import current_process, util
from pathlib import Path
from typing import Any, Protocol

from filelock import FileLock, Timeout

from evalkit.config.experiment import RunSpec
from evalkit.core.errors import StoreError
from evalkit.core.run_result import RunResult
from evalkit.core.run_status import Cause
from evalkit.execution import dask_cluster, environment, run_archive, run_task
from evalkit.execution.dask_cluster import Call, Cluster, Slot, WorkerLost
from evalkit.execution.run_task import PendingRun, RunSettings, WorkerSlot
from evalkit.execution.shared_frames import SharedFrames
from evalkit.execution.subprocesses import WorkerPool
from evalkit.plugins import registry
from evalkit.results.store import Store

FinishedRuns = Generator[tuple[RunSpec, RunResult]]


class Progress(Protocol):
    """Callbacks that report progress; ``started`` and ``answered`` are called from several threads."""

    def started(self, spec: RunSpec) -> None:
        """A run starts."""
        ...

    def answered(self, spec: RunSpec, scans: int) -> None:
        """A run has answered this many scans; not called for runs on a cluster."""
        ...

    def finished(self, spec: RunSpec, result: RunResult) -> None:
        """A run is executed, scored and stored, or needed nothing."""
        ...


class Executor(Protocol):
    """Decides where runs are executed, and nothing else about them."""

    def run(
        self, store: Store, settings: RunSettings, pending: Sequence[PendingRun], progress: Progress
    ) -> FinishedRuns:
        """Yield every pending run when it is executed and scored and its files are in the store.

        Raises errors that stop the whole experiment: a results folder that cannot be written, a cluster that is gone.
        """
        ...


@dataclass(frozen=True)
class LocalExecutor:
    """Executes up to ``jobs`` runs at a time on this machine, each pinned to a core of its own.

    Runs whose back ends compute on the same device follow each other: a board has one session, and one clock.
    """

    jobs: int = 1

    def run(
        self, store: Store, settings: RunSettings, pending: Sequence[PendingRun], progress: Progress
    ) -> FinishedRuns:
        """See Executor."""
        os.environ.update(environment.SINGLE_THREAD)  # inherited by the scoring processes, as by the runs
        jobs = max(min(self.jobs, len(pending)), 1)
        cores, stop, turns = environment.queue_cores(jobs), threading.Event(), _DeviceTurns(pending)

        def execute(run: PendingRun) -> tuple[RunSpec, RunResult]:
            """Execute one run; an exception stops all other runs at once."""
            with turns.of(run):
                if stop.is_set():
                    raise CancelledError
                core = cores.get()
                try:
                    progress.started(run.spec)
                    slot = WorkerSlot(core, scoring, lambda scans: progress.answered(run.spec, scans), stop, frames)
                    return run.spec, run_task.execute_run(store, settings, run, slot)
                except BaseException:
                    stop.set()
                    raise
                finally:
                    cores.put(core)  # after the scoring, which must not compete with a timed run

        specs = [run.spec for run in pending if not run.is_executed]
        with (
            WorkerPool([None] * jobs) as scoring,
            SharedFrames(store.folder, specs, scoring, settings.limits.run_s) as frames,
            ThreadPoolExecutor(jobs) as threads,
        ):
            try:
                for future in as_completed([threads.submit(execute, run) for run in pending]):
                    error = future.exception()
                    if error is None:
                        yield future.result()
                    elif not isinstance(error, CancelledError):
                        raise error
            except BaseException:  # an interrupt or an unwritable folder: end all runs and start no other
                stop.set()
                threads.shutdown(wait=True, cancel_futures=True)
                raise


class _DeviceTurns:
    """A lock for each device on which back ends of runs compute."""

    def __init__(self, runs: Sequence[PendingRun]) -> None:
        backends = {run.spec.method.backend for run in runs}
        self._devices = {name: device for name in backends if (device := registry.find_backend(name).device)}
        self._locks = {device: threading.Lock() for device in self._devices.values()}

    def of(self, run: PendingRun) -> AbstractContextManager[object]:
        """What a run waits for, and has in a block."""
        device = self._devices.get(run.spec.method.backend)
        return nullcontext() if device is None else self._locks[device]


@dataclass(frozen=True)
class DaskExecutor:
    """Executes runs on the workers of a cluster, each in a local folder that is sent back; no shared folder needed."""

    cluster: Cluster

    def run(
        self, store: Store, settings: RunSettings, pending: Sequence[PendingRun], progress: Progress
    ) -> FinishedRuns:
        """See Executor."""
        folder = uuid.uuid5(uuid.NAMESPACE_URL, store.folder.absolute().as_uri()).hex
        specs = {run.spec.key: run.spec for run in pending}
        run_code = cache(registry.hash_run_code)  # it reads files, and an experiment may have thousands of runs

        def calls() -> Iterator[Call]:
            for run in pending:
                progress.started(run.spec)
                archive = run_archive.pack_run(store, run.spec.key) if run.is_executed else b""
                code = run_code(run.spec.method.backend, run.spec.sequence.dataset)
                own = replace(run, attempts=())  # of processes here
                yield Call(run.spec.key, execute_on_worker, (own, settings, code, archive, folder))

        with closing(self.cluster.answers(calls())) as answers:
            for call, answer in answers:
                spec = specs[call.name]
                try:
                    result, archive = answer.result()
                except WorkerLost as error:
                    yield spec, run_task.quarantine(store, settings, spec, str(error))
                except Exception as error:  # noqa: BLE001 - an error of one worker must not stop the others
                    reason = f"the worker failed: {type(error).__name__}: {error}"
                    yield spec, run_task.empty_result(Cause.WORKER_FAILED, reason)
                else:
                    run_archive.unpack_run(store, spec.key, archive)
                    yield spec, result


def execute_on_worker(
    run: PendingRun, settings: RunSettings, code: str, archive: bytes, folder: str, slot: Slot
) -> tuple[RunResult, bytes]:
    """Execute a run on this worker of a cluster; returns its result and an archive of its files.

    ``archive``: the stored files of a run that is executed already. ``code``: hash of the code of the run.
    Raises StoreError if the code on this worker differs.
    """
    current_process().daemon = False  # the worker of a nanny may not start processes otherwise
    os.environ.update(environment.SINGLE_THREAD)
    spec = run.spec
    _require_same_code(spec, settings, code)
    worker = dask_cluster.dask().get_worker()
    place = Path(worker.local_directory).parent / f"evalkit-{folder}-{spec.key}"
    # Left by a worker that died; processes it left behind are terminated by the next start in this folder.
    shutil.rmtree(place, ignore_errors=True)
    store = Store(place)
    try:
        if archive:
            run_archive.unpack_run(store, spec.key, archive)
        with _lock_core() as core:
            here = {**settings.environment, **environment.machine(), "runs at a time": str(slot.beside)}
            own = replace(settings, environment=here)
            resources = WorkerSlot(core, _scoring_pool(settings.scoring_code), lambda _: None, _Cancelled(worker))
            result = run_task.execute_run(store, own, run, resources)
        return result, run_archive.pack_run(store, spec.key)
    finally:
        shutil.rmtree(store.folder, ignore_errors=True)


class _Cancelled(threading.Event):
    """An event that is set when the task of this worker is cancelled."""

    def __init__(self, worker: Any) -> None:
        super().__init__()
        self._worker, self._task = worker, worker.get_current_task()

    def is_set(self) -> bool:
        """Whether the task is cancelled."""
        task = self._worker.state.tasks.get(self._task)
        return task is None or task.state in ("cancelled", "resumed")


def _require_same_code(spec: RunSpec, settings: RunSettings, code: str) -> None:
    """Raise StoreError if the code of the run or of the scoring is not the same on this worker."""
    own = registry.hash_run_code(spec.method.backend, spec.sequence.dataset)
    if own != code or not settings.scoring_code.startswith(registry.hash_scoring_code(settings.mapper.name)):
        what = f"the code of '{spec.method.backend}', '{spec.sequence.dataset}' or evalkit differs here"
        host = environment.machine()["host"]
        raise StoreError(host, what, "install the same versions on every worker, and restart them")


@lru_cache(maxsize=1)
def _scoring_pool(_scoring_code: str) -> WorkerPool:
    """The scoring process of a worker, kept for its next run; a new one if the scoring code has changed."""
    pool = WorkerPool([None])
    util.Finalize(pool, pool.close, exitpriority=100)  # before queues close and children are waited for
    return pool


@contextmanager
def _lock_core() -> Iterator[int | None]:
    """A core that no other worker on this host uses, locked in the block; None where all are in use."""
    folder = Path(tempfile.gettempdir()) / f"evalkit-cores-{os.getuid() if hasattr(os, 'getuid') else 0}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    _require_own(folder)
    for core in environment.cores():
        lock = FileLock(folder / str(core))
        try:
            lock.acquire(timeout=0)
        except Timeout:
            continue
        try:
            yield core
        finally:
            lock.release()
        return
    yield None


def _require_own(folder: Path) -> None:
    """Raise StoreError for a folder in which another user may have put links to files of this one."""
    state = folder.lstat()
    owner = os.getuid() if hasattr(os, "getuid") else state.st_uid
    if not stat.S_ISDIR(state.st_mode) or state.st_uid != owner or state.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        what = "it is a link, or another user's, or others can write to it"
        raise StoreError(str(folder), what, "remove it, or set TMPDIR to a folder of your own")
