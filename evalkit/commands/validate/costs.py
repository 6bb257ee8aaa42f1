"""Level 5 of a dossier: time a scan, beside the others and beside the sensor, and memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from evalkit.commands.validate.acceptance import Level, Line, Outcome
from evalkit.commands.validate.answers import Names
from evalkit.core.se2 import Floats
from evalkit.execution.sandbox import ENDED
from evalkit.execution.task import Result
from evalkit.external import elf
from evalkit.results.run_record import RunRecord

MS = 1e-6


def costs(
    paced: Mapping[str, Result], alone: Mapping[str, Result], labels: Sequence[str], registrations: Sequence[str],
    records: Mapping[str, Mapping[str, RunRecord]], names: Names, compiled: Sequence[Path] = (),
) -> Level:  # fmt: skip
    """Level 5; ``paced`` and ``alone``: whole scans, and single registrations, by place; ``labels``: their rows.

    ``compiled``: the files of machine code it consists of.
    """
    lines = []
    for place, result in paced.items():
        if ENDED in result:
            lines.append(Line("time a scan", place, "told", "", f"the measurement did not finish: {result[ENDED]}"))
            continue
        lines += [_scan(place, result, labels.index(names.mine)), *_keeps_up(place, result, labels.index(names.mine))]
        lines += [_ratio("a scan", place, result, labels, names.mine, other) for other in labels if other != names.mine]
    for place, result in alone.items():
        if ENDED not in result and names.mine in registrations:
            lines += [
                _ratio("one registration", place, result, registrations, names.mine, other)
                for other in registrations
                if other != names.mine
            ]
    lines += _memory(records, names)
    lines += [line for file in compiled for line in _static(file)]
    question = "What does a scan cost, beside the others in one process, and does it keep up with the sensor?"
    shown = {"paced": dict(paced), "alone": dict(alone), "labels": list(labels), "registrations": list(registrations)}
    return Level(5, "time and memory", question, tuple(lines), shown)


def milliseconds(result: Result, row: int) -> tuple[Floats, str]:
    """The times (N,) of one back end and by which clock: CPU, or what its device tells, or the wall's."""
    for clock, what in (("cpu_ns", "CPU"), ("device_ns", "device"), ("wall_ns", "wall clock")):
        if result[clock][row].any():
            return result[clock][row] * MS, what
    return result["wall_ns"][row] * MS, "wall clock"


def _scan(place: str, result: Result, row: int) -> Line:
    taken, clock = milliseconds(result, row)
    wall, device = result["wall_ns"][row] * MS, result["device_ns"][row] * MS
    told = f"{_spread(taken)} of {clock} time; {_spread(wall)} by the wall clock"
    if device.any() and clock != "device":
        told += f"; {_spread(device)} by its own telling, the rest is the way there and back"
    share = 100.0 * result["conversion_ns"][row].sum() / max(result["cpu_ns"][row].sum(), 1)
    told += f"; {share:.0f} % of the CPU time turns values into its own" if share >= 0.5 else ""
    return Line("time a scan", place, "told", "", told)


def _keeps_up(place: str, result: Result, row: int) -> list[Line]:
    device = result["device_ns"][row] * MS
    taken, what = (device, "its own time") if device.any() else (result["wall_ns"][row] * MS, "wall clock")
    period = result["period_ns"] * MS
    slow = float(np.mean(taken > period))
    quick = float(np.quantile(taken, 0.95))
    told = f"95 % of the scans within {quick:.3g} ms ({what}); {100 * slow:.1f} % took longer than the sensor"
    reason = f"{period:.4g} ms between two scans"
    outcome: Outcome = "passed" if quick < period else "failed"
    return [Line("keeps up with the sensor on this core", place, outcome, "", told, reason)]


def _ratio(what: str, place: str, result: Result, labels: Sequence[str], mine: str, other: str) -> Line:
    ours, clock = milliseconds(result, labels.index(mine))
    theirs, another = milliseconds(result, labels.index(other))
    name = f"{what}: beside {other}"
    if clock != another:
        return Line(name, place, "told", "", f"{clock} against {another}: not to be compared")
    low, ratio, high = np.quantile(ours / np.maximum(theirs, 1e-9), [0.25, 0.5, 0.75])
    told = (
        f"{ratio:.3g} times as long ({clock}; quartiles {low:.3g} to {high:.3g}): "
        f"{np.median(ours):.3g} ms against {np.median(theirs):.3g} ms"
    )
    return Line(name, place, "told", "", told)


def _memory(records: Mapping[str, Mapping[str, RunRecord]], names: Names) -> list[Line]:
    """Peak resident memory of whole runs; what interpreter and data need is in every one of them."""
    lines = []
    for place, runs in records.items():
        sizes = {label: record.result.peak_memory_bytes / 2**20 for label, record in runs.items()}
        if sizes.get(names.mine):
            rest = ", ".join(f"{label} {size:.0f}" for label, size in sizes.items() if label != names.mine and size)
            told = f"{sizes[names.mine]:.0f} MiB with interpreter and data ({rest} MiB)"
            lines.append(Line("peak memory of a run", place, "told", "", told))
    return lines[:1]


def _static(file: Path) -> list[Line]:
    """What a compiled file takes before it runs; nothing where this system has another format."""
    found = elf.sizes(file)
    if found is None:
        return []
    told = (
        f"{file.name.partition('.')[0]}: text {found.text:,}, data {found.data:,}, bss {found.bss:,} bytes, built for "
        f"{elf.machine(file.read_bytes()[:20])}, with whatever binds it to this program; memory that it is handed "
        "or asks for comes on top"
    )
    return [Line("static memory", "", "told", "", told)]


def _spread(taken: Floats) -> str:
    median, p95 = np.quantile(taken, [0.5, 0.95])
    return f"{median:.3g} ms (95 % {p95:.3g}, at most {taken.max():.3g})"
