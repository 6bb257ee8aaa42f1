"""Summary of a command's runs at its end, and the exit code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import typer

from evalkit.core.run_result import BROKEN, NO_STEPS, NOT_EXECUTED, RunStatus
from evalkit.execution.run_task import FinishedRun
from evalkit.results.run_record import RunRecord
from evalkit.results.store import Store
from evalkit.terminal import options
from evalkit.terminal.options import out

MAX_NAMED = 50
"""Maximum number of missing runs that are listed by name."""

Run = FinishedRun | RunRecord


def without_steps(run: FinishedRun) -> FinishedRun:
    """The run without its answers: an experiment may have thousands of runs."""
    return replace(run, result=replace(run.result, steps=NO_STEPS))


def print_summary(runs: Sequence[Run], title: str, store: Store, page: Path | None, as_json: bool) -> None:
    """Print how the runs ended and where the page is.

    Exits with code 1 if a run that could have completed did not, with code 3 if a run is missing.
    """
    skipped = [run for run in runs if run.result.status == RunStatus.SKIPPED]
    if as_json:
        rows = [_as_json(run, store) for run in runs]
        options.print_json({"title": title, "page": str(page) if page else None, "runs": rows})
    else:
        _print_counts(runs, skipped)
        if page is not None:
            out.print(str(page.resolve()), highlight=False, markup=False)
    if any(run.result.status in BROKEN for run in runs):
        raise typer.Exit(1)
    if skipped:
        raise typer.Exit(3)


def _as_json(run: Run, store: Store) -> dict[str, Any]:
    spec, result = run.spec, run.result
    return {
        "method": spec.method.label,
        "sequence": spec.sequence.label,
        "seed": spec.seed,
        "status": result.status,
        "cause": result.cause,
        "reason": result.reason,
        "key": spec.key,
        "scores": store.score_values(spec.key) if result.status not in NOT_EXECUTED else {},
    }


def _print_counts(runs: Sequence[Run], skipped: Sequence[Run]) -> None:
    complete = sum(run.result.is_complete for run in runs)
    broken = sum(run.result.status in BROKEN for run in runs)
    unavailable = len(runs) - complete - broken - len(skipped)
    names = ", ".join(_unavailable_names(runs))
    counts = f"{complete} runs complete, {broken} failed, {unavailable} not possible here"
    out.print(f"{counts}: {names}" if names else counts, markup=False, highlight=False)
    if skipped:
        missing = ", ".join(f"{run.spec.method.label} on {_sequence_with_seed(run)}" for run in skipped[:MAX_NAMED])
        more = f" and {len(skipped) - MAX_NAMED:,} more" if len(skipped) > MAX_NAMED else ""
        out.print(f"{len(skipped)} not made yet: {missing}{more}", markup=False, highlight=False)


def _sequence_with_seed(run: Run) -> str:
    label, seed = run.spec.sequence.label, run.spec.seed
    return label if seed is None else f"{label} seed {seed}"


def _unavailable_names(runs: Sequence[Run]) -> list[str]:
    """Methods and sequences that are not available, each once; "METHOD on SEQUENCE" where only the pair is not."""
    without_data = [run for run in runs if run.result.status == RunStatus.DATA_MISSING]
    missing = {run.spec.sequence.label for run in without_data if run.result.expected == 0}
    names: dict[str, None] = {}
    for run in runs:
        method, sequence = run.spec.method.label, run.spec.sequence.label
        if run.result.status == RunStatus.NOT_INSTALLED:
            names[method] = None
        elif run.result.status == RunStatus.DATA_MISSING:
            names[sequence if sequence in missing else f"{method} on {sequence}"] = None
    return list(names)
