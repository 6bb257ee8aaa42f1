"""Determinism of a back end: whether repeated runs, and runs with more threads, give the same answers to the bit."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from evalkit.config.limits import Limits
from evalkit.core.run_result import RunResult
from evalkit.execution import run_process
from evalkit.execution.one_run import Request
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameter_parsing import from_text
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.results.store import hash_answers

Repeatability = Literal["bit-equal", "thread-dependent", "not deterministic", "no answer"]


@dataclass(frozen=True, slots=True)
class Determinism:
    """The comparison of repeated runs.

    ``apart_m``: the largest distance of two positions for one scan over all runs; ``scans``: scans that all runs
    answered. ``digests``: those of the runs by number of threads. ``reason``: why a run did not complete, or "".
    """

    backend: str
    verdict: Repeatability
    apart_m: float | None
    scans: int
    digests: Mapping[int, tuple[str, ...]]
    reason: str = ""


def measure_determinism(
    backend: str,
    given: Mapping[str, str],
    dataset: str,
    parameters: Mapping[str, Value],
    threads: Iterable[int] = (1, 2),
    repetitions: int = 2,
) -> Determinism:
    """Run a back end over a sequence ``repetitions`` times with each number of threads, each in a new process."""
    spec = registry.backend(backend)
    sequence = registry.dataset(dataset)
    settings = from_text(backend, frontend.settable_parameters(spec), given)
    request = Request(
        backend,
        frontend.complete_parameters(backend, spec, settings),
        dataset,
        resolve_parameters(dataset, sequence.parameters, parameters),
    )
    runs: dict[int, list[RunResult]] = {}
    with tempfile.TemporaryDirectory(prefix="evalkit-determinism-") as root:
        for number in threads:
            for repetition in range(repetitions):
                folder = Path(root) / f"{number}-{repetition}"
                folder.mkdir()
                run = run_process.run(request, folder, Limits(), lambda _: None, threading.Event(), number)
                if not run.is_complete:
                    return Determinism(backend, "no answer", None, 0, {}, f"{run.status}: {run.reason}")
                runs.setdefault(number, []).append(run)
    return compare_runs(backend, runs)


def compare_runs(backend: str, runs: Mapping[int, list[RunResult]]) -> Determinism:
    """The comparison of complete runs by number of threads."""
    digests = {number: tuple(_hash_run(run) for run in repeated) for number, repeated in runs.items()}
    verdict: Repeatability = "bit-equal"
    if len({one for own in digests.values() for one in own}) > 1:
        verdict = "thread-dependent"
    if any(len(set(own)) > 1 for own in digests.values()):
        verdict = "not deterministic"
    return Determinism(backend, verdict, *_largest_distance([run for own in runs.values() for run in own]), digests)


def _hash_run(run: RunResult) -> str:
    """The digest of the answers and of the corrected poses of a SLAM."""
    corrected = run.with_final_answers
    return hash_answers(run) + (hash_answers(corrected) if corrected else "")


def _largest_distance(runs: list[RunResult]) -> tuple[float | None, int]:
    """The largest distance (m) of two answers to one scan, None without a common scan, and the common scans."""
    stamps = set.intersection(*(set(run.steps["stamp_ns"].tolist()) for run in runs))
    common = [run.steps[np.isin(run.steps["stamp_ns"], sorted(stamps))] for run in runs]
    positions = np.array([[steps["x"], steps["y"]] for steps in common])
    if not stamps:
        return None, 0
    distances = np.hypot(*(positions[:, None] - positions[None]).transpose(2, 0, 1, 3))
    return float(distances.max()), len(stamps)
