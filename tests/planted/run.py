"""Validate a library with each planted fault, and print what was found and how it was named: ``make planted``."""

from __future__ import annotations

import argparse
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from examination import build, examine
from faults import BUILDS, FAULTS, Fault


@dataclass(frozen=True)
class Finding:
    """What was found about a build: the texts of all failed checks, the first ones first."""

    label: str
    name: str
    texts: tuple[str, ...]
    seconds: float

    @property
    def found(self) -> bool:
        """Whether any check failed."""
        return bool(self.texts)

    @property
    def named(self) -> bool:
        """Whether the first rules, or the first difference, bear the expected name."""
        rules = [text for text in self.texts if text.startswith("rule ")]
        first = [text for text in self.texts if not text.startswith("rule ")][:1]
        return any(re.search(self.name, text) for text in rules + first)


def run(faults: Iterable[Fault], builds: Iterable[tuple[str, str]], seed: int, jobs: int) -> Iterator[Finding]:
    """The findings about all faults and all correct builds, as they are ready."""
    with tempfile.TemporaryDirectory(prefix="evalkit-planted-") as root, ThreadPoolExecutor(jobs) as pool:

        def find(label: str, name: str, number: int, options: str, compiler: str) -> Finding:
            started = time.monotonic()
            texts = tuple(examine(build(number, Path(root), options, compiler), seed))
            return Finding(label, name, texts, time.monotonic() - started)

        waiting = [pool.submit(find, f"{compiler} {options}", "", 0, options, compiler) for compiler, options in builds]
        waiting += [pool.submit(find, f"{one.number} {one.what}", one.name, one.number, "-O1", "cc") for one in faults]
        for each in waiting:
            yield each.result()


def main() -> int:
    """Print the table; returns 1 if a fault was not found, or a correct build failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=int(time.time()) % 100_000)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument(
        "--only", type=int, nargs="*", help="numbers of faults; without any, all and the correct builds"
    )
    given = parser.parse_args()
    os.nice(5)
    chosen = [one for one in FAULTS if not given.only or one.number in given.only]
    compilers = [one for one in ("cc", "clang") if shutil.which(one)]
    builds = [] if given.only else [(compiler, options) for compiler in compilers for options in BUILDS]
    print(f"planted faults, --seed {given.seed}")
    findings = []
    for one in run(chosen, builds, given.seed, given.jobs):
        findings.append(one)
        verdict = "right" if not one.name and not one.found else "FALSE ALARM" if not one.name else (
            "named" if one.named else "found" if one.found else "MISSED")  # fmt: skip
        print(f"{verdict:11} {one.seconds:5.1f} s  {one.label}: {'; '.join(one.texts)[:230] or 'nothing'}", flush=True)
    faults, correct = [one for one in findings if one.name], [one for one in findings if not one.name]
    found, named = sum(one.found for one in faults), sum(one.named for one in faults)
    alarms = sum(one.found for one in correct)
    print(
        f"{found} of {len(faults)} faults found, {named} named rightly; {alarms} false alarms in {len(correct)} builds"
    )
    return 1 if found < len(faults) or alarms else 0


if __name__ == "__main__":
    sys.exit(main())
