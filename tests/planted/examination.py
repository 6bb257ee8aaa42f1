"""Build a library with a planted fault, and examine it: rules, drawn questions, pairs of scans, and lockstep."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any

from evalkit.commands.validate import level_answers, probes, question_probes
from evalkit.commands.validate.comparison_terms import ComparisonTerms, choose_margin
from evalkit.commands.validate.rules import runner
from evalkit.core.errors import BackendFailed
from evalkit.execution import sandbox
from evalkit.external import INCLUDE
from evalkit.plugins import defaults
from evalkit.plugins.address import backend_at

FOLDER = Path(__file__).parent
MARGINS = ["exact", "float32"]
COMPILERS = {
    ".c": ("cc", "clang", "aarch64-linux-gnu-gcc"),
    ".cpp": ("c++", "clang++", "aarch64-linux-gnu-g++"),
    ".rs": ("rustc",),
}
CROSS, EMULATOR = "aarch64", "qemu-aarch64"
"""Compilers for another processor, and what runs their programs here."""

SERVE = INCLUDE / "examples" / "c" / "serve.c"

CORE = FOLDER.parent.parent / "baselines" / "evalkit_baselines" / "embedded"
LINKED = {
    "odometry.c": [*map(str, sorted((CORE / "src").glob("*.c"))), "-I", str(CORE / "include"), "-ffp-contract=off"]
}
"""What a source is compiled with: the odometry wraps the embedded core."""

REFERENCES = {"odometry": "embedded-pipeline"}
"""The reference by the kind of a back end, where it is not the default one."""

STANDARDS = {".c": "-std=gnu99", ".cpp": "-std=c++17"}


def build(number: int, folder: Path, options: str = "-O1", compiler: str = "cc", source: str = "planted.c") -> str:
    """Compile a source with one fault; returns its name as a back end."""
    name = f"{Path(source).stem}-{number}-{re.sub(r'[^A-Za-z0-9]+', '', compiler + options)}"
    if source.endswith(".rs"):
        file = folder / name
        words = ["--cfg", f'fault="{number}"', "-A", "warnings", str(FOLDER / source)]
    else:
        foreign = compiler.startswith(CROSS)
        file = folder / (name if foreign else f"lib{name}.so")
        words = [STANDARDS[Path(source).suffix], f"-DFAULT={number}", "-I", str(INCLUDE)]
        words += ["-static", "-x", "c", str(SERVE), "-x", "none"] if foreign else ["-shared", "-fPIC"]
        words += [str(FOLDER / source), *LINKED.get(source, []), "-lm", "-lpthread"]
    subprocess.run([compiler, *options.split(), *words, "-o", str(file)], check=True)
    if compiler.startswith(CROSS):
        return f"exec:{EMULATOR} {file}"
    return f"{'exec' if source.endswith('.rs') else 'lib'}:{file}"


def examine(backend: str, seed: int) -> list[str]:
    """The texts of all failed checks of a back end: its rules, then the comparison in a process of its own.

    Of one that does not start, why it cannot be checked.
    """
    try:
        checked = runner.check(backend, seed=seed)
    except BackendFailed as error:
        return [str(error)]
    broken = [f"rule {one.rule}: {one.observed}" for one in checked.broken]
    result = sandbox.run(compare, {"backend": backend, "seed": seed}, 240.0, 2048)
    return [*broken, *result.get("texts", [f"comparison: {result.get(sandbox.ENDED)}"])]


def compare(backend: str, seed: int) -> dict[str, Any]:
    """The texts of the failed checks of levels 1 and 2 on a few pairs of scans, drawn questions and a short drive."""
    reference = REFERENCES.get(backend_at(backend).kind, defaults.find_reference_backend())
    a, b = ({"name": name, "given": {}} for name in (reference, backend))
    dataset = defaults.find_simulated_dataset()
    parameters = dict(defaults.find_excerpts("quick")[dataset]) | {"seed": seed % 1000}
    on = {"label": dataset, "dataset": dataset, "parameters": parameters}
    results = {
        "pairs": probes.compare_pairs(a, b, on, 6, True, MARGINS),
        "questions": question_probes.compare_questions(a, b, seed, MARGINS, True),
        "scans": probes.compare_scans(a, b, on, 8, MARGINS),
    }
    margin = choose_margin(results, MARGINS)
    terms = ComparisonTerms(backend, reference, margin, 0.5)
    drawn = {f"seed {seed}": results["questions"]}
    levels = (
        level_answers.registrations_level({dataset: results["pairs"]}, {}, terms, drawn),
        level_answers.lockstep_level({dataset: results["scans"]}, terms),
    )
    return {"texts": [f"{one.name}: {one.observed}" for level in levels for one in level.failed("equal")]}
