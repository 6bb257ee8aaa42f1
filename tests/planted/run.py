"""Validate a library with each planted fault, and print what was found and how it was named: ``make planted``."""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from faults import BUILDS, FAULTS, Fault

from evalkit.commands.validate import level_answers, probes, question_probes
from evalkit.commands.validate.acceptance import AcceptanceLevel
from evalkit.commands.validate.level_answers import ComparisonTerms
from evalkit.commands.validate.rules import runner
from evalkit.execution import sandbox
from evalkit.external import INCLUDE
from evalkit.plugins import defaults

SOURCE = Path(__file__).parent / "planted.c"
MARGINS = ["exact", "float32"]


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


def build(number: int, folder: Path, options: str = "-O1", compiler: str = "cc") -> str:
    """Compile the library with one fault; returns its name as a back end."""
    file = folder / f"libplanted-{number}-{re.sub(r'[^A-Za-z0-9]+', '', compiler + options)}.so"
    words = ["-std=gnu99", *options.split(), f"-DFAULT={number}", "-shared", "-fPIC", "-I", str(INCLUDE)]
    subprocess.run([compiler, *words, str(SOURCE), "-o", str(file), "-lm", "-lpthread"], check=True)
    return f"lib:{file}"


def examine(backend: str, seed: int, limit_s: float = 6.0) -> tuple[str, ...]:
    """The texts of the failed checks of a back end: rules, drawn questions, pairs of scans, lockstep."""
    levels = list(_levels(backend, seed, limit_s))
    failed = [(level, check) for level in levels for check in level.failed("equal") if check.name != "all rules"]
    return tuple(f"{check.name}: {check.observed}" for _, check in failed)


def _levels(backend: str, seed: int, limit_s: float) -> Iterator[AcceptanceLevel]:
    yield level_answers.rules_level(runner.check(backend, limit_s=limit_s, seed=seed).results)
    reference = defaults.find_reference_backend()
    a, b = ({"name": name, "given": {}} for name in (reference, backend))
    name, parameters = next(iter(defaults.find_excerpts("quick").items()))
    on = {"label": "room", "dataset": "room", "parameters": {"laps": 0.04, "seed": seed}}
    del name, parameters
    tasks = {
        "pairs": (probes.compare_pairs, {"a": a, "b": b, "on": on, "count": 6, "exact": True, "margins": MARGINS}),
        "questions": (
            question_probes.compare_questions, {"a": a, "b": b, "seed": seed, "margins": MARGINS, "quick": True},
        ),
        "scans": (probes.compare_scans, {"a": a, "b": b, "on": on, "scans": 8, "margins": MARGINS}),
    }  # fmt: skip
    results = {kind: sandbox.run(function, given, 60.0, 2048) for kind, (function, given) in tasks.items()}
    margin = level_answers.choose_margin(results, MARGINS)
    terms = ComparisonTerms(backend, reference, margin, 0.5)
    pairs, drawn = {"room": results["pairs"]}, {f"seed {seed}": results["questions"]}
    yield level_answers.registrations_level(pairs, {}, terms, drawn)
    yield level_answers.lockstep_level({"room": results["scans"]}, terms)


def run(faults: Iterable[Fault], builds: Iterable[tuple[str, str]], seed: int, jobs: int) -> Iterator[Finding]:
    """The findings about all faults and all correct builds, as they are ready."""
    with tempfile.TemporaryDirectory(prefix="evalkit-planted-") as root, ThreadPoolExecutor(jobs) as pool:
        os.environ["XDG_CACHE_HOME"] = root

        def find(label: str, name: str, number: int, options: str, compiler: str) -> Finding:
            started = time.monotonic()
            texts = examine(build(number, Path(root), options, compiler), seed)
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
