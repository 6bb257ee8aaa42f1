"""The cost of a run: time per scan, relation to the sensor's period, and memory."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from evalkit.core.run_result import RunResult, Score
from evalkit.core.se2 import Floats
from evalkit.metrics.table import NO_POSES, Evidence, Metric, make_score, with_support

NOT_MEASURED = {
    "cpu_ns": "no CPU time was measured",
    "wall_ns": "the poses were computed elsewhere",
    "device_ns": "the back end reports no device time",
}
"""Reasons for a missing time, by the field of the run's steps."""


def period_ns(run: RunResult) -> float:
    """Return the sensor's period: the median time between two scans with a pose, divided by the thinning of the
    sequence.
    """
    return float(np.median(np.diff(run.steps["stamp_ns"]))) / run.every


def _score_milliseconds(field: str, statistic: Callable[[Floats], np.floating], evidence: Evidence) -> Score:
    steps = evidence.run.steps
    if len(steps) == 0:
        return Score(None, 0, NO_POSES)
    if field in NOT_MEASURED and not steps[field].any():
        return Score(None, len(steps), NOT_MEASURED[field])
    return make_score(statistic(steps[field] * 1e-6), len(steps))


def _score_conversion(evidence: Evidence) -> Score:
    steps = evidence.run.steps
    total = steps["cpu_ns"].sum()
    if total == 0:
        return Score(None, len(steps), NOT_MEASURED["cpu_ns"])
    return make_score(100.0 * steps["conversion_ns"].sum() / total, len(steps))


def _score_real_time_factor(evidence: Evidence) -> Score:
    run = evidence.run
    if len(run.steps) < 2:
        return Score(None, len(run.steps), _TOO_FEW)
    mean = run.steps["cpu_ns"].mean() or run.steps["device_ns"].mean()
    if mean == 0:
        return Score(None, len(run.steps), NOT_MEASURED["cpu_ns"])
    return make_score(period_ns(run) / mean, len(run.steps))


def _score_late(evidence: Evidence) -> Score:
    run = evidence.run
    if len(run.steps) < 2:
        return Score(None, len(run.steps), _TOO_FEW)
    if not run.steps["wall_ns"].any():
        return Score(None, len(run.steps), NOT_MEASURED["wall_ns"])
    return make_score(100.0 * np.mean(run.steps["wall_ns"] > period_ns(run)), len(run.steps))


def _score_memory(evidence: Evidence) -> Score:
    if evidence.run.peak_memory_bytes == 0:
        return Score(None, 0, _NO_MEMORY)
    return make_score(evidence.run.peak_memory_bytes / 2**20, 1)


def _make_percentile(percent: int) -> Callable[[Floats], np.floating]:
    return partial(np.percentile, q=percent)


_TOO_FEW = "fewer than two scans have a pose"
_NO_MEMORY = "memory was not measured"

_STATISTICS: dict[str, tuple[str, Callable[[Floats], np.floating]]] = {
    "median": ("Median", np.median),
    "p95": ("95th percentile", _make_percentile(95)),
    "p99": ("99th percentile", _make_percentile(99)),
    "max": ("Maximum", np.max),
}
_CLOCKS = {
    "cpu": ("CPU", "of all threads of the run's process", "waiting times and the number of cores used"),
    "wall": ("wall", "on the wall clock", "the load by other programs, which it includes"),
}

_ROWS = (
    *(
        Metric(f"{clock}_{name}_ms", f"{title} time per scan, {name}", "ms", "lower", "runtime",
               f"{words} over all scans of the time {whose} during the call of the back end, including the conversion "
               "of values; warm-up scans are excluded.", "evalkit", f"{limits}; depends on the machine",
               partial(_score_milliseconds, f"{clock}_ns", statistic), 2, headline=(clock, name) == ("cpu", "median"))
        for clock, (title, whose, limits) in _CLOCKS.items()
        for name, (words, statistic) in _STATISTICS.items()
    ),
    Metric("device_median_ms", "device time per scan, median", "ms", "lower", "runtime",
           "Median time per scan reported by the back end, by the clock of the device it runs on; the wall time also "
           "includes the communication.", "evalkit",
           "work that the back end does not count; depends on the device", partial(_score_milliseconds, "device_ns",
           np.median),
           2),
    Metric("conversion_percent", "conversion", "%", "lower", "runtime",
           "Share of the CPU time spent on conversion between evalkit's types and those of the library.", "evalkit",
           "conversion inside the library itself", _score_conversion, 1),
    Metric("real_time_factor", "real-time factor", "x", "higher", "runtime",
           "Period of the sensor (median time between its scans, including those omitted by a thinned sequence) "
           "divided by the mean CPU time per scan (on another machine: the mean device time): above 1, the back end "
           "processes every scan in real time on one such core.", "evalkit",
           "single slow scans; depends on the machine", _score_real_time_factor, 1, headline=True),
    Metric("late_percent", "scans too slow", "%", "lower", "runtime",
           "Share of the scans whose processing took longer on the wall clock than the period of the sensor.",
           "evalkit", "the size of a delay; accumulation of delays", _score_late, 1),
    Metric("peak_memory_mib", "peak memory", "MiB", "lower", "runtime",
           "Largest resident set of the run's process, including interpreter, libraries, the loaded data set and the "
           "instance used for warm-up.", "evalkit",
           "the share of the method itself", _score_memory, 0),
    Metric("harness_median_ms", "harness time per scan", "ms", "lower", "runtime",
           "Median wall time of the harness per scan (reading, checking, storing); not part of any other metric.",
           "evalkit", "the cost of the back end",
           partial(_score_milliseconds, "harness_ns", np.median), 3),
)  # fmt: skip

METRICS = with_support(
    _ROWS,
    {
        "cpu_*": ("scans with a pose", (NO_POSES, NOT_MEASURED["cpu_ns"])),
        "wall_*": ("scans with a pose", (NO_POSES, NOT_MEASURED["wall_ns"])),
        "device_*": ("scans with a pose", (NO_POSES, NOT_MEASURED["device_ns"])),
        "conversion_percent": ("scans with a pose", (NOT_MEASURED["cpu_ns"],)),
        "real_time_factor": ("scans with a pose", (_TOO_FEW, NOT_MEASURED["cpu_ns"])),
        "late_percent": ("scans with a pose", (_TOO_FEW, NOT_MEASURED["wall_ns"])),
        "peak_memory_mib": ("the run", (_NO_MEMORY,)),
        "harness_*": ("scans with a pose", (NO_POSES,)),
    },
)
