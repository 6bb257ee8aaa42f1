"""Change one operator or number of the code at a time and count how often the tests notice: ``make mutation``.

A sample, drawn by seed, of the mutants of the metrics, of the odometry, of the statistics and of the C core. A mutant
of Python meets the tests of its module, then those of its folder; one of C meets the core's own tests. Survivors are
printed: each is a missing test, or the same function written in another way.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import importlib.abc
import multiprocessing
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
CORE = ROOT / "baselines" / "evalkit_baselines" / "embedded"
FOLDERS = ("metrics", "odometry", "stats")
TIME_LIMIT_S = 180.0
"""Of the tests of one mutant, some ten times what the unchanged code takes; a mutant that takes longer is noticed."""

LIBRARIES = ("hypothesis", "numpy", "pytest", "scipy.ndimage", "scipy.optimize", "scipy.spatial", "scipy.stats")
"""Imported once, before the process of each mutant of Python is forked: that takes longer than most tests."""

COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
}  # fmt: skip
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
}  # fmt: skip
IN_C = {
    " + ": " - ", " - ": " + ", " * ": " / ", " / ": " * ", " < ": " <= ", " <= ": " < ", " > ": " >= ", " >= ": " > ",
    " == ": " != ", " != ": " == ", " && ": " || ", " || ": " && ", " += ": " -= ", " -= ": " += ",
    "EK_R(1.0)": "EK_R(2.0)", "EK_R(0.0)": "EK_R(1.0)", "EK_R(2.0)": "EK_R(1.0)",
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One changed file. ``what``: its line and the change."""

    file: Path
    what: str
    content: str


def main() -> int:
    """Print the survivors and the score of each part; returns 1 if a part is below the least score asked for."""
    options = argparse.ArgumentParser(description="Count the changed operators and numbers that the tests notice.")
    options.add_argument("--limit", type=int, default=40, help="mutants of each part (default 40)")
    options.add_argument("--seed", type=int, default=1, help="seed of the sample (default 1)")
    options.add_argument("--part", choices=("c", *FOLDERS), action="append", help="one part (default: all)")
    options.add_argument("--least", type=float, default=0.0, help="fail below this share of noticed mutants in percent")
    given = options.parse_args()
    low = False
    for part in given.part or ("c", *FOLDERS):
        files = sorted((CORE / "src").glob("*.c") if part == "c" else (ROOT / "evalkit" / part).glob("*.py"))
        every = [mutant for file in files for mutant in (mutate_c if part == "c" else mutate_python)(file)]
        sample = random.Random(given.seed).sample(every, min(given.limit, len(every)))
        counts = (count_in_c if part == "c" else count_in_python)(sample)
        score = 100.0 * counts["noticed"] / max(len(sample), 1)
        print(
            f"{part}: {counts['noticed']} of {len(sample)} mutants noticed ({score:.0f} %), of {len(every)}", flush=True
        )
        low |= score < given.least
    return int(low)


def mutate_python(file: Path) -> Iterator[Mutant]:
    """Yield the mutants of a module: comparisons, arithmetic, and/or, and numbers, without messages and annotations."""
    source = file.read_text(encoding="utf-8")
    count = sum(1 for _ in _places(ast.parse(source)))
    for index in range(count):
        tree = ast.parse(source)
        node = next(node for at, node in enumerate(_places(tree)) if at == index)
        before = ast.unparse(node)
        _change(node)
        what = f"{file.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}: {before} -> {ast.unparse(node)}"
        yield Mutant(file, what, ast.unparse(tree))


