"""Run a task that calls foreign code in a child process with limits; a crash or a broken limit is a result.

``python -m evalkit.execution.sandbox FOLDER`` reads the task from the folder and writes its result there.
"""

from __future__ import annotations

import gc
import os
import pickle
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from evalkit.execution.parent import end_with_parent
from evalkit.execution.subprocesses import ChildProcess
from evalkit.execution.task import AnyTask, Result, Task, make_task
from evalkit.execution.task_store import read_result, write_result
from evalkit.execution.usage import Usage

SYSTEM_PATH, REQUEST, RESULT = "path.pickle", "request.pickle", "result.npz"
PLACE = "place.txt"
PLACE_VARIABLE = "EVALKIT_PLACE"
"""Environment variable of the child: the file where it writes what it does next."""

ENDED = "ended"
"""The only key of a result whose process ended early; the value says how."""

MODULE = "evalkit.execution.sandbox"


def make_sandboxed_task(task: AnyTask, limit_s: float, memory_mib: int) -> AnyTask:
    """The task that runs another one in a sandbox; see ``run``."""
    inside = make_task(
        task.name, run, function=task.function, arguments=task.arguments, limit_s=limit_s, memory_mib=memory_mib
    )
    return replace(inside.depending_on(task.function.__module__, *task.modules), own_process=True)


def run(function: Callable[..., Result], arguments: Mapping[str, Any], limit_s: float, memory_mib: int) -> Result:
    """The function's result, or {"ended": how its process ended, and what it did then}.

    ``limit_s``: time from one noted place to the next, or to the end, see ``Usage.exceeds``. ``memory_mib``: memory of
    the process and of all that it starts.
    """
    task = Task("result", function, arguments)
    with tempfile.TemporaryDirectory(prefix="evalkit-validate-") as place:
        folder = Path(place)
        path = [str(Path(entry or ".").resolve()) for entry in sys.path]
        (folder / SYSTEM_PATH).write_bytes(pickle.dumps(path))
        (folder / REQUEST).write_bytes(pickle.dumps(task))
        with ChildProcess(MODULE, folder) as child:
            broken_limit = _watch(child, folder, limit_s, memory_mib)
        result = read_result(folder / RESULT) if not broken_limit else None
        if result is not None:
            return result
        how = broken_limit or child.describe_end()
        at = _read_place(folder)
        return {ENDED: f"{how}; it was in: {at}" if at else how}


def note_place(place: str) -> None:
    """Write down what the sandboxed code does next, in case the process ends there; nothing outside a sandbox."""
    if PLACE_VARIABLE in os.environ:
        Path(os.environ[PLACE_VARIABLE]).write_text(place, encoding="utf-8")


def main() -> int:
    """Run the task in the folder named on the command line."""
    end_with_parent()
    gc.enable()
    folder = Path(sys.argv[1]).resolve()  # a back end may change the working directory
    os.environ[PLACE_VARIABLE] = str(folder / PLACE)
    path = pickle.loads((folder / SYSTEM_PATH).read_bytes())
    sys.path.extend(entry for entry in path if entry not in sys.path)
    task: AnyTask = pickle.loads((folder / REQUEST).read_bytes())
    result, _ = task.run()
    write_result(folder / RESULT, result, folder)
    return 0


def _watch(child: ChildProcess, folder: Path, limit_s: float, memory_mib: int) -> str:
    """Watch the process until it ends; return the limit that it exceeded, or ""."""
    begin, place = Usage(0.0, 0.0, 0), ""
    for used in child.watch():
        if (now := _read_place(folder)) != place:
            begin, place = used, now
        if why := _broken_limit(used, limit_s, memory_mib, begin):
            return why
    return ""


def _broken_limit(used: Usage, limit_s: float, memory_mib: int, begin: Usage) -> str:
    if used.exceeds(limit_s, begin):
        return f"not finished after {limit_s:g} s"
    return f"used more than {memory_mib} MiB" if used.resident_bytes > memory_mib * 2**20 else ""


def _read_place(folder: Path) -> str:
    try:
        return (folder / PLACE).read_text(encoding="utf-8")
    except FileNotFoundError:
        return ""


if __name__ == "__main__":
    sys.exit(main())
