"""The drive of a sequence, measured from its runs: scans, seconds, metres, scan rate."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from statistics import median

import numpy as np

from evalkit.core.trajectory import Trajectory
from evalkit.results.run_record import RunRecord

STEP_M = 0.05
"""A path is summed over poses at least this far apart, so that the noise of a robot at rest adds nothing."""

COUNTED = re.compile(r"\b\d[\d,]*(?= (?:poses|(?:equal )?stamps)\b)")
"""Numbers of poses and stamps in the description of an alignment."""


def describe_drive(runs: Mapping[str, Sequence[RunRecord]], paths: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Return name and text of each quantity, over all seeds; nothing if no run answered a scan.

    ``runs``: by method. ``paths``: methods whose estimates give the path's length without a true trajectory.
    """
    answered = [run for own in runs.values() for run in own if len(run.result.steps)]
    if not answered:
        return ()
    longest = list(_longest_by_seed(answered).values())
    facts = [("Scans answered", _format_scans(answered))]
    facts.append(("Driven", f"{_format_range([run.result.estimate.duration_s for run in longest], 1)} s"))
    if path := _format_path(runs, longest, paths):
        facts.append(("Path", path))
    rates = [_rate_hz(run) for run in longest if len(run.result.steps) > 1]
    if rates:
        facts.append(("Scan rate", f"{_format_range(rates, 1)} Hz (median)"))
    return tuple(facts)


def path_m(trajectory: Trajectory) -> float:
    """Return the length of a path (m), summed over poses at least 0.05 m apart and the last one."""
    if len(trajectory) == 0:
        return 0.0
    positions = trajectory.poses[:, :2]
    total, last = 0.0, positions[0]
    for position in positions[1:]:
        step = float(np.hypot(*(position - last)))
        if step >= STEP_M:
            total, last = total + step, position
    return total + float(np.hypot(*(positions[-1] - last)))


def describe_alignments(runs: Sequence[RunRecord]) -> tuple[str, ...]:
    """Return each distinct way in which estimates were aligned and matched, with its number of runs.

    Runs that differ in their numbers of poses and stamps alone are one way: "least squares over 117 to 139 poses".
    """
    ways: dict[tuple[str, ...], list[list[int]]] = {}
    for run in runs:
        if text := run.scores.alignment:
            counts = [int(count.replace(",", "")) for count in COUNTED.findall(text)]
            ways.setdefault(tuple(COUNTED.split(text)), []).append(counts)
    lines = []
    for words, counted in ways.items():
        ranges = [_format_range(values, 0) for values in zip(*counted, strict=True)]
        text = "".join(part for pair in zip_longest(words, ranges, fillvalue="") for part in pair)
        lines.append(f"{_format_alignment(text)} ({len(counted)} run{'s' if len(counted) > 1 else ''})")
    return tuple(lines)


def _format_alignment(text: str) -> str:
    alignment, _, rule = text.partition("; ")
    if rule and alignment.startswith("none, "):
        why, _, poses = alignment.removeprefix("none, ").partition(", over ")
        return f"Not aligned, {why}: {poses} compared; matched: {rule}"
    return f"Aligned: {alignment}; matched: {rule}" if rule else f"Not aligned: {alignment}"


def _longest_by_seed(runs: Sequence[RunRecord]) -> dict[int | None, RunRecord]:
    """Return per seed the run with most answers: the data are the same for all."""
    longest: dict[int | None, RunRecord] = {}
    for run in runs:
        if run.seed not in longest or len(run.result.steps) > len(longest[run.seed].result.steps):
            longest[run.seed] = run
    return longest


def _format_scans(runs: Sequence[RunRecord]) -> str:
    counts = sorted({(len(run.result.steps), run.result.expected) for run in runs})
    texts = [f"{answered:,} of {expected:,}" for answered, expected in counts]
    return texts[0] if len(texts) == 1 else f"{texts[0]} to {texts[-1]}, by run"


def _format_path(runs: Mapping[str, Sequence[RunRecord]], longest: Sequence[RunRecord], paths: Sequence[str]) -> str:
    """Return the true path during the scans, else the path of the named estimates; "" without either."""
    true = [length for run in longest if (length := _true_path_m(run)) is not None]
    if true:
        return f"{_format_range(true, 1)} m (true trajectory)"
    estimates = [path_m(run.result.estimate) for label in paths for run in runs[label]]
    if not estimates:
        return ""
    if len(paths) > 1:
        return f"{median(estimates):,.1f} m (median of {len(estimates)} estimates, {_format_range(estimates, 1)} m)"
    return f"{_format_range(estimates, 1)} m (estimate of {paths[0]})"


def _true_path_m(run: RunRecord) -> float | None:
    trajectory, stamps = run.truth.trajectory, run.result.steps["stamp_ns"]
    if trajectory is None:
        return None
    inside = (trajectory.stamps_ns >= stamps[0]) & (trajectory.stamps_ns <= stamps[-1])
    return path_m(Trajectory(trajectory.stamps_ns[inside], trajectory.poses[inside])) if inside.sum() > 1 else None


def _rate_hz(run: RunRecord) -> float:
    return 1e9 / float(np.median(np.diff(run.result.steps["stamp_ns"])))


def _format_range(values: Sequence[float], digits: int) -> str:
    low, high = f"{min(values):,.{digits}f}", f"{max(values):,.{digits}f}"
    return low if low == high else f"{low} to {high}"
