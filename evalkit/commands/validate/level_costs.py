"""Level 5 of an acceptance report: time per scan beside other methods and the sensor, and memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from evalkit.commands.validate.acceptance import AcceptanceLevel, Check, CheckOutcome
from evalkit.commands.validate.comparison_terms import ComparisonTerms
from evalkit.commands.validate.equivalence.lockstep import DISTURBED_M
from evalkit.commands.validate.scan_pairs import MAX_SCANS_APART, NEAR_M
from evalkit.core.se2 import Floats
from evalkit.execution.sandbox import ENDED
from evalkit.execution.task import Result
from evalkit.external import elf
from evalkit.results.run_record import RunRecord

MS_PER_NS = 1e-6

REGISTRATION = f"one registration from a guess {100.0 * NEAR_M:g} or {100.0 * DISTURBED_M:g} cm off"
"""What is timed on pairs of scans."""

WHY_LONGER = (
    f"the scans are up to {MAX_SCANS_APART} apart, and half of the guesses are the far ones; this takes more "
    "iterations than a registration within a scan, so it may take longer than a whole scan"
)
"""Why a registration of a pair may cost more than a scan, which takes one or two."""


def costs_level(
    scan_times: Mapping[str, Result],
    pair_times: Mapping[str, Result],
    labels: Sequence[str],
    registrations: Sequence[str],
    records: Mapping[str, Mapping[str, RunRecord]],
    terms: ComparisonTerms,
    compiled: Sequence[Path] = (),
) -> AcceptanceLevel:
    """Level 5.

    ``scan_times``, ``pair_times``: times of whole scans and of single registrations, by place. ``labels``,
    ``registrations``: the back ends of their rows. ``compiled``: the files of machine code of the back end.
    """
    checks = []
    own = terms.backend
    for place, result in scan_times.items():
        if ENDED in result:
            observed = f"the measurement did not finish: {result[ENDED]}"
            checks.append(Check("time per scan", place, "informative", "never", observed))
            continue
        checks += [_scan_time(place, result, labels.index(own)), _keeps_up(place, result, labels.index(own))]
        checks += [_time_ratio("a scan", place, result, labels, own, other) for other in labels if other != own]
    for place, result in pair_times.items():
        if ENDED not in result and own in registrations:
            checks += [
                replace(_time_ratio(REGISTRATION, place, result, registrations, own, other), detail=WHY_LONGER)
                for other in registrations
                if other != own
            ]
    checks += _peak_memory(records, terms)
    checks += [check for file in compiled for check in _static_memory(file)]
    question = "What does a scan cost, beside other methods in one process, and is it faster than the sensor?"
    results = {
        "scan_times": dict(scan_times),
        "pair_times": dict(pair_times),
        "labels": list(labels),
        "registrations": list(registrations),
    }
    return AcceptanceLevel(5, "time and memory", question, tuple(checks), results)


def milliseconds(result: Result, row: int) -> tuple[Floats, str]:
    """The times (N,) of one back end and their clock: CPU, else the time its device reports, else the wall clock.

    A clock counts where it has a reading for most scans: a device is not asked about the first one, so that this has a
    CPU time.
    """
    for clock, what in (("cpu_ns", "CPU"), ("device_ns", "device"), ("wall_ns", "wall clock")):
        if 2 * np.count_nonzero(result[clock][row]) > result[clock].shape[1]:
            return result[clock][row] * MS_PER_NS, what
    return result["wall_ns"][row] * MS_PER_NS, "wall clock"


def _scan_time(place: str, result: Result, row: int) -> Check:
    times, clock = milliseconds(result, row)
    wall, device = result["wall_ns"][row] * MS_PER_NS, result["device_ns"][row] * MS_PER_NS
    observed = f"{_format_times(times)} of {clock} time; {_format_times(wall)} by the wall clock"
    if device.any() and clock != "device":
        observed += f"; {_format_times(device)} by its own measurement, the rest is communication"
    share = 100.0 * result["conversion_ns"][row].sum() / max(result["cpu_ns"][row].sum(), 1)
    if clock == "CPU" and share >= 0.5:
        observed += f"; {share:.0f} % of the CPU time converts values to its own types"
    return Check("time per scan", place, "informative", "never", observed)


def _keeps_up(place: str, result: Result, row: int) -> Check:
    device = result["device_ns"][row] * MS_PER_NS
    times, clock = (
        (device, "its own measurement") if device.any() else (result["wall_ns"][row] * MS_PER_NS, "wall clock")
    )
    period = result["period_ns"] * MS_PER_NS
    slow = float(np.mean(times > period))
    p95 = float(np.quantile(times, 0.95))
    outcome: CheckOutcome = "passed" if p95 < period else "failed"
    margin = f"{period:.4g} ms between two scans"
    observed = (
        f"{'keeps' if outcome == 'passed' else 'does not keep'} up: 95 % of the scans within {p95:.3g} ms ({clock}), "
        f"{margin}; {100 * slow:.1f} % took longer"
    )
    return Check("pace of the sensor on this core", place, outcome, "never", observed, margin)


def _time_ratio(what: str, place: str, result: Result, labels: Sequence[str], own: str, other: str) -> Check:
    times, clock = milliseconds(result, labels.index(own))
    others, other_clock = milliseconds(result, labels.index(other))
    name = f"{what}, compared with {other}"
    if clock != other_clock:
        return Check(name, place, "informative", "never", f"{clock} and {other_clock} times cannot be compared")
    low, ratio, high = np.quantile(times / np.maximum(others, 1e-9), [0.25, 0.5, 0.75])
    observed = (
        f"{ratio:.3g} times as long ({clock}; quartiles {low:.3g} to {high:.3g}): "
        f"{np.median(times):.3g} ms, {other} {np.median(others):.3g} ms"
    )
    return Check(name, place, "informative", "never", observed)


def _peak_memory(records: Mapping[str, Mapping[str, RunRecord]], terms: ComparisonTerms) -> list[Check]:
    """Peak resident memory of whole runs, with the interpreter and the data, which every run needs."""
    for place, runs in records.items():
        sizes = {label: record.result.peak_memory_bytes / 2**20 for label, record in runs.items()}
        if sizes.get(terms.backend):
            others = [f"{label} {size:.0f} MiB" for label, size in sizes.items() if label != terms.backend and size]
            observed = f"{sizes[terms.backend]:.0f} MiB with interpreter and data"
            observed += f" ({', '.join(others)})" if others else ""
            return [Check("peak memory of a run", place, "informative", "never", observed)]
    return []


def _static_memory(file: Path) -> list[Check]:
    """The static memory of a compiled file; nothing if this system has another file format."""
    sizes = elf.read_sizes(file)
    if sizes is None:
        return []
    observed = (
        f"{file.name.partition('.')[0]}: text {sizes.text:,}, data {sizes.data:,}, bss {sizes.bss:,} bytes, built for "
        f"{elf.read_machine(file.read_bytes()[:20])}, including its binding to Python, excluding memory that it "
        "allocates or is given"
    )
    return [Check("static memory", "", "informative", "never", observed)]


def _format_times(times: Floats) -> str:
    median, p95 = np.quantile(times, [0.5, 0.95])
    return f"{median:.3g} ms (95 % {p95:.3g}, at most {times.max():.3g})"
