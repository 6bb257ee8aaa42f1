"""Run every fault of a back end and print how each run ends and what it leaves: ``make faults``."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

TESTS = Path(__file__).resolve().parent.parent
STRANGERS = str(TESTS / "strangers")

AROUND = (
    ("poses in degrees", "commands/validate/rules/test_rules.py", "Degrees"),
    ("other scans' poses", "commands/validate/rules/test_rules.py", "OfOtherScans"),
    ("an import that crashes, or blocks on a lock", "plugins/test_registry.py", "import_crashes_or_hangs"),
    ("the runner killed", "test_cli.py", "runner_that_is_killed"),
    ("the disk full", "test_cli.py", "disk_that"),
    ("the clock set", "execution/test_scheduler.py", "system_clock"),
    ("two runners in one folder", "execution/test_scheduler.py", "two_processes"),
    ("a study's point that hangs, in Python and in C", "execution/test_task_runner.py", "hangs"),
    ("a study killed", "execution/test_task_runner.py", "killed_study"),
    (
        "a cluster's worker killed, a run that ends its workers",
        "execution/test_executors.py",
        "killed_worker or quarantined",
    ),
)
"""Faults that are no run's own: each with the tests that make it."""


def main() -> int:
    """Run all faults one after the other; returns the number of faults not survived."""
    sys.path.insert(0, STRANGERS)
    os.environ["PYTHONPATH"] = STRANGERS
    tests = _module(TESTS / "execution" / "test_run_process.py")
    console = Console(width=None if sys.stdout.isatty() else 160)
    table = Table("fault", "status", "reason", "answers kept", "processes left", "survived", title="Faults survived")
    lost = 0
    with tempfile.TemporaryDirectory(prefix="evalkit-faults-") as place:
        for fault, status, reason in tests.EXPECTED:
            folder = Path(place) / fault
            run = tests.execute_run(folder, tests.request(fault), tests.LIMITS.get(fault, tests.HASTE))
            left = len(tests.find_processes(folder))
            survived = run.status == status and reason in run.reason and not left
            lost += not survived
            kept = f"{len(run.steps)} of {run.expected}"
            row = (
                fault,
                run.status,
                Text(run.reason),
                kept,
                str(left),
                "yes" if survived else f"NO: expected {status}",
            )
            table.add_row(*row)
    console.print(table)
    lost += _around(console)
    every = len(tests.EXPECTED) + len(AROUND)
    console.print(f"{every - lost} of {every} faults survived")
    return lost


def _around(console: Console) -> int:
    """Print the result of the tests of faults outside a run, also thorough ones; returns how many are not survived."""
    table = Table("fault", "its tests", "survived", title="Faults around the runs")
    lost = 0
    for fault, file, chosen in AROUND:
        command = [sys.executable, "-m", "pytest", "-q", "--no-header", "-m", "", str(TESTS / file), "-k", chosen]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=TESTS.parent)
        lost += done.returncode != 0
        said = (done.stdout.strip().splitlines() or ["nothing"])[-1]
        table.add_row(fault, Text(said), "NO" if done.returncode else "yes")
    console.print(table)
    return lost


def _module(path: Path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


if __name__ == "__main__":
    sys.exit(min(main(), 1))
