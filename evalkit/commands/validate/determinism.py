"""Whether a back end gives the same answers, to the last bit, when it is asked again, and with more threads."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from evalkit.config.experiment import Limits
from evalkit.core.run_result import RunResult
from evalkit.execution import run_process
from evalkit.execution.worker import Request
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.results.store import hash_answers

Verdict = Literal["bit-equal", "thread-dependent", "not deterministic", "no answer"]


@dataclass(frozen=True, slots=True)
class Determinism:
    """What repetitions of one run have in common.

    ``apart_m``: how far the farthest two positions for one scan are apart, over all repetitions; ``scans`` is how many
    were compared. ``digests`` are those of the repetitions by their number of threads. ``reason`` is told where a
    repetition did not complete.
    """

    backend: str
    verdict: Verdict
    apart_m: float
    scans: int
    digests: Mapping[int, tuple[str, ...]]
    reason: str = ""


def determinism(
    backend: str,
    dataset: str,
    settings: Mapping[str, Value],
    threads: Iterable[int] = (1, 2),
    repetitions: int = 2,
    limits: Limits | None = None,
) -> Determinism:
    """The back end followed over the sequence so often with each number of threads, each time in a fresh process."""
    spec = registry.backend(backend)
    sequence = registry.dataset(dataset)
    request = Request(
        backend,
        frontend.complete_parameters(backend, spec, {}),
        dataset,
        resolve_parameters(dataset, sequence.parameters, settings),
    )
    made: dict[int, list[RunResult]] = {}
    with tempfile.TemporaryDirectory(prefix="evalkit-determinism-") as place:
        for number in threads:
            for repetition in range(repetitions):
                folder = Path(place) / f"{number}-{repetition}"
                folder.mkdir()
                run = run_process.run(request, folder, limits or Limits(), lambda _: None, threading.Event(), number)
                if not run.is_complete:
                    return Determinism(backend, "no answer", np.nan, 0, {}, f"{run.status}: {run.reason}")
                made.setdefault(number, []).append(run)
    return judged(backend, made)


def judged(backend: str, made: Mapping[int, list[RunResult]]) -> Determinism:
    """The verdict over complete runs by their number of threads."""
    digests = {number: tuple(hash_answers(run) for run in runs) for number, runs in made.items()}
    every = [run for runs in made.values() for run in runs]
    verdict: Verdict = "bit-equal"
    if len({one for own in digests.values() for one in own}) > 1:
        verdict = "thread-dependent"
    if any(len(set(own)) > 1 for own in digests.values()):
        verdict = "not deterministic"
    return Determinism(backend, verdict, *_apart(every), digests)


def _apart(runs: list[RunResult]) -> tuple[float, int]:
    """The largest distance (m) between two answers for one scan, and how many scans all have answered."""
    stamps = set.intersection(*(set(run.steps["stamp_ns"].tolist()) for run in runs))
    chosen = [run.steps[np.isin(run.steps["stamp_ns"], sorted(stamps))] for run in runs]
    positions = np.array([[steps["x"], steps["y"]] for steps in chosen])
    if not stamps:
        return np.nan, 0
    distances = np.hypot(*(positions[:, None] - positions[None]).transpose(2, 0, 1, 3))
    return float(distances.max()), len(stamps)
