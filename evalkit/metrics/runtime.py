"""What a run cost: time per scan, against the sensor's pace, and memory."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from evalkit.core.run_result import RunResult, Score
from evalkit.core.se2 import Floats
from evalkit.metrics.table import Evidence, Metric, make_score, with_support

UNTOLD = {
    "cpu_ns": "no CPU time was measured",
    "wall_ns": "the answers were computed elsewhere",
    "device_ns": "the back end tells no device time",
}
"""Why there is no time where a run's records hold none."""


def period_ns(run: RunResult) -> float:
    """The sensor's period: the median time between two answered scans, by how many of the sensor's come to each."""
    return float(np.median(np.diff(run.steps["stamp_ns"]))) / run.every


def _milliseconds(field: str, statistic: Callable[[Floats], np.floating], evidence: Evidence) -> Score:
    steps = evidence.run.steps
    if len(steps) == 0:
        return Score(None, 0, "the run answered no scan")
    if field in UNTOLD and not steps[field].any():
        return Score(None, len(steps), UNTOLD[field])
    return make_score(statistic(steps[field] * 1e-6), len(steps))


def _conversion_percent(evidence: Evidence) -> Score:
    steps = evidence.run.steps
    total = steps["cpu_ns"].sum()
    if total == 0:
        return Score(None, len(steps), UNTOLD["cpu_ns"])
    return make_score(100.0 * steps["conversion_ns"].sum() / total, len(steps))


def _real_time_factor(evidence: Evidence) -> Score:
    run = evidence.run
    if len(run.steps) < 2:
        return Score(None, len(run.steps), "fewer than two scans were answered")
    mean = run.steps["cpu_ns"].mean() or run.steps["device_ns"].mean()
    if mean == 0:
        return Score(None, len(run.steps), UNTOLD["cpu_ns"])
    return make_score(period_ns(run) / mean, len(run.steps))


def _late_percent(evidence: Evidence) -> Score:
    run = evidence.run
    if len(run.steps) < 2:
        return Score(None, len(run.steps), "fewer than two scans were answered")
    if not run.steps["wall_ns"].any():
        return Score(None, len(run.steps), UNTOLD["wall_ns"])
    return make_score(100.0 * np.mean(run.steps["wall_ns"] > period_ns(run)), len(run.steps))


def _memory(evidence: Evidence) -> Score:
    if evidence.run.peak_memory_bytes == 0:
        return Score(None, 0, "memory was not measured")
    return make_score(evidence.run.peak_memory_bytes / 2**20, 1)


def _percentile(percent: int) -> Callable[[Floats], np.floating]:
    return partial(np.percentile, q=percent)


_STATISTICS: dict[str, tuple[str, Callable[[Floats], np.floating]]] = {
    "median": ("Median", np.median),
    "p95": ("95th percentile", _percentile(95)),
    "p99": ("99th percentile", _percentile(99)),
    "max": ("Maximum", np.max),
}
_CLOCKS = {
    "cpu": ("CPU", "of all threads of the run's process", "waiting, and how many cores shared the work"),
    "wall": ("wall", "passing on the wall clock", "what else ran on the machine, which it includes"),
}

_ROWS = (
    *(
        Metric(f"{clock}_{name}_ms", f"{title} time per scan, {name}", "ms", "lower", "runtime",
               f"{words} over all scans of the time {whose} during the back end's call, conversion of values included; "
               "warm-up scans are not among them.", "evalkit", f"{blind}; the machine it was measured on",
               partial(_milliseconds, f"{clock}_ns", statistic), 2, headline=(clock, name) == ("cpu", "median"))
        for clock, (title, whose, blind) in _CLOCKS.items()
        for name, (words, statistic) in _STATISTICS.items()
    ),
    Metric("device_median_ms", "device time per scan, median", "ms", "lower", "runtime",
           "Median of what the back end itself says a scan took, by the clock of the machine it runs on; the wall time "
           "beside it holds the way there and back too.", "evalkit",
           "whatever the back end does not count; the device it ran on", partial(_milliseconds, "device_ns", np.median),
           2),
    Metric("conversion_percent", "conversion", "%", "lower", "runtime",
           "Share of the CPU time that only turns evalkit's values into the library's and back.", "evalkit",
           "conversion inside the library itself", _conversion_percent, 1),
    Metric("real_time_factor", "real-time factor", "x", "higher", "runtime",
           "The sensor's period (median time between its scans, those a thinned sequence leaves out included) divided "
           "by the mean CPU time per scan (for a back end on another machine, the mean device time): above 1 the back "
           "end keeps up on one such core with every scan.", "evalkit",
           "single slow scans; the machine it was measured on", _real_time_factor, 1, headline=True),
    Metric("late_percent", "scans too slow", "%", "lower", "runtime",
           "Scans whose call took longer by the wall clock than the sensor's period.", "evalkit",
           "how late they were; delays that would add up", _late_percent, 1),
    Metric("peak_memory_mib", "peak memory", "MiB", "lower", "runtime",
           "Largest resident set of the run's process: interpreter, libraries, the data set as read and the instance "
           "that was warmed up included.", "evalkit",
           "how much of it the method itself needs", _memory, 0),
    Metric("harness_median_ms", "harness per scan", "ms", "lower", "runtime",
           "Median wall time the harness itself takes around a scan (reading, checking, storing); in no other number.",
           "evalkit", "the back end: it describes the harness",
           partial(_milliseconds, "harness_ns", np.median), 3),
)  # fmt: skip

_NONE = "the run answered no scan"

METRICS = with_support(
    _ROWS,
    {
        "cpu_*": ("scans answered", (_NONE, UNTOLD["cpu_ns"])),
        "wall_*": ("scans answered", (_NONE, UNTOLD["wall_ns"])),
        "device_*": ("scans answered", (_NONE, UNTOLD["device_ns"])),
        "conversion_percent": ("scans answered", (UNTOLD["cpu_ns"],)),
        "real_time_factor": ("scans answered", ("fewer than two scans were answered", UNTOLD["cpu_ns"])),
        "late_percent": ("scans answered", ("fewer than two scans were answered", UNTOLD["wall_ns"])),
        "peak_memory_mib": ("the run", ("memory was not measured",)),
        "harness_*": ("scans answered", (_NONE,)),
    },
)
