"""Count the lines and branches of the Python code that the tests reach: ``make coverage``.

Runs the tests with coverage.py, in the processes that they start as well, and prints each package's share of lines and
branches, and those of all beside the aims. ``--list`` prints what no test reaches. Other arguments go to pytest:
``-- -m ''`` adds the thorough tests, as the make target does. A process that is killed has no share.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
COUNTS = ("covered_lines", "num_statements", "covered_branches", "num_branches")
AIMS = {"lines": 96.0, "branches": 92.0}

SETTINGS = """
[run]
branch = true
parallel = true
source_pkgs = evalkit, evalkit_baselines, evalkit_datasets, evalkit_paper
patch = subprocess, _exit
sigterm = true
disable_warnings = module-not-imported
data_file = {folder}/.coverage
[report]
exclude_also =
    if TYPE_CHECKING:
    @overload
    raise NotImplementedError
    class .*\\bProtocol\\):
"""

UNCOUNTED = (
    "tests/report/test_browser.py",  # of the page's script, not of Python
    "tests/test_cli.py::test_a_disk_that_fills_up_is_exit_code_2_and_a_message",  # the counters need files, too
    "tests/io/test_hostile_files.py::test_any_input_is_read_within_limits_with_a_result_or_a_short_error",  # and time
)


def main() -> int:
    """Print the table; returns 1 if a share is below the least asked for, or if a test fails."""
    options = argparse.ArgumentParser(description="Count what the tests reach of the Python code.")
    options.add_argument("--list", action="store_true", help="print the lines and branches that no test reaches")
    options.add_argument("--least-lines", type=float, default=0.0, help="fail below this share of lines in percent")
    options.add_argument(
        "--least-branches", type=float, default=0.0, help="fail below this share of branches in percent"
    )
    options.add_argument("pytest", nargs="*", help="arguments of pytest")
    given = options.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        settings = Path(folder) / "settings"
        settings.write_text(SETTINGS.format(folder=folder), encoding="utf-8")
        ended = run_tests(settings, given.pytest)
        files = read_files(settings)
    shares = print_table(files, given.list)
    print(", ".join(f"{name} {shares[name]:.2f} % (aim {aim:g} %)" for name, aim in AIMS.items()))
    return int(bool(ended) or shares["lines"] < given.least_lines or shares["branches"] < given.least_branches)


def run_tests(settings: Path, arguments: list[str]) -> int:
    """Run the tests with counters and return pytest's exit code."""
    left_out = [word for name in UNCOUNTED for word in ("--deselect", name)]
    command = [sys.executable, "-m", "coverage", "run", f"--rcfile={settings}", "-m", "pytest", "-q", *left_out]
    workers = ["-n", str(os.cpu_count()), "--dist", "loadfile"]
    return subprocess.run([*command, *workers, *arguments], cwd=ROOT, check=False).returncode


def read_files(settings: Path) -> dict[str, Any]:
    """What all processes together reached of each file, by its path."""
    result = settings.with_name("coverage.json")
    for words in (["combine", "-q"], ["json", "-q", "-o", str(result)]):
        command = [sys.executable, "-m", "coverage", *words, f"--rcfile={settings}"]
        subprocess.run(command, cwd=ROOT, check=True, stderr=subprocess.DEVNULL)  # files of killed processes
    files: dict[str, Any] = json.loads(result.read_text(encoding="utf-8"))["files"]
    return files


def print_table(files: dict[str, Any], missing: bool) -> dict[str, float]:
    """Print one line a package and their sum; returns the shares of lines and of branches in percent."""
    packages: dict[str, Counter[str]] = {}
    for name, file in sorted(files.items()):
        parts = Path(name).parent.parts
        package = "/".join(parts[:3] if parts[:2] == ("evalkit", "commands") else parts[:2])
        packages.setdefault(package, Counter()).update({key: file["summary"][key] for key in COUNTS})
        if missing and (file["missing_lines"] or file["missing_branches"]):
            lines = ", ".join(map(str, file["missing_lines"]))
            branches = ", ".join(f"{start}->{end}" for start, end in file["missing_branches"])
            print(f"{name}: lines {lines or 'none'}; branches {branches or 'none'}")
    total: Counter[str] = Counter()
    for counts in packages.values():
        total.update(counts)
    for package, counts in [*packages.items(), ("all", total)]:
        print(
            f"{package:40} lines {counts['covered_lines']:5} of {counts['num_statements']:5}  "
            f"branches {counts['covered_branches']:4} of {counts['num_branches']:4}"
        )
    return {
        "lines": 100.0 * total["covered_lines"] / max(total["num_statements"], 1),
        "branches": 100.0 * total["covered_branches"] / max(total["num_branches"], 1),
    }


if __name__ == "__main__":
    sys.exit(main())
