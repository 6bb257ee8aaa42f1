"""Effect of every cause on the residuals of Figure 9: which events spike, how high, how long, and the pose error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from evalkit.core import se2
from evalkit.core.se2 import Floats
from evalkit.execution.task import Result
from evalkit.report.html.blocks import Cell, Column, Table
from evalkit_paper import lab_drives, spikes, stage_errors
from evalkit_paper.chapter import Case, Results, Settings
from evalkit_paper.spikes import Band

MM = 1000.0


class CauseSpikes:
    """Spikes of one cause at one rate in one stage."""

    def __init__(self, cause: Case, rate: float, result: Result, values: Floats, limits: Band) -> None:
        self.cause, self.rate, self.band = cause, rate, limits
        self.times: Floats = result["times_s"]
        self.spans = [(float(begin), float(end)) for begin, end in result["events"]]
        self.found = spikes.find_spikes(values, limits)
        per_event = [
            [spike for spike in self.found if spikes.belongs_to(spike, self.times, span)] for span in self.spans
        ]
        self.worst = [max(each, key=lambda spike: spike.height) for each in per_event if each]
        self.yaw = [float(result["yaw_dps"][spike.peak]) for spike in self.worst]
        self.cost_m = [_cost_m(result, span) for span in self.spans]
        self.calm = sum(bool(lab_drives.find_calm(result)[spike.peak]) for spike in self.found)

    @property
    def count(self) -> int:
        """Number of events."""
        return len(self.spans)

    @property
    def hit(self) -> int:
        """Number of events with a spike."""
        return len(self.worst)

    @property
    def longest_s(self) -> float:
        """Longest time (s) until the residual is back in the band, 0 without a spike."""
        return max((spikes.duration_s(spike, self.times) for spike in self.worst), default=0.0)

    @property
    def elsewhere(self) -> int:
        """Number of spikes outside all events."""
        return sum(not any(spikes.belongs_to(spike, self.times, span) for span in self.spans) for spike in self.found)

    def describe_duration(self) -> str:
        """Median and longest time (s) until the residual is back in the band, as text."""
        if not self.worst:
            return ""
        times = [spikes.duration_s(spike, self.times) for spike in self.worst]
        never = "" if all(spike.ended for spike in self.worst) else ", not ended"
        return f"{np.median(times):.1f}, {max(times):.1f}{never}"


def _cost_m(result: Result, span: tuple[float, float]) -> float:
    """Error (m) of the estimated motion from before an event until 1 s after it."""
    times = result["times_s"]
    first = max(int(np.searchsorted(times, span[0])) - 1, 0)
    last = min(int(np.searchsorted(times, span[1] + spikes.MAX_DELAY_S)), len(times) - 1)
    moved = [se2.between(result[which][first], result[which][last]) for which in ("true", "estimate")]
    return float(np.hypot(*(moved[0] - moved[1])[:2]))


def cause_spikes(settings: Settings, results: Results, stage: str) -> Iterator[CauseSpikes]:
    """Spikes of every drive at every rate, for one stage."""
    for rate in lab_drives.rates(settings):
        limits = lab_drives.band(settings, results, rate, stage)
        for cause in lab_drives.causes(settings):
            result = results[lab_drives.name(cause, rate)]
            yield CauseSpikes(cause, rate, result, result[stage][:, 0], limits)


def define_spike(settings: Settings, results: Results) -> str:
    """Define a spike, with the bands of every rate, as text."""
    bands = "; ".join(
        f"{rate:g} Hz " + " and ".join(_describe_band(settings, results, rate, stage) for stage in stage_errors.STAGES)
        for rate in lab_drives.rates(settings)
    )
    return (
        f"A spike is a run of scans above the steady band (median + {spikes.STEADY_SIGMAS:g} robust sigma) of which at "
        f"least one is above median + {spikes.SPIKE_SIGMAS:g} sigma. Median and sigma (1.4826 x median absolute "
        f"deviation) are those of the straight parts (yaw rate under {lab_drives.CALM_DPS:g} deg/s, from "
        f"{lab_drives.SETTLED_S:g} s on) of the drive with slow turns at the same rate ({bands}). "
        f"A spike is assigned to an event when it peaks from the scan before the event until {spikes.MAX_DELAY_S:g} s "
        f"after; events are known from the truth and the schedule, never from the residual. A turn is quick from "
        f"{lab_drives.QUICK_DPS:g} deg/s on; "
        f"people are an event while they hide {100 * lab_drives.HIDDEN:.0f} % of the beams or more."
    )


def _describe_band(settings: Settings, results: Results, rate: float, stage: str) -> str:
    limits = lab_drives.band(settings, results, rate, stage)
    return f"{stage.upper()} {MM * limits.median:.1f} +- {MM * limits.sigma:.1f} mm"


def table(settings: Settings, results: Results) -> Table:
    """Table of all drives and rates."""
    columns: list[Column | str] = [
        "Drive", Column("Rate", "Hz", number=True), Column("Events", number=True),
        *(column for stage in ("S2S", "S2M") for column in (
            Column(f"{stage} spikes", number=True, tip="events with a spike"),
            Column(f"{stage} height", "mm", number=True, tip="median and highest"),
            Column(f"{stage} back after", "s", number=True, tip="median and longest"),
        )),
        Column("yaw rate", "deg/s", number=True, tip="median at the peak of S2S, else S2M"),
        Column("pose error", "mm", number=True, tip="median and largest, from before an event until 1 s after"),
        Column("ATE", "m", number=True),
    ]  # fmt: skip
    pairs = zip(cause_spikes(settings, results, "s2s"), cause_spikes(settings, results, "s2m"), strict=True)
    lines: list[list[Cell | str]] = []
    for first, second in pairs:
        yaw, result = first.yaw or second.yaw, results[lab_drives.name(first.cause, first.rate)]
        lines.append(
            [
                first.cause.name, Cell(f"{first.rate:g}", first.rate), Cell(str(first.count), first.count),
                *_spike_cells(first), *_spike_cells(second),
                Cell(f"{np.median(yaw):.0f}" if yaw else "", float(np.median(yaw)) if yaw else -1.0),
                Cell(_format_median_and_max(first.cost_m, MM, 0), max(first.cost_m, default=0.0)),
                Cell(f"{result['ate_m']:.3f}", result["ate_m"]),
            ]
        )  # fmt: skip
    return Table(columns, lines, "One drive per row, with the same noise. The only event of 'slow turns' is the start.")


def _spike_cells(row: CauseSpikes) -> list[Cell]:
    heights = [spike.height for spike in row.worst]
    return [
        Cell(f"{row.hit}" + (f" (+{row.elsewhere})" if row.elsewhere else ""), row.hit, "warn" if row.hit else ""),
        Cell(
            _format_median_and_max(heights, MM, 1),
            max(heights, default=0.0),
            tip=f"steady: {MM * row.band.median:.1f} mm",
        ),
        Cell(row.describe_duration(), row.longest_s),
    ]


def _format_median_and_max(values: Sequence[float], factor: float, digits: int) -> str:
    if not values:
        return ""
    return f"{factor * float(np.median(values)):.{digits}f}, {factor * max(values):.{digits}f}"


def summarize(settings: Settings, results: Results) -> str:
    """Summarise the table as text."""
    found = list(cause_spikes(settings, results, "s2s"))
    counts: dict[str, tuple[int, int]] = {}
    for row in found:
        hit, count = counts.get(row.cause.name, (0, 0))
        counts[row.cause.name] = hit + row.hit, count + row.count
    words = "; ".join(f"{name}: {hit} of {count} events" for name, (hit, count) in counts.items() if count)
    return (
        f"S2S spikes over all rates: {words}. Numbers in brackets count spikes outside the events: at the start S2M is "
        "high until the local map has filled, and the drives with lost scans have further quick turns. The residual "
        "shows "
        "motion within a scan, because two differently distorted scans do not fit each other. It hardly shows wheel "
        "slip, because the pairs are searched again from the wrong guess: slip appears in the pose error."
    )
