"""Count the lines and branches of the C core that its own tests reach: ``make core-coverage``.

Builds the core without optimisation, with gcc's counters, runs its own tests alone and prints each file's share of
lines and branches, in double and in single precision. ``--list`` prints what no test reaches. Needs cmake and gcov.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

CORE = Path(__file__).resolve().parent.parent.parent / "baselines" / "evalkit_baselines" / "embedded"
BUILDS = {"double": ("ek64", False), "single": ("ek32", True)}
"""The library of a precision, and whether the names of its tests end in -float."""


@dataclass
class FileCoverage:
    """How often each line ran and each branch was taken, by line number."""

    lines: dict[int, int] = field(default_factory=dict)
    branches: dict[int, list[int]] = field(default_factory=dict)

    def reached(self) -> tuple[int, int, int, int]:
        """Lines reached and all lines, branches reached and all branches."""
        taken = [count for counts in self.branches.values() for count in counts]
        return sum(map(bool, self.lines.values())), len(self.lines), sum(map(bool, taken)), len(taken)

    def missing(self) -> list[str]:
        """What no test reaches: a line, or the numbers of its branches in gcov's order."""
        found = []
        for line, count in sorted(self.lines.items()):
            counts = self.branches.get(line, [])
            if not count:
                found.append(f"{line}: not reached")
            elif not all(counts):
                at = ", ".join(str(index) for index, taken in enumerate(counts) if not taken)
                found.append(f"{line}: branch {at} of {len(counts)}")
        return found


def main() -> int:
    """Print the table; returns 1 if a precision is below the least shares asked for."""
    options = argparse.ArgumentParser(description="Count what the C core's own tests reach of its sources.")
    options.add_argument("--list", action="store_true", help="print the lines and branches that no test reaches")
    options.add_argument("--least-lines", type=float, default=0.0, help="fail below this share of lines in percent")
    options.add_argument(
        "--least-branches", type=float, default=0.0, help="fail below this share of branches in percent"
    )
    given = options.parse_args()
    low = False
    with tempfile.TemporaryDirectory() as place:
        build = Path(place)
        run_tests(build)
        for precision, (library, single) in BUILDS.items():
            files = read_coverage(build / "CMakeFiles", library, single)
            lines, branches = print_table(precision, files, given.list)
            low |= lines < given.least_lines or branches < given.least_branches
    return int(low)


def run_tests(build: Path) -> None:
    """Build the core with counters and run its own tests."""
    # -fno-inline: each condition is counted where it is written.
    flags = "-O0 -fno-inline --coverage -fprofile-abs-path"
    configure = ["cmake", "-S", str(CORE), "-B", str(build), "-DCMAKE_BUILD_TYPE=Debug", f"-DCMAKE_C_FLAGS={flags}"]
    for command in (
        [*configure, "-DEK_BUILD_PROGRAMS=OFF"],
        ["cmake", "--build", str(build), "-j2"],
        ["ctest", "--test-dir", str(build), "--output-on-failure"],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise SystemExit(done.stdout + done.stderr)


def read_coverage(targets: Path, library: str, single: bool) -> dict[str, FileCoverage]:
    """What the tests reached of each file below src, by its name: in the library or in a test that includes it."""
    counters = sorted((targets / f"{library}.dir").rglob("*.gcda"))
    for test in sorted(targets.glob("test_*.dir")):
        if test.stem.endswith("-float") == single:
            counters += sorted(test.rglob("*.gcda"))
    command = ["gcov", "--json-format", "--stdout", "--branch-probabilities", *map(str, counters)]
    found: dict[str, FileCoverage] = {}
    for document in subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines():
        for file in json.loads(document)["files"]:
            path = Path(file["file"])
            if path.parent == CORE / "src":
                _add(found.setdefault(path.name, FileCoverage()), file["lines"])
    return found


def _add(coverage: FileCoverage, lines: list[dict[str, Any]]) -> None:
    """Add the counts of one object."""
    branches: dict[int, list[int]] = {}
    for line in lines:
        number = line["line_number"]
        coverage.lines[number] = coverage.lines.get(number, 0) + line["count"]
        branches.setdefault(number, []).extend(branch["count"] for branch in line["branches"])
    for number, counts in branches.items():
        before = coverage.branches.get(number, [0] * len(counts))
        coverage.branches[number] = [one + other for one, other in zip(before, counts, strict=True)]


def print_table(precision: str, files: dict[str, FileCoverage], missing: bool) -> tuple[float, float]:
    """Print one line a file and their sum; returns the shares of lines and of branches in percent."""
    total = [0, 0, 0, 0]
    for name, coverage in sorted(files.items()):
        counts = coverage.reached()
        total = [whole + part for whole, part in zip(total, counts, strict=True)]
        print(f"{precision} {name:16} lines {counts[0]:4} of {counts[1]:4}  branches {counts[2]:4} of {counts[3]:4}")
        for line in coverage.missing() if missing else ():
            print(f"  {name}:{line}")
    lines, branches = (100.0 * total[at] / max(total[at + 1], 1) for at in (0, 2))
    print(f"{precision}: lines {lines:.1f} %, branches {branches:.1f} % ({total[2]} of {total[3]})", flush=True)
    return lines, branches


if __name__ == "__main__":
    sys.exit(main())
