"""What every cause does to the residuals of Figure 9: which events spike, how high, for how long, at what cost."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from evalkit.core import se2
from evalkit.core.se2 import Floats
from evalkit.execution.task import Result
from evalkit.report.html.document import Cell, Column, Table
from evalkit_paper import lab_drives, spikes, stage_errors, steady_bands
from evalkit_paper.chapter import Results, Settings
from evalkit_paper.lab_drives import Cause
from evalkit_paper.spikes import Band

MM = 1000.0


class Row:
    """What one cause did at one rate to one stage: events, those that spiked, and how."""

    def __init__(self, cause: Cause, rate: float, result: Result, values: Floats, limits: Band) -> None:
        self.cause, self.rate, self.band = cause, rate, limits
        self.times: Floats = result["times_s"]
        self.spans = [(float(begin), float(end)) for begin, end in result["events"]]
        self.found = spikes.spikes(values, limits)
        per_event = [[spike for spike in self.found if spikes.within(spike, self.times, span)] for span in self.spans]
        self.worst = [max(each, key=lambda spike: spike.height) for each in per_event if each]
        self.yaw = [float(result["yaw_dps"][spike.peak]) for spike in self.worst]
        self.cost_m = [_cost_m(result, span) for span in self.spans]

    @property
    def count(self) -> int:
        """How many events there were."""
        return len(self.spans)

    @property
    def hit(self) -> int:
        """How many of them spiked."""
        return len(self.worst)

    @property
    def elsewhere(self) -> int:
        """How many spikes belong to no event."""
        return sum(not any(spikes.within(spike, self.times, span) for span in self.spans) for spike in self.found)

    def lasted(self) -> str:
        """Median and longest time until back in the band (s), or that it never came back."""
        if not self.worst:
            return ""
        times = [spikes.lasted_s(spike, self.times) for spike in self.worst]
        never = "" if all(spike.over for spike in self.worst) else ", not over"
        return f"{np.median(times):.1f}, {max(times):.1f}{never}"


def _cost_m(result: Result, span: tuple[float, float]) -> float:
    """How much (m) the estimate's motion from before an event until 1 s after it is off the true one."""
    times = result["times_s"]
    first = max(int(np.searchsorted(times, span[0])) - 1, 0)
    last = min(int(np.searchsorted(times, span[1] + spikes.SETTLES_S)), len(times) - 1)
    moved = [se2.between(result[which][first], result[which][last]) for which in ("true", "estimate")]
    return float(np.hypot(*(moved[0] - moved[1])[:2]))


def rows(settings: Settings, results: Results, stage: str) -> Iterator[Row]:
    """Every drive at every rate, for one stage."""
    for rate in steady_bands.rates(settings):
        limits = steady_bands.band(settings, results, rate, stage)
        for cause in lab_drives.causes(settings):
            result = results[lab_drives.name(cause, rate)]
            yield Row(cause, rate, result, result[stage][:, 0], limits)


def definition(settings: Settings, results: Results) -> str:
    """What a spike is, and the bands it is told by."""
    bands = "; ".join(
        f"{rate:g} Hz " + " and ".join(_band_told(settings, results, rate, stage) for stage in stage_errors.STAGES)
        for rate in steady_bands.rates(settings)
    )
    return (
        f"A spike is a run of scans above the steady band (median + {spikes.STEADY_SIGMAS:g} robust sigma) of which at "
        f"least one is above median + {spikes.SPIKE_SIGMAS:g} sigma. Median and sigma (1.4826 x median absolute "
        f"deviation) are those of the straight parts (yaw rate under {steady_bands.CALM_DPS:g} deg/s, from "
        f"{steady_bands.SETTLED_S:g} s on) of the drive with slow turns at the same rate ({bands}). "
        f"A spike is assigned to an event when it peaks from the scan before the event until {spikes.SETTLES_S:g} s "
        f"after; events are known from the truth and the schedule, never from the residual. A turn is quick from "
        f"{lab_drives.QUICK_DPS:g} deg/s on; "
        f"people are an event while they hide {100 * lab_drives.HIDDEN:.0f} % of the beams or more."
    )


def _band_told(settings: Settings, results: Results, rate: float, stage: str) -> str:
    limits = steady_bands.band(settings, results, rate, stage)
    return f"{stage.upper()} {MM * limits.median:.1f} +- {MM * limits.sigma:.1f} mm"


def table(settings: Settings, results: Results) -> Table:
    """A line for every drive at every rate."""
    columns: list[Column | str] = [
        "Drive", Column("Rate", "Hz", number=True), Column("Events", number=True),
        *(column for stage in ("S2S", "S2M") for column in (
            Column(f"{stage} spikes", number=True, tip="events that spiked"),
            Column(f"{stage} height", "mm", number=True, tip="median and highest, over a steady median of"),
            Column(f"{stage} back after", "s", number=True, tip="median and longest"),
        )),
        Column("at yaw rate", "deg/s", number=True, tip="median where S2S peaks, else S2M"),
        Column("pose off by", "mm", number=True, tip="median and largest, from before an event until 1 s after"),
        Column("ATE", "m", number=True),
    ]  # fmt: skip
    pairs = zip(rows(settings, results, "s2s"), rows(settings, results, "s2m"), strict=True)
    lines: list[list[Cell | str]] = []
    for first, second in pairs:
        yaw, result = first.yaw or second.yaw, results[lab_drives.name(first.cause, first.rate)]
        lines.append(
            [
                first.cause.name, Cell(f"{first.rate:g}", first.rate), Cell(str(first.count), first.count),
                *_spiked(first), *_spiked(second),
                Cell(f"{np.median(yaw):.0f}" if yaw else "", float(np.median(yaw)) if yaw else -1.0),
                Cell(_two(first.cost_m, MM, 0), max(first.cost_m, default=0.0)),
                Cell(f"{result['ate_m']:.3f}", result["ate_m"]),
            ]
        )  # fmt: skip
    return Table(columns, lines, "Every drive alone, the same noise in all. 'Slow turns': its only event is the start.")


def _spiked(row: Row) -> list[Cell]:
    heights = [spike.height for spike in row.worst]
    return [
        Cell(f"{row.hit}" + (f" (+{row.elsewhere})" if row.elsewhere else ""), row.hit, "warn" if row.hit else ""),
        Cell(_two(heights, MM, 1), max(heights, default=0.0), tip=f"steady: {MM * row.band.median:.1f} mm"),
        Cell(row.lasted(), max((spikes.lasted_s(spike, row.times) for spike in row.worst), default=0.0)),
    ]


def _two(values: Sequence[float], factor: float, digits: int) -> str:
    if not values:
        return ""
    return f"{factor * float(np.median(values)):.{digits}f}, {factor * max(values):.{digits}f}"


def told(settings: Settings, results: Results) -> str:
    """What follows from the table."""
    found = list(rows(settings, results, "s2s"))
    counts: dict[str, tuple[int, int]] = {}
    for row in found:
        hit, count = counts.get(row.cause.name, (0, 0))
        counts[row.cause.name] = hit + row.hit, count + row.count
    words = "; ".join(f"{name}: {hit} of {count} events" for name, (hit, count) in counts.items() if count)
    return (
        f"S2S spikes over all rates: {words}. A number in brackets counts spikes apart from the events: when a drive "
        "starts, S2M is high until the local map has filled, and the drives with lost scans have their other quick "
        "turns "
        "there. The residual sees the motion within a scan, because a scan bent otherwise than the last fits it "
        "nowhere; it hardly sees slip, because the pairs are found anew from the wrong guess: what slip costs is in "
        "the pose."
    )
