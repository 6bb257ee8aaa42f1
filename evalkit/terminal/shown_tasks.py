"""Run the tasks of a command with progress on the terminal; results are kept in its folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from evalkit.execution import environment
from evalkit.execution.task import R, Task
from evalkit.execution.task_runner import run_tasks
from evalkit.execution.task_store import TaskStore
from evalkit.terminal import progress
from evalkit.terminal.console import err


def run_shown_tasks(tasks: Sequence[Task[R]], folder: Path, workers: int | None, what: str) -> dict[str, R]:
    """Run tasks with progress and return their results by name; finished ones are kept in ``folder / "results"``.

    ``workers``: tasks at a time, None: one per physical core; ``what``: the tasks as they are named on an interrupt.
    """
    workers = workers or environment.physical_cores()
    with progress.announce_kept(err, f"finished {what}"), progress.show_tasks(err, len(tasks), workers) as done:
        return run_tasks(TaskStore(folder / "results"), tasks, workers, done)
