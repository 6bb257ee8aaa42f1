"""Where a plan's runs are made: on the cores of this machine, or by the workers of a cluster."""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
import uuid
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from multiprocessing import current_process, util
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Protocol

from filelock import FileLock, Timeout

from evalkit.config.experiment import RunSpec
from evalkit.core.errors import StoreError
from evalkit.core.run_result import Cause
from evalkit.execution import dask_cluster, environment, run_archive, run_task
from evalkit.execution.dask_cluster import Call, Cluster, Slot, WorkerLost
from evalkit.execution.run_task import Bench, FinishedRun, Recipe, Scorers
from evalkit.plugins import registry
from evalkit.results.store import Store


class Progress(Protocol):
    """Hears how a comparison goes on; ``begun`` and ``answered`` are called from several threads."""

    def begun(self, planned: RunSpec) -> None:
        """A run starts."""
        ...

    def answered(self, planned: RunSpec, scans: int) -> None:
        """A run has answered so many scans; a cluster's workers do not tell."""
        ...

    def finished(self, ended: FinishedRun) -> None:
        """A run is done, scored and stored."""
        ...


class Place(Protocol):
    """Decides where runs are made, and nothing else about them."""

    def ended(
        self, store: Store, recipe: Recipe, todo: Sequence[RunSpec], progress: Progress
    ) -> Generator[FinishedRun]:
        """Every run as it ends, with what came of it in the store; ``todo``: what needs to be made or scored.

        Raises what stops the whole: a results folder that cannot be written, a cluster that is gone.
        """
        ...


@dataclass(frozen=True)
class Here:
    """This machine, ``jobs`` runs at a time, each pinned to a core of its own."""

    jobs: int

    def ended(
        self, store: Store, recipe: Recipe, todo: Sequence[RunSpec], progress: Progress
    ) -> Generator[FinishedRun]:
        """As Place says."""
        os.environ.update(environment.SINGLE_THREAD)  # inherited by the scoring processes, as by the runs
        cores, stop = _cores(self.jobs), threading.Event()

        def one(planned: RunSpec) -> FinishedRun:
            """What is raised here stops all the others at once."""
            if stop.is_set():
                raise CancelledError
            core = cores.get()
            try:
                progress.begun(planned)
                bench = Bench(core, scorers, lambda scans: progress.answered(planned, scans), stop)
                return run_task.execute_run(store, recipe, planned, bench)
            except BaseException:
                stop.set()
                raise
            finally:
                cores.put(core)  # after the scoring, which must not compete with a timed run

        with Scorers(self.jobs) as scorers, ThreadPoolExecutor(self.jobs) as slots:
            futures = [slots.submit(one, planned) for planned in todo]
            try:
                for future in as_completed(futures):
                    error = future.exception()
                    if error is None:
                        yield future.result()
                    elif not isinstance(error, CancelledError):
                        raise error
            except BaseException:  # an interrupt or an unwritable folder: end what runs, start nothing more
                stop.set()
                slots.shutdown(wait=True, cancel_futures=True)
                raise


@dataclass(frozen=True)
class There:
    """The workers of a cluster. Each makes a run in a folder of its own and sends it back: nothing need be shared."""

    workers: Cluster

    def ended(
        self, store: Store, recipe: Recipe, todo: Sequence[RunSpec], progress: Progress
    ) -> Generator[FinishedRun]:
        """As Place says."""
        folder = uuid.uuid5(uuid.NAMESPACE_URL, store.folder.absolute().as_uri()).hex
        by_name = {planned.key: planned for planned in todo}
        code = cache(registry.run_fingerprint)  # it reads files, and a plan may have thousands of runs

        def calls() -> Iterator[Call]:
            for planned in todo:
                progress.begun(planned)
                given = run_archive.packed(store, planned.key) if recipe.resume or recipe.collect else b""
                stands_on = code(planned.method.backend, planned.sequence.dataset)
                yield Call(planned.key, on_worker, (planned, recipe, stands_on, given, folder))

        with closing(self.workers.answers(calls())) as answers:
            for call, outcome in answers:
                planned = by_name[call.name]
                try:
                    ended, content = outcome.result()
                except WorkerLost as error:
                    yield FinishedRun(planned, run_task.quarantine(store, recipe, planned, str(error)))
                except Exception as error:  # noqa: BLE001 - one worker's fault must not stop the others
                    why = f"the worker could not make it: {type(error).__name__}: {error}"
                    yield FinishedRun(planned, run_task.empty_result(Cause.WORKER_FAILED, why))
                else:
                    run_archive.unpacked(store, planned.key, content)
                    store.forget_tries(planned.key)  # of who was lost here before
                    yield ended


