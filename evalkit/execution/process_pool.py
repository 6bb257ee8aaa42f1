"""Process pools whose workers end with their parent and can be pinned to cores."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.queues import Queue

from evalkit.execution import parent_watch


def start_pool(workers: int, cores: Sequence[int | None] = ()) -> ProcessPoolExecutor:
    """A pool of so many spawned processes; each takes one of ``cores`` for itself, if given (None: not pinned)."""
    context = multiprocessing.get_context("spawn")
    queue: Queue[int | None] = context.Queue()
    for core in cores:
        queue.put(core)
    return ProcessPoolExecutor(
        workers, mp_context=context, initializer=_start_worker, initargs=(queue if cores else None,)
    )


def _start_worker(cores: Queue[int | None] | None) -> None:
    """Prepares a worker process: it ends with its parent, and is pinned to a core."""
    parent_watch.serve_parent()
    core = cores.get() if cores is not None else None
    if core is not None:
        os.sched_setaffinity(0, {core})
