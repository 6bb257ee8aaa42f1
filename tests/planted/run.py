"""Validate a library with each planted fault, and print what was found and how it was named: ``make planted``.

Results are kept in a file with a row for each build; an interrupted run continues there while the code is the same. The
order of the builds is drawn by the seed: the rows of an interrupted run are a sample of all builds.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import re
import resource
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from examination import COMPILERS, CROSS, EMULATOR, FOLDER, LINKED, build, examine
from faults import BUILDS, FAULT_BUILDS, LIBRARIES, Fault

ROOT = FOLDER.parent.parent
CODE = (ROOT / "evalkit" / "commands" / "validate", ROOT / "evalkit" / "external", FOLDER)
UNRELATED = (FOLDER / "run.py", FOLDER / "test_planted.py")
HEAD, RULE = "| Build | Verdict | Found by | CPU time |", "|---|---|---|---|"
"""Of a table of builds on the page."""


@dataclass(frozen=True)
class Build:
    """A source to compile with one fault: 0 and an empty name for the correct one."""

    source: str
    fault: Fault
    compiler: str
    options: str

    @property
    def label(self) -> str:
        """Of its row in the table."""
        return f"{self.fault.number} {self.fault.what}" if self.fault.number else f"{self.compiler} {self.options}"


@dataclass(frozen=True)
class Finding:
    """What was found about a build: the texts of all failed checks, the first ones first, and the CPU time it took."""

    source: str
    label: str
    name: str
    texts: tuple[str, ...]
    seconds: float

    @property
    def found(self) -> bool:
        """Whether any check failed."""
        return bool(self.texts)

    @property
    def first(self) -> tuple[str, ...]:
        """The broken rules, and the first difference: what a report says first."""
        rules = tuple(text for text in self.texts if text.startswith("rule "))
        return rules + tuple(text for text in self.texts if text not in rules)[:1]

    @property
    def named(self) -> bool:
        """Whether the first texts bear the expected name."""
        return bool(self.name) and any(re.search(self.name, text) for text in self.first)

    @property
    def verdict(self) -> str:
        """In one word or two."""
        if not self.name:
            return "FALSE ALARM" if self.found else "right"
        return "named" if self.named else "found" if self.found else "MISSED"


def planned(sources: Sequence[str], numbers: Sequence[int], fault_options: str = "") -> Iterator[Build]:
    """All builds of the sources: the correct ones first, with every compiler that is here; or those of some faults.

    ``fault_options``: of the builds with a fault, "" for those of the source.
    """
    for source in sources:
        compilers = [one for one in COMPILERS[Path(source).suffix] if _is_possible(one, source)]
        for compiler in compilers if not numbers else ():
            correct = BUILDS[Path(source).suffix]
            some = correct if compiler == compilers[0] else correct[::3]
            allowed = [one for one in some if source not in LINKED or "-ffast-math" not in one]  # the C core refuses it
            yield from (Build(source, Fault(0, "", ""), compiler, one) for one in allowed)
        for fault in LIBRARIES[source]:
            if compilers and (not numbers or fault.number in numbers):
                options = fault_options or FAULT_BUILDS.get(source, BUILDS[Path(source).suffix][1])
                yield Build(source, fault, compilers[0], options)


def _is_possible(compiler: str, source: str) -> bool:
    """Whether a compiler is here; one for another processor needs its emulator, and a registration."""
    runs = not compiler.startswith(CROSS) or (source not in LINKED and shutil.which(EMULATOR) is not None)
    return runs and shutil.which(compiler) is not None


def run(builds: Sequence[Build], seed: int, jobs: int) -> Iterator[Finding]:
    """The findings about all builds, as they are ready."""
    with tempfile.TemporaryDirectory(prefix="evalkit-planted-") as root, ProcessPoolExecutor(jobs) as pool:
        for each in as_completed([pool.submit(find, one, Path(root), seed) for one in builds]):
            yield each.result()


def find(one: Build, folder: Path, seed: int) -> Finding:
    """Compile a build in the folder, and examine it."""
    started = _cpu_time()
    backend = build(one.fault.number, folder, one.options, one.compiler, one.source)
    texts = tuple(examine(backend, seed))
    return Finding(one.source, one.label, one.fault.name, texts, _cpu_time() - started)


def _cpu_time() -> float:
    """Of this process and of all its children that ended, in seconds."""
    both = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in both)


def code_hash() -> str:
    """Of the rules, the comparison and the planted sources: results of other code are not continued."""
    files = sorted(file for folder in CODE for file in folder.rglob("*.*") if file.suffix != ".pyc" and file.is_file())
    files = [file for file in files if file not in UNRELATED]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


def read_findings(file: Path, code: str | None) -> tuple[int | None, list[Finding]]:
    """The seed and the findings of an earlier run of the same code (None: of any), or none; the last of each build."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    if not lines or ((head := json.loads(lines[0])).get("code") != code and code is not None):
        return None, []
    rows = [json.loads(line) for line in lines[1:]]
    findings = [Finding(**{**row, "texts": tuple(row["texts"])}) for row in rows]
    return head["seed"], list({(one.source, one.label): one for one in findings}.values())


