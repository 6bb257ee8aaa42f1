"""Build a library with a planted fault, and examine it: rules, drawn questions, pairs of scans, and lockstep."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Any

from evalkit.commands.validate import level_answers, probes, question_probes
from evalkit.commands.validate.level_answers import ComparisonTerms
from evalkit.commands.validate.rules import runner
from evalkit.execution import sandbox
from evalkit.external import INCLUDE
from evalkit.plugins import defaults

SOURCE = Path(__file__).parent / "planted.c"
MARGINS = ["exact", "float32"]


def build(number: int, folder: Path, options: str = "-O1", compiler: str = "cc") -> str:
    """Compile the library with one fault; returns its name as a back end."""
    file = folder / f"libplanted-{number}-{re.sub(r'[^A-Za-z0-9]+', '', compiler + options)}.so"
    words = ["-std=gnu99", *options.split(), f"-DFAULT={number}", "-shared", "-fPIC", "-I", str(INCLUDE)]
    subprocess.run([compiler, *words, str(SOURCE), "-o", str(file), "-lm", "-lpthread"], check=True)
    return f"lib:{file}"


def examine(backend: str, seed: int) -> list[str]:
    """The texts of all failed checks of a back end: its rules, then the comparison in a process of its own."""
    checked = runner.check(backend, seed=seed)
    broken = [f"rule {one.rule}: {one.observed}" for one in checked.broken]
    result = sandbox.run(compare, {"backend": backend, "seed": seed}, 240.0, 2048)
    return [*broken, *result.get("texts", [f"comparison: {result.get(sandbox.ENDED)}"])]


def compare(backend: str, seed: int) -> dict[str, Any]:
    """The texts of the failed checks of levels 1 and 2 on a few pairs of scans, drawn questions and a short drive."""
    reference = defaults.find_reference_backend()
    a, b = ({"name": name, "given": {}} for name in (reference, backend))
    dataset = defaults.find_simulated_dataset()
    parameters = dict(defaults.find_excerpts("quick")[dataset]) | {"seed": seed % 1000}
    on = {"label": dataset, "dataset": dataset, "parameters": parameters}
    results = {
        "pairs": probes.compare_pairs(a, b, on, 6, True, MARGINS),
        "questions": question_probes.compare_questions(a, b, seed, MARGINS, True),
        "scans": probes.compare_scans(a, b, on, 8, MARGINS),
    }
    margin = level_answers.choose_margin(results, MARGINS)
    terms = ComparisonTerms(backend, reference, margin, 0.5)
    drawn = {f"seed {seed}": results["questions"]}
    levels = (
        level_answers.registrations_level({dataset: results["pairs"]}, {}, terms, drawn),
        level_answers.lockstep_level({dataset: results["scans"]}, terms),
    )
    return {"texts": [f"{one.name}: {one.observed}" for level in levels for one in level.failed("equal")]}
