"""Every fault of a back end, what becomes of the run, and what is left: ``make faults``."""

from __future__ import annotations

import importlib.util
import os
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

TESTS = Path(__file__).resolve().parent.parent
STRANGERS = str(TESTS / "strangers")


def main() -> int:
    """Runs all faults one after the other; the number of those that were not survived."""
    sys.path.insert(0, STRANGERS)
    os.environ["PYTHONPATH"] = STRANGERS
    tests = _module(TESTS / "test_runner.py")
    console = Console(width=None if sys.stdout.isatty() else 160)
    table = Table("fault", "status", "reason", "answers kept", "processes left", "survived", title="Faults survived")
    lost = 0
    with tempfile.TemporaryDirectory(prefix="evalkit-faults-") as place:
        for fault, status, reason in tests.EXPECTED:
            folder = Path(place) / fault
            run = tests.made(folder, tests.request(fault), tests.LIMITS.get(fault, tests.HASTE))
            left = len(tests.left(folder))
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
    console.print(f"{len(tests.EXPECTED) - lost} of {len(tests.EXPECTED)} faults survived")
    return lost


def _module(path: Path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


if __name__ == "__main__":
    sys.exit(min(main(), 1))
