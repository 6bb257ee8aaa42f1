"""A folder with the results of tasks, one file each; a file is written completely or not at all."""

from __future__ import annotations

import io
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from evalkit.execution.task import R, Result, Task
from evalkit.io import untrusted_io
from evalkit.io.output_files import create_folder, write_bytes


@dataclass(frozen=True)
class TaskStore:
    """The stored results of tasks in ``folder``."""

    folder: Path

    def create(self) -> None:
        """Create the folder. Raises StoreError if it cannot be written."""
        create_folder(self.folder, self.folder)

    def load(self, task: Task[R]) -> R | None:
        """The stored result of a task, None if there is none that can be read."""
        return cast(R | None, read_result(self.path(task)))

    def path(self, task: Task[Result]) -> Path:
        """The file of a task's result."""
        return self.folder / f"{task.key}.npz"

    def note(self, task: Task[Result]) -> Path:
        """The file that exists while this process has the task computed."""
        return self.folder / f"{task.key}.{os.getpid()}.running"

    def save(self, task: Task[R], result: R) -> None:
        """Write the result of a task. Raises StoreError if the folder cannot be written."""
        write_result(self.path(task), result, self.folder)


def read_result(path: Path) -> Result | None:
    """The result in a file, None if there is none that can be read."""
    try:
        arrays = untrusted_io.read_arrays(io.BytesIO(untrusted_io.read_bytes(path)))
        content = untrusted_io.parse_json(str(arrays.pop("json")))
    except (OSError, ValueError, KeyError):
        return None
    return content | arrays if isinstance(content, dict) else None


def write_result(path: Path, result: Result, folder: Path) -> None:
    """Write a result to a file in a folder, completely or not at all. Raises StoreError if it cannot be written."""
    members: dict[str, Any] = {name: value for name, value in result.items() if isinstance(value, np.ndarray)}
    rest = {name: value for name, value in result.items() if name not in members}
    body = io.BytesIO()
    np.savez_compressed(body, **members, json=np.array(json.dumps(rest)))
    write_bytes(path, body.getvalue(), folder)
