"""Print the summary of the runs of a command, and set its exit code."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import typer

from evalkit.config.experiment import RunSpec
from evalkit.core.run_result import RunResult
from evalkit.core.run_status import BROKEN, NOT_EXECUTED, RunStatus
from evalkit.results.store import Store
from evalkit.terminal.console import out, print_json

MAX_NAMED = 4
"""Maximum number of missing runs that are listed by name."""

Run = tuple[RunSpec, RunResult]


def print_summary(
    runs: Sequence[Run], title: str, store: Store, page: Path | None, as_json: bool, repetition: str = ""
) -> None:
    """Print how the runs ended, where the page is, and the next commands; ``repetition``: the one that gives a verdict.

    Exits with code 1 if a run that could have completed did not, with code 3 if a run is missing.
    """
    skipped = [(spec, result) for spec, result in runs if result.status in (RunStatus.SKIPPED, RunStatus.INTERRUPTED)]
    if as_json:
        rows = [_run_as_json(spec, result, store) for spec, result in runs]
        print_json({"title": title, "page": str(page) if page else None, "runs": rows})
    else:
        _print_counts(runs, skipped)
        if page is not None:
            out.print(str(page.resolve()), soft_wrap=True)
            folder = shlex.quote(str(store.folder))
            if repetition:
                out.print(f"next: {repetition} --resume --out {folder} (for a verdict)", soft_wrap=True)
            out.print(f"next: {_name_next_step(runs, folder)}", soft_wrap=True)
    if any(result.status in BROKEN for _, result in runs):
        raise typer.Exit(1)
    if skipped:
        raise typer.Exit(3)


def _name_next_step(runs: Sequence[Run], folder: str) -> str:
    """The command that uses the results; where no run is complete, what shows why the first one failed."""
    broken = [(spec, result) for spec, result in runs if result.status in BROKEN]
    if not broken or any(result.is_complete for _, result in runs):
        return f"evalkit export {folder} -f latex (tables for a paper)"
    first, failed = broken[0]
    alike = {spec.method.backend for spec, result in broken if result.reason == failed.reason}
    if failed.status == RunStatus.FAILED and len(alike) > 1:
        path = first.sequence.parameters.get("path")
        words = ["evalkit", "validate", first.sequence.dataset, *(["--set", f"path={path}"] if path else [])]
        return f"{shlex.join(words)} (the data: several methods failed for the same reason)"
    return shlex.join(["evalkit", "validate", first.method.backend, "--only", "rules"]) + " (why no run is complete)"


def _run_as_json(spec: RunSpec, result: RunResult, store: Store) -> dict[str, Any]:
    return {
        "method": spec.method.label,
        "sequence": spec.sequence.label,
        "seed": spec.seed,
        "status": result.status,
        "cause": result.cause,
        "reason": result.reason,
        "key": spec.key,
        "scores": store.load_score_values(spec.key) if result.status not in NOT_EXECUTED else {},
    }


def _print_counts(runs: Sequence[Run], skipped: Sequence[Run]) -> None:
    complete = sum(result.is_complete for _, result in runs)
    broken = sum(result.status in BROKEN for _, result in runs)
    unavailable = len(runs) - complete - broken - len(skipped)
    names = ", ".join(_list_unavailable(runs))
    counts = f"{complete} run{'s' * (complete != 1)} complete, {broken} failed, {unavailable} not available here"
    out.print(f"{counts}: {names}" if names else counts)
    if skipped:
        missing = ", ".join(f"{spec.method.label} on {_format_sequence(spec)}" for spec, _ in skipped[:MAX_NAMED])
        more = f" and {len(skipped) - MAX_NAMED:,} more" if len(skipped) > MAX_NAMED else ""
        out.print(f"{len(skipped)} not run yet: {missing}{more}")
    for reason in dict.fromkeys(result.reason for _, result in skipped if result.status == RunStatus.INTERRUPTED):
        out.print(f"interrupted: {reason}")


def _format_sequence(spec: RunSpec) -> str:
    return f"{spec.sequence.label} {spec.repetition}".rstrip()


def _list_unavailable(runs: Sequence[Run]) -> list[str]:
    """Methods and sequences that are not available, each once; "METHOD on SEQUENCE" where only the pair is not."""
    without_data = [(spec, result) for spec, result in runs if result.status == RunStatus.DATA_MISSING]
    missing = {spec.sequence.label for spec, result in without_data if result.expected == 0}
    names: dict[str, None] = {}
    for spec, result in runs:
        method, sequence = spec.method.label, spec.sequence.label
        if result.status == RunStatus.NOT_INSTALLED:
            names[method] = None
        elif result.status == RunStatus.DATA_MISSING:
            names[sequence if sequence in missing else f"{method} on {sequence}"] = None
    return list(names)