def _places(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes that can be changed below a node, in order."""
    if isinstance(node, ast.Raise | ast.JoinedStr | ast.Assert):  # messages
        return
    if (
        (isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARISONS)
        or (isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in OPERATORS)
        or isinstance(node, ast.BoolOp)
        or (isinstance(node, ast.Constant) and type(node.value) in (int, float))
    ):
        yield node
    for name, value in ast.iter_fields(node):
        if name not in ("annotation", "returns", "decorator_list"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _places(child)


def _change(node: ast.AST) -> None:
    match node:
        case ast.Compare():
            node.ops[0] = COMPARISONS[type(node.ops[0])]()
        case ast.BinOp() | ast.AugAssign():
            node.op = OPERATORS[type(node.op)]()
        case ast.BoolOp():
            node.op = ast.And() if isinstance(node.op, ast.Or) else ast.Or()
        case ast.Constant(value=int() | float() as value):
            node.value = value + 1


def mutate_c(file: Path) -> Iterator[Mutant]:
    """Yield the mutants of a C file: one operator or constant each, outside comments and preprocessor lines."""
    lines = file.read_text(encoding="utf-8").split("\n")
    inside = False
    for at, line in enumerate(lines):
        comment = inside or line.lstrip().startswith(("#", "/*", "*", "EK_COUNT("))  # counts nothing in this build
        inside = "/*" in line if not inside else "*/" not in line
        inside = inside and "*/" not in line.rpartition("/*")[2]
        for old, new in {} if comment else IN_C.items():
            for found in re.finditer(re.escape(old), line.partition("/*")[0]):
                changed = line[: found.start()] + new + line[found.end() :]
                what = f"{file.relative_to(ROOT)}:{at + 1}: {line.strip()} -> {changed.strip()}"
                yield Mutant(file, what, "\n".join([*lines[:at], changed, *lines[at + 1 :]]))


def count_in_python(sample: list[Mutant]) -> Counter[str]:
    """Run the tests on every mutant; prints the survivors."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # a fork inherits no threads
    for library in LIBRARIES:
        importlib.import_module(library)
    counts: Counter[str] = Counter()
    for mutant in sample:
        package = mutant.file.parent.name
        own = ROOT / "tests" / package / f"test_{mutant.file.stem}.py"
        steps = [own, own.parent] if own.exists() else [own.parent]
        _count(counts, mutant, any(_fails_python(mutant, tests) for tests in steps))
    return counts


def _fails_python(mutant: Mutant, tests: Path) -> bool:
    """Run the tests in a fork that reads one module from another file: the checkout itself is never changed."""
    with tempfile.TemporaryDirectory() as place:
        changed = Path(place) / mutant.file.name
        changed.write_text(mutant.content, encoding="utf-8")
        process = multiprocessing.get_context("fork").Process(target=_run_tests, args=(mutant.file, changed, tests))
        process.start()
        process.join(TIME_LIMIT_S)
        if process.pid:
            _end_session(process.pid)
        process.join()
        return process.exitcode != 0


def _run_tests(file: Path, changed: Path, tests: Path) -> None:
    os.setsid()
    null = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(null, descriptor)
    os.chdir(ROOT)
    module = ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    sys.meta_path.insert(0, _MutantFinder(module, changed))
    os._exit(int(importlib.import_module("pytest").main(["-q", "-x", "-p", "no:cacheprovider", str(tests)])))


class _MutantFinder(importlib.abc.MetaPathFinder):
    def __init__(self, module: str, changed: Path) -> None:
        self._module, self._changed = module, changed

    def find_spec(self, fullname: str, path: object, target: object = None) -> ModuleSpec | None:
        del path, target
        return spec_from_file_location(fullname, self._changed) if fullname == self._module else None


def count_in_c(sample: list[Mutant]) -> Counter[str]:
    """Build a copy of the core with every mutant and run its own tests; prints the survivors."""
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as place:
        copy, build = Path(place) / "core", Path(place) / "build"
        shutil.copytree(CORE, copy)
        options = ["-DEK_BUILD_FLOAT=OFF", "-DEK_WERROR=OFF", "-DCMAKE_BUILD_TYPE=None", "-DCMAKE_C_FLAGS=-O1"]
        options.append("-DEK_SANITIZE=ON")  # as .ci/embedded: what reads or writes beyond its memory is noticed
        subprocess.run(["cmake", "-S", copy, "-B", build, *options], check=True, capture_output=True)
        steps = (["cmake", "--build", str(build), "-j2"], ["ctest", "--test-dir", str(build), "--stop-on-failure"])
        if any(_fails([*step]) for step in steps):
            raise SystemExit("the tests of the unchanged core fail")
        for mutant in sample:
            file = copy / mutant.file.relative_to(CORE)
            original = file.read_text(encoding="utf-8")
            file.write_text(mutant.content, encoding="utf-8")
            _count(counts, mutant, any(_fails([*step]) for step in steps))
            file.write_text(original, encoding="utf-8")
    return counts


def _fails(command: list[str]) -> bool:
    """Run a command in a session of its own."""
    tests = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=ROOT, start_new_session=True
    )
    try:
        return tests.wait(TIME_LIMIT_S) != 0
    except subprocess.TimeoutExpired:
        return True
    finally:
        _end_session(tests.pid)
        tests.wait()


def _end_session(leader: int) -> None:
    """End the processes of a session that was started here: a mutant may loop for ever in any of them."""
    with suppress(ProcessLookupError):
        os.killpg(leader, signal.SIGKILL)


def _count(counts: Counter[str], mutant: Mutant, noticed: bool) -> None:
    counts["noticed"] += noticed
    if not noticed:
        print(f"survived: {mutant.what}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
