"""A task's result in the folder of a study."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import stored_run
from bounds import Violation, check_call, folder

from evalkit.execution.task import Task
from evalkit.execution.task_store import TaskStore
from evalkit.io import untrusted_io

TASK = Task("fuzz", untrusted_io.read_arrays)


def seeds() -> list[bytes]:
    """Return a result with a number and an array."""
    with tempfile.TemporaryDirectory() as place:
        store = TaskStore(Path(place))
        store.save(TASK, {"value": 1.5, "array": np.arange(3.0)})
        return [store.path(TASK).read_bytes()]


def swollen() -> list[bytes]:
    """Return the archives of a stored run."""
    return [content[1:] for content in stored_run.swollen() if content[0] == 3]


def read_input(data: bytes) -> None:
    """Load a result; a damaged one counts as absent."""
    untrusted_io.MAX_BYTES = 2**24  # as for a stored run
    store = TaskStore(folder())
    store.path(TASK).write_bytes(data)
    found: list[object] = []
    check_call(lambda: found.append(store.load(TASK)), len(data), "")
    if not isinstance(found[0], (dict, type(None))):
        raise Violation(f"a result that is a {type(found[0]).__name__}")