def on_worker(
    planned: RunSpec, recipe: Recipe, code: str, given: bytes, folder: str, slot: Slot
) -> tuple[FinishedRun, bytes]:
    """How a run ended on this worker, and all the store shall keep of it.

    ``given``: what the store holds of it already. ``code``: what its key stands on; StoreError where ours differs.
    """
    current_process().daemon = False  # a nanny's worker may not start processes otherwise
    os.environ.update(environment.SINGLE_THREAD)
    _same_code(planned, recipe, code)
    worker = dask_cluster.dask().get_worker()
    place = Path(worker.local_directory).parent / f"evalkit-{folder}-{planned.key}"
    # Of one that was lost; whoever it left behind is ended with the next start.
    shutil.rmtree(place, ignore_errors=True)
    store = Store(place)
    try:
        if given:
            run_archive.unpacked(store, planned.key, given)
        with _own_core() as core:
            bench = Bench(core, _scorers(recipe.scored_by), lambda _scans: None, _Cancelled(worker))
            told = {**recipe.ran_on, **environment.machine(), "runs at a time": str(slot.beside)}
            ended = run_task.execute_run(store, replace(recipe, ran_on=told), planned, bench)
        return ended, run_archive.packed(store, planned.key)
    finally:
        shutil.rmtree(store.folder, ignore_errors=True)


class _Cancelled(threading.Event):
    """Set when nobody waits for this worker's task any more."""

    def __init__(self, worker: Any) -> None:
        super().__init__()
        self._worker, self._task = worker, worker.get_current_task()

    def is_set(self) -> bool:
        """Whether the task is cancelled."""
        task = self._worker.state.tasks.get(self._task)
        return task is None or task.state in ("cancelled", "resumed")


def _same_code(planned: RunSpec, recipe: Recipe, code: str) -> None:
    """A key and scores name the code they stand on: StoreError where this worker's is another."""
    own = registry.run_fingerprint(planned.method.backend, planned.sequence.dataset)
    if own != code or not recipe.scored_by.startswith(registry.score_fingerprint(recipe.mapper.name)):
        what = f"the code of '{planned.method.backend}', '{planned.sequence.dataset}' or evalkit is another one here"
        host = environment.machine()["host"]
        raise StoreError(host, what, "install the same versions on every worker, and restart them")


@lru_cache(maxsize=1)
def _scorers(_scored_by: str) -> Scorers:
    """A worker's own scoring process, kept for its next run; a new one where the code has changed."""
    scorers = Scorers(1)
    util.Finalize(scorers, scorers.close, exitpriority=100)  # before queues close and children are waited for
    return scorers


@contextmanager
def _own_core() -> Iterator[int | None]:
    """A core that no other worker of ours on this host has taken; None where all are taken."""
    folder = Path(tempfile.gettempdir()) / f"evalkit-cores-{os.getuid() if hasattr(os, 'getuid') else 0}"
    folder.mkdir(exist_ok=True)
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


def _cores(jobs: int) -> SimpleQueue[int | None]:
    """One core per job to pin to; None where the system cannot pin."""
    cores: SimpleQueue[int | None] = SimpleQueue()
    for core in environment.core_of_each(jobs):
        cores.put(core)
    return cores
