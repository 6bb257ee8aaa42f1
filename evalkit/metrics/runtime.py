"""The cost of a run: time per scan, relation to the sensor's period, and memory."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.run_result import RunResult, Score
from evalkit.core.se2 import Floats
from evalkit.metrics.metric import NO_POSES, Evidence, make_metrics, make_score

COST = "cpu_median_ms"
"""The metric of the cost of a scan."""

NOT_MEASURED = {
    "cpu_ns": "not measured on this machine: no CPU time",
    "wall_ns": "the poses were computed elsewhere",
    "device_ns": "the back end reports no device time",
}
"""Reasons for a missing time, by the field of the run's steps."""


def period_ns(run: RunResult) -> float:
    """Return the sensor's period: the median time between two scans with a pose, divided by the thinning of the
    sequence.
    """
    return float(np.median(np.diff(run.steps["stamp_ns"]))) / run.every


def is_measured(run: RunResult, clock: str) -> bool:
    """Return whether a clock ("cpu_ns", "wall_ns" or "device_ns") was read: CPU time for most scans, others for any.

    Work on a device takes none of this machine's CPU time; only scans that the front end answers itself take some.
    """
    count = int(np.count_nonzero(run.steps[clock]))
    return 2 * count > len(run.steps) if clock == "cpu_ns" else count > 0


def work_ns(run: RunResult) -> Ints:
    """Return the CPU time (N,) of each scan in ns, of a device its own time; zeros where neither was measured."""
    if is_measured(run, "cpu_ns"):
        return run.steps["cpu_ns"]
    return run.steps["device_ns"] if is_measured(run, "device_ns") else np.zeros(len(run.steps), dtype=np.int64)


def late_share(run: RunResult) -> float:
    """Return the share of the scans that took more work than the sensor's period; 0 for fewer than two scans."""
    return float(np.mean(work_ns(run) > period_ns(run))) if len(run.steps) > 1 else 0.0


def _score_milliseconds(field: str, statistic: Callable[[Floats], np.floating], evidence: Evidence) -> Score:
    steps = evidence.run.steps
    if len(steps) == 0:
        return Score(None, reason=NO_POSES)
    if field in NOT_MEASURED and not is_measured(evidence.run, field):
        return Score(None, len(steps), NOT_MEASURED[field])
    return make_score(statistic(steps[field] * 1e-6), len(steps))


def _score_share(field: str, evidence: Evidence) -> Score:
    steps = evidence.run.steps
    total = steps["cpu_ns"].sum()
    if not is_measured(evidence.run, "cpu_ns"):
        return Score(None, len(steps), NOT_MEASURED["cpu_ns"])
    return make_score(100.0 * steps[field].sum() / total, len(steps))


def _score_pace(clock: str, compute: Callable[[Ints, float], float], evidence: Evidence) -> Score:
    """Score the times (N,) of the scans beside the sensor's period, both in ns."""
    run = evidence.run
    if len(run.steps) < 2:
        return Score(None, len(run.steps), _TOO_FEW)
    times = work_ns(run) if clock == "cpu_ns" else run.steps[clock]
    if not times.any():
        return Score(None, len(run.steps), NOT_MEASURED[clock])
    return make_score(compute(times, period_ns(run)), len(run.steps))


def _compute_late_percent(times: Ints, period: float) -> float:
    return 100.0 * float(np.mean(times > period))


def _compute_real_time_factor(times: Ints, period: float) -> float:
    return period / float(times.mean())


def _score_memory(evidence: Evidence) -> Score:
    if evidence.run.peak_memory_bytes == 0:
        return Score(None, reason=_NO_MEMORY)
    return make_score(evidence.run.peak_memory_bytes / 2**20, 1)


def _make_percentile(percent: int) -> Callable[[Floats], np.floating]:
    return partial(np.percentile, q=percent)


_TOO_FEW = "fewer than two scans have a pose"
_NO_MEMORY = "memory was not measured"

_STATISTICS: dict[str, Callable[[Floats], np.floating]] = {
    "median": np.median,
    "p95": _make_percentile(95),
    "p99": _make_percentile(99),
    "max": np.max,
}

METRICS = make_metrics(
    "runtime",
    {
        **{
            f"{clock}_{name}_ms": partial(_score_milliseconds, f"{clock}_ns", statistic)
            for clock in ("cpu", "wall")
            for name, statistic in _STATISTICS.items()
        },
        "device_median_ms": partial(_score_milliseconds, "device_ns", np.median),
        "conversion_percent": partial(_score_share, "conversion_ns"),
        "preparation_percent": partial(_score_share, "preparation_ns"),
        "real_time_factor": partial(_score_pace, "cpu_ns", _compute_real_time_factor),
        "late_percent": partial(_score_pace, "cpu_ns", _compute_late_percent),
        "late_wall_percent": partial(_score_pace, "wall_ns", _compute_late_percent),
        "peak_memory_mib": _score_memory,
        "harness_median_ms": partial(_score_milliseconds, "harness_ns", np.median),
    },
)
