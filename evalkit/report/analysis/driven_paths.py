"""What was really driven over a sequence, measured from its runs: scans, seconds, metres, rate, beams."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

import numpy as np

from evalkit.core.trajectory import Trajectory
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.map_agreement import disagrees
from evalkit.report.analysis.standings import deciding
from evalkit.results.run_record import RunRecord

STEP_M = 0.05
"""A path is summed over poses at least so far apart, so that the noise of one that stands still adds nothing."""


def driven(comparison: Comparison, sequence: str) -> tuple[tuple[str, str], ...]:
    """Name and text of each thing measured, over all seeds; empty where nobody answered a scan."""
    answered = [record for record in comparison.of_sequence(sequence) if len(record.result.steps)]
    if not answered:
        return ()
    longest = list(_longest(answered).values())
    facts = [("Scans answered", _scans(answered))]
    facts.append(("Driven", f"{_span([t.result.estimate.duration_s for t in longest], 1)} s"))
    if path := _path(comparison, sequence, longest):
        facts.append(("Path", path))
    rates = [_rate_hz(record) for record in longest if len(record.result.steps) > 1]
    if rates:
        facts.append(("Scan rate", f"{_span(rates, 1)} Hz (median)"))
    beams = dict.fromkeys(
        str(t.spec.dataset_parameters["beams"]) for t in longest if t.spec.dataset_parameters.get("beams")
    )
    if beams:
        facts.append(("Beams", ", ".join(beams)))
    return tuple(facts)


def path_m(trajectory: Trajectory) -> float:
    """Metres travelled, summed over poses at least 0.05 m apart and the last one."""
    if len(trajectory) == 0:
        return 0.0
    positions = trajectory.poses[:, :2]
    total, last = 0.0, positions[0]
    for position in positions[1:]:
        step = float(np.hypot(*(position - last)))
        if step >= STEP_M:
            total, last = total + step, position
    return total + float(np.hypot(*(positions[-1] - last)))


def alignments(records: Sequence[RunRecord]) -> tuple[str, ...]:
    """How estimates were aligned and matched with the truth: each distinct way once, with its number of runs."""
    counts: dict[str, int] = {}
    for record in records:
        if record.scores.alignment:
            counts[record.scores.alignment] = counts.get(record.scores.alignment, 0) + 1
    return tuple(f"{_aligned(text)} ({count} run{'s' if count > 1 else ''})" for text, count in counts.items())


def _aligned(text: str) -> str:
    alignment, _, rule = text.partition("; ")
    return f"Aligned: {alignment}; matched: {rule}" if rule else f"Not aligned: {alignment}"


def _longest(records: Sequence[RunRecord]) -> dict[int | None, RunRecord]:
    """Per seed the run that answered most scans: the data are the same for all."""
    longest: dict[int | None, RunRecord] = {}
    for record in records:
        if record.seed not in longest or len(record.result.steps) > len(longest[record.seed].result.steps):
            longest[record.seed] = record
    return longest


def _scans(records: Sequence[RunRecord]) -> str:
    counts = sorted({(len(record.result.steps), record.result.expected) for record in records})
    texts = [f"{answered:,} of {expected:,}" for answered, expected in counts]
    return texts[0] if len(texts) == 1 else f"{texts[0]} to {texts[-1]}, by run"


def _path(comparison: Comparison, sequence: str, longest: Sequence[RunRecord]) -> str:
    """The true path while scans came; else that of the best estimate that registers scans, named; "" without any.

    Where nobody knows which estimate is best, it is the median of all.
    """
    true = [found for record in longest if (found := _true_path_m(record)) is not None]
    if true:
        return f"{_span(true, 1)} m (true trajectory)"
    decision = deciding(comparison, sequence)
    known = comparison.methods
    ranked = [cell.method for cell in decision.ranked if known[cell.method].role != "baseline"] if decision else []
    if not ranked:
        return ""
    grouped = comparison.by_method(sequence)
    if disagrees(comparison, decision):
        estimates = [path_m(record.result.estimate) for label in ranked for record in grouped[label]]
        return f"{median(estimates):,.1f} m (median of {len(estimates)} estimates, {_span(estimates, 1)} m)"
    estimates = [path_m(record.result.estimate) for record in grouped[ranked[0]]]
    return f"{_span(estimates, 1)} m (estimate of {ranked[0]})"


def _true_path_m(record: RunRecord) -> float | None:
    trajectory, stamps = record.truth.trajectory, record.result.steps["stamp_ns"]
    if trajectory is None:
        return None
    inside = (trajectory.stamps_ns >= stamps[0]) & (trajectory.stamps_ns <= stamps[-1])
    return path_m(Trajectory(trajectory.stamps_ns[inside], trajectory.poses[inside])) if inside.sum() > 1 else None


def _rate_hz(record: RunRecord) -> float:
    return 1e9 / float(np.median(np.diff(record.result.steps["stamp_ns"])))


def _span(values: Sequence[float], digits: int) -> str:
    low, high = f"{min(values):,.{digits}f}", f"{max(values):,.{digits}f}"
    return low if low == high else f"{low} to {high}"
