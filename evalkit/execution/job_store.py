"""Many small computations, each kept as soon as it is done: a killed study goes on where it was."""

from __future__ import annotations

import hashlib
import importlib
import io
import json
import multiprocessing
import os
import platform
import re
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass, field
from functools import cache
from multiprocessing.queues import Queue
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from evalkit.core.errors import EvalkitError, StoreError, plain
from evalkit.execution import deadline, environment, parent_watch
from evalkit.execution.dask_cluster import Call, Cluster, NoCluster, Slot
from evalkit.io import untrusted_io
from evalkit.plugins.code_hash import fingerprint
from evalkit.results.store import REMEDY, reported

Result = Mapping[str, Any]
"""What a job gives: JSON values, and NumPy arrays at the top level."""

OnDone = Callable[[str, float], None]
"""Hears of a job that is done: its name, and the seconds it took (0 if it was kept from before)."""


@dataclass(frozen=True)
class Job:
    """One computation: ``function`` is "module:name" of a plain function, ``arguments`` are its keywords (JSON values).

    ``name`` is what results are asked for by; ``uses`` names modules the result stands on beyond what the function's
    module imports: plug-ins that are found by name. ``limit_s``: the wall clock it may take, 0 for any; its process is
    ended then, whatever it does.
    """

    name: str
    function: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    uses: tuple[str, ...] = ()
    limit_s: float = 0.0

    @property
    def key(self) -> str:
        """Names the result's file; changes with all that could change the result."""
        code = _code((self.function.partition(":")[0], *self.uses))
        identity = json.dumps([self.function, dict(self.arguments), code], sort_keys=True)
        word = re.sub(r"[^\w.=+-]+", "-", self.name)[:80].strip("-.") or "job"
        word = word.encode()[:80].decode(errors="ignore")  # names of files are counted in bytes
        return f"{word}-{hashlib.sha256(identity.encode()).hexdigest()[:12]}"


Computed = tuple[Job, Future[tuple[Result, float]]]
"""A job, and what comes of it: its result and the seconds it took."""


class JobsFailed(EvalkitError):
    """Some jobs raised; all the others are kept: ``JobsFailed(folder, which and why)``; ``reasons`` by their names."""

    reasons: Mapping[str, str] = MappingProxyType({})

    def __init__(self, folder: str, what: str) -> None:
        super().__init__(folder, what)

    def __str__(self) -> str:
        folder, what = self.args
        return plain(f"{folder}: {what}; the finished ones are kept, the same command goes on")