def as_page(findings: Sequence[Finding], seed: int | None) -> Iterator[str]:
    """The page of the documentation: a summary, the builds that ended otherwise than expected, then all, folded."""
    yield "---\ntitle: Planted faults\n---\n\n# Planted faults\n"
    yield (
        "What `evalkit validate` says about libraries with one planted fault each, and about correct builds. Written\n"
        f"by `python tests/planted/run.py --markdown` from the results of `make planted` with seed {seed}. How they\n"
        "are built: [validate](validate.md#5-what-it-would-have-found). *named*: found, and the report begins with\n"
        "the name that was expected; *found*: with another one.\n"
    )
    yield "| Source | Faults | Run | Found | Named | Correct builds run | False alarms |\n|---|---|---|---|---|---|---|"
    sources = [source for source in LIBRARIES if any(one.source == source for one in findings)]
    for source in sources:
        faults = [one for one in findings if one.source == source and one.name]
        correct = [one for one in findings if one.source == source and not one.name]
        planted = sum(bool(one.name) for one in LIBRARIES[source])
        found, named = sum(one.found for one in faults), sum(one.named for one in faults)
        alarms = sum(one.found for one in correct)
        yield f"| `{source}` | {planted} | {len(faults)} | {found} | {named} | {len(correct)} | {alarms} |"
    yield "\n## Not as expected\n"
    unexpected = [one for one in findings if one.verdict not in ("right", "named")]
    yield f"| Source {HEAD}\n|---{RULE}" if unexpected else "Nothing: each fault is named, and no correct build fails."
    yield from (f"| `{one.source}` {_row(one)}" for one in sorted(unexpected, key=_order))
    for source in sources:
        own = sorted((one for one in findings if one.source == source), key=_order)
        yield f'\n## {source}\n\n<details markdown="1">\n<summary>{len(own)} builds</summary>\n\n{HEAD}\n{RULE}'
        yield from map(_row, own)
        yield "\n</details>"


def _row(one: Finding) -> str:
    text = (one.first or ("nothing",))[-1 if not one.named else _naming(one)]
    text = " ".join(re.sub(r"[|`<>*_\[\]]|/\S*/", " ", text).split())[:150].rstrip()
    return f"| {one.label} | {one.verdict} | {text} | {one.seconds:.0f} s |"


def _naming(one: Finding) -> int:
    return next(number for number, text in enumerate(one.first) if re.search(one.name, text))


def _order(one: Finding) -> tuple[int, str]:
    number = one.label.partition(" ")[0]
    return (int(number) if number.isdigit() else 0, one.label)


def summaries(findings: Sequence[Finding]) -> Iterator[str]:
    """One line for each source: found, named, false alarms, time."""
    for source in dict.fromkeys(one.source for one in findings):
        own = [one for one in findings if one.source == source]
        faults, correct = [one for one in own if one.name], [one for one in own if not one.name]
        yield (
            f"{source}: {sum(one.found for one in faults)} of {len(faults)} faults found, "
            f"{sum(one.named for one in faults)} named rightly; {sum(one.found for one in correct)} false alarms in "
            f"{len(correct)} builds; median {statistics.median(one.seconds for one in own):.0f} s of CPU time"
        )


def main() -> int:
    """Print the table; returns 1 if a fault was not found, or a correct build failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int)
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--source", nargs="*", default=list(LIBRARIES), choices=list(LIBRARIES))
    parser.add_argument(
        "--only", type=int, nargs="*", default=[], help="numbers of faults (default: all, and correct builds)"
    )
    parser.add_argument("--options", default="", help="of the compiler for builds with a fault, such as '-O2 -DSINGLE'")
    parser.add_argument("--out", type=Path, default=ROOT / "reports" / "build" / "planted.jsonl")
    parser.add_argument("--markdown", action="store_true", help="print the kept results as a page, and run nothing")
    given = parser.parse_args()
    os.nice(5)
    code = code_hash()
    if given.markdown:
        kept_seed, findings = read_findings(given.out, None)
        print("\n".join(as_page(findings, kept_seed)))
        return 0
    kept_seed, findings = read_findings(given.out, code)
    seed = next((one for one in (given.seed, kept_seed) if one is not None), int(time.time()) % 100_000)
    if seed != kept_seed:
        findings = []
    given.out.parent.mkdir(parents=True, exist_ok=True)
    if not findings:
        given.out.write_text(json.dumps({"code": code, "seed": seed}) + "\n", encoding="utf-8")
    done = {(one.source, one.label) for one in findings}
    builds = [one for one in planned(given.source, given.only, given.options) if (one.source, one.label) not in done]
    random.Random(seed).shuffle(builds)
    print(f"planted faults, --seed {seed}: {len(done)} kept in {given.out}, {len(builds)} to do", flush=True)
    for one in run(builds, seed, given.jobs):
        findings.append(one)
        with given.out.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(one)) + "\n")
        print(
            f"{one.verdict:11} {one.seconds:5.1f} s  {one.label}: {'; '.join(one.texts)[:230] or 'nothing'}", flush=True
        )
    print("\n".join(summaries(findings)))
    return 1 if any(one.verdict in ("MISSED", "FALSE ALARM") for one in findings) else 0


if __name__ == "__main__":
    sys.exit(main())