@dataclass(frozen=True)
class Ledger:
    """The results of jobs in a folder, one file each, written whole or not at all."""

    folder: Path

    def run(
        self,
        jobs: Iterable[Job],
        workers: int = 1,
        done: OnDone = lambda _name, _seconds: None,
        cluster: Cluster | None = None,
    ) -> dict[str, Result]:
        """The result of every job by name: what is here is taken, the rest computed by so many processes.

        ``cluster``: whose workers compute it instead.

        Raises JobsFailed when all others are done and kept; StoreError where the folder cannot be written; NoCluster
        where a worker's code is not ours.
        """
        known = list(jobs)
        _refuse_doubles(known)
        kept = {job.name: found for job in known if (found := self.kept(job)) is not None}
        for name in kept:
            done(name, 0.0)
        missing = [job for job in known if job.name not in kept]
        made, reasons = self._made_there(missing, cluster, done) if cluster else self._made(missing, workers, done)
        if reasons:
            name, reason = next(iter(reasons.items()))
            others = f" and {len(reasons) - 1} more" if len(reasons) > 1 else ""
            failed = JobsFailed(str(self.folder), f"{name}{others} failed: {reason}")
            failed.reasons = reasons
            raise failed
        found = kept | made
        return {job.name: found[job.name] for job in known}

    def kept(self, job: Job) -> Result | None:
        """The stored result of a job, None if there is none that can be read."""
        path = self.path(job)
        try:
            file = untrusted_io.read_arrays(path)
            content = untrusted_io.parse_json(str(file.pop("json")))
        except (OSError, ValueError, KeyError):
            return None
        return content | file if isinstance(content, dict) else None

    def path(self, job: Job) -> Path:
        """Where the result of a job stands."""
        return self.folder / f"{job.key}.npz"

    def keep(self, job: Job, result: Result) -> None:
        """Writes the result of a job, whole or not at all."""
        members: dict[str, Any] = {name: value for name, value in result.items() if isinstance(value, np.ndarray)}
        rest = {name: value for name, value in result.items() if name not in members}
        body = io.BytesIO()
        np.savez_compressed(body, **members, json=np.array(json.dumps(rest)))
        path = self.path(job)
        part = path.with_name(f"{path.name}.{os.getpid()}.part")
        with reported(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
            part.write_bytes(body.getvalue())
            part.replace(path)

    def _made(self, jobs: list[Job], workers: int, done: OnDone) -> tuple[dict[str, Result], dict[str, str]]:
        """Results and reasons of failure by name. A job that ends its process is asked again in one of its own.

        Not so one that was ended for its time. Those that had not begun when a process ended begin anew with the rest.
        """
        made: dict[str, Result] = {}
        reasons: dict[str, str] = {}
        waiting = jobs
        while waiting:
            ended = self._gathered(self._computed(waiting, workers), made, reasons, done)
            told = {job.name: deadline.taken(self._note(job), job.limit_s) for job in ended}
            begun = [job for job in ended if told[job.name] is not None] or ended  # or no process came so far
            for job in begun:
                late = told[job.name] or self._alone(job, made, reasons, done)
                reasons.update({job.name: late} if late else {})
            names = {job.name for job in begun}
            waiting = [job for job in ended if job.name not in names]
        return made, reasons

    def _alone(self, job: Job, made: dict[str, Result], reasons: dict[str, str], done: OnDone) -> str:
        """Computes a job in a process of its own; why that ended, or ""."""
        if not self._gathered(self._computed([job], 1), made, reasons, done):
            return ""
        return deadline.taken(self._note(job), job.limit_s) or "it ended its process"

    def _computed(self, jobs: list[Job], workers: int) -> Iterator[Computed]:
        with reported(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
        yield from _computed([(job, self._note(job)) for job in jobs], workers)

    def _note(self, job: Job) -> Path:
        """The file that is there while we have a job computed."""
        return self.folder / f"{job.key}.{os.getpid()}.running"

    def _made_there(self, jobs: list[Job], cluster: Cluster, done: OnDone) -> tuple[dict[str, Result], dict[str, str]]:
        """The same by the workers of a cluster, which has asked again already who ended its worker."""
        made: dict[str, Result] = {}
        reasons: dict[str, str] = {}
        by_key = {job.key: job for job in jobs}
        calls = (Call(key, on_worker, (job, key)) for key, job in by_key.items())
        with closing(cluster.answers(calls)) as answers:
            self._gathered(((by_key[call.name], future) for call, future in answers), made, reasons, done)
        return made, reasons

    def _gathered(
        self, computed: Iterator[Computed], made: dict[str, Result], reasons: dict[str, str], done: OnDone
    ) -> list[Job]:
        """Takes in what is computed, results into ``made`` and reasons of failure; the jobs whose process has ended."""
        ended = []
        for job, future in computed:
            try:
                result, seconds = future.result()
            except BrokenProcessPool:
                ended.append(job)
            except NoCluster:  # a worker's fault is no result of a job
                raise
            except Exception as error:  # noqa: BLE001 - whatever a job raises must not take the others along
                reasons[job.name] = f"{type(error).__name__}: {error}"
            else:
                self._take(job, result, seconds, made, done)
        return ended

    def _take(self, job: Job, result: Result, seconds: float, made: dict[str, Result], done: OnDone) -> None:
        self.keep(job, result)
        kept = self.kept(job)  # as a second run will see it
        if kept is None:
            raise StoreError(str(self.path(job)), "was written but cannot be read back", REMEDY)
        made[job.name] = kept
        done(job.name, seconds)


def call_noted(function: str, arguments: Mapping[str, Any], note: str, limit_s: float) -> tuple[Result, float]:
    """The same as ``call`` under a limit of time, with a note of it while it lasts."""
    with deadline.noted(Path(note), limit_s):
        return call(function, arguments)


def call(function: str, arguments: Mapping[str, Any]) -> tuple[Result, float]:
    """What "module:name" gives for the keywords, and the seconds it took."""
    module, _, name = function.partition(":")
    started = time.perf_counter()
    try:
        result: Result = getattr(importlib.import_module(module), name)(**arguments)
    except Exception as error:
        error.add_note(traceback.format_exc())
        raise
    return result, time.perf_counter() - started


def on_worker(job: Job, key: str, _slot: Slot) -> tuple[Result, float]:
    """The same on a cluster's worker; whoever is late is lost with it. NoCluster where its ``key`` is another."""
    if job.key != key:
        what = "the code on this worker is another one"
        raise NoCluster(platform.node(), what, "install the same versions on every worker, and restart them")
    with tempfile.TemporaryDirectory(prefix="evalkit-") as folder:
        return call_noted(job.function, job.arguments, str(Path(folder) / "note"), job.limit_s)


def _computed(jobs: list[tuple[Job, Path]], workers: int) -> Iterator[Computed]:
    """The jobs as they are done, computed by processes with one thread and one core each."""
    if not jobs:
        return
    os.environ.update(environment.SINGLE_THREAD)  # inherited by the processes
    context = multiprocessing.get_context("spawn")
    cores: Queue[int | None] = context.Queue()
    for core in environment.core_of_each(workers):
        cores.put(core)
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_settle, initargs=(cores,))
    try:
        futures = {_submitted(pool, job, note): job for job, note in jobs}
        for future in as_completed(futures):
            yield futures[future], future
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _submitted(pool: ProcessPoolExecutor, job: Job, note: Path) -> Future[tuple[Result, float]]:
    try:
        return pool.submit(call_noted, job.function, dict(job.arguments), str(note), job.limit_s)
    except BrokenProcessPool as error:  # an earlier job has ended its process already
        future: Future[tuple[Result, float]] = Future()
        future.set_exception(error)
        return future


def _settle(cores: Queue[int | None]) -> None:
    """A worker's start: with its parent, on a core."""
    parent_watch.serve_parent()
    core = cores.get()
    if core is not None:
        os.sched_setaffinity(0, {core})


@cache  # hundreds of jobs stand on the same sources
def _code(modules: tuple[str, ...]) -> str:
    return fingerprint(modules, ("numpy", "scipy"))


def _refuse_doubles(jobs: list[Job]) -> None:
    names = [job.name for job in jobs]
    doubled = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
    if doubled:
        raise ValueError(f"jobs: two are named {doubled[0]!r}")
