"""Chapter on Figure 9: residuals of both stages over time, their steady level, and the causes of spikes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from evalkit.execution.task import AnyTask
from evalkit.plugins.parameters import Parameter
from evalkit.report.html import charts
from evalkit.report.html.blocks import Block, Cell, Column, Figure, Figures, Heading, Section, Table, Text
from evalkit.report.html.charts import Axis, Curve, ShadedSpan
from evalkit.report.html.method_colours import BAR, Stroke
from evalkit_paper import lab_drives, spike_causes, spikes, stage_errors, verdicts
from evalkit_paper.chapter import Case, Chapter, Finding, Results, Settings
from evalkit_paper.spike_causes import MM

PRINTED_M = verdicts.STEADY_M
"""Range of the steady scan-to-scan error in the paper's text on Figure 9 (m)."""

ANCHOR = "figure-9"
SQUARE = stage_errors.READINGS.index("mean square")

PARAMETERS = (
    Parameter("rates_hz", "5 10 15", "Hz", "lidar rate", choices=("5 10 15", "10")),
    Parameter("speed_mps", 0.2, "m/s", "the paper's cruise", low=0.05, high=1.0),
    Parameter("seed", 1, "", "seed of noise and odometry", low=0),
    Parameter("laps", 0.5, "", "laps of drives with slow turns", low=0.1, high=4.0),
    Parameter("turn_laps", 1.0, "", "laps of drives with quick turns; the first turn is after 0.27", low=0.3, high=4.0),
    Parameter("slow_dps", 20.0, "deg/s", "yaw rate of slow turns", low=5.0, high=60.0),
    Parameter("turn_dps", 90.0, "deg/s", "yaw rate of quick turns", low=60.0, high=180.0),
    Parameter("every_s", 10.0, "s", "time between slips, or losses of scans", low=2.0),
    Parameter("lasts_s", 0.5, "s", "duration of a slip or a loss", low=0.1, high=2.0),
    Parameter("slip_mps", 1.0, "m/s", "excess speed of slipping wheels", low=-3.0, high=3.0),
    Parameter("turn_drop_every_s", 12.64, "s", "time between losses on the drive with quick turns; 12.64 s hits the "
    "first turn",
              low=2.0),
    Parameter("people", 3, "", "people walking through the laboratory", low=1, high=20),
    Parameter("yaw_dps", "20 45 60 90 120 180", "deg/s", "yaw rates tried", choices=("20 45 60 90 120 180", "20 90")),
    Parameter("speeds_mps", "0.1 0.15 0.2 0.25 0.29", "m/s", "speeds tried, all below 0.3 m/s",
              choices=("0.1 0.15 0.2 0.25 0.29", "0.1 0.29")),
    Parameter("speed_laps", 0.25, "", "laps of each of these drives", low=0.05, high=4.0),
    Parameter("yaw_laps", 0.3, "", "laps of each of these drives", low=0.28, high=4.0),
)  # fmt: skip


def tasks(settings: Settings) -> tuple[AnyTask, ...]:
    """Tasks: every cause, every yaw rate and every speed, at every lidar rate."""
    rates = lab_drives.parse_numbers(settings["rates_hz"])
    drives = [
        lab_drives.make_drive_task(settings, cause, rate) for rate in rates for cause in lab_drives.causes(settings)
    ]
    turns = [
        lab_drives.make_turn_task(settings, dps, rate)
        for rate in rates
        for dps in lab_drives.parse_numbers(settings["yaw_dps"])
    ]
    speeds = [
        lab_drives.make_speed_task(settings, speed, rate)
        for rate in rates
        for speed in lab_drives.parse_numbers(settings["speeds_mps"])
    ]
    return (*drives, *turns, *speeds)


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """The section of this chapter."""
    blocks: list[Block] = [
        Text(
            f"The simulated vehicle drives through the laboratory at {settings['speed_mps']:g} m/s with the lidar of "
            "section 1 and 'paper' (epsilon 1e-4 m, one-to-one pairs, wheel odometry as first guess). As in the paper, "
            "scans are not deskewed unless the drive is called deskewed. The residual of a scan is the error after its "
            "last iteration."
        ),
        Figures([_time_figure(settings, results, rate) for rate in lab_drives.parse_numbers(settings["rates_hz"])]),
        Heading("Which S2S error is steady at 0.02 to 0.03?"),
        _readings_table(settings, results),
        Text(_describe_readings(settings, results)),
        Heading("Causes of spikes"),
        Text(spike_causes.define_spike(settings, results)),
        spike_causes.table(settings, results),
        Text(spike_causes.summarize(settings, results)),
        Figures([*_cause_figures(settings, results)], small=True),
        Heading("Spike height by yaw rate"),
        *_turn_blocks(settings, results),
    ]
    return (Section("Figure 9: residuals over time", blocks, ANCHOR),)


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """Findings on the statements about S2S and S2M in the text on Figure 9."""
    rates = lab_drives.rates(settings)
    scan, by_map = (
        {f"{rate:g} Hz": lab_drives.medians(settings, results, rate, stage)[0] for rate in rates}
        for stage in stage_errors.STAGES
    )
    square = [lab_drives.medians(settings, results, rate, "s2s")[SQUARE] for rate in rates]
    metres = "" if any(_log_distance(value) == 0.0 for value in square) else "the error is the mean distance (m)"
    speeds = lab_drives.parse_numbers(settings["speeds_mps"])
    by_speed = {
        f"{rate:g} Hz": [results[lab_drives.speed_name(speed, rate)]["median"] for speed in speeds] for rate in rates
    }
    ranges = {name: (min(values), max(values)) for name, values in by_speed.items()}
    text = "; ".join(f"{low:.3f} to {high:.3f} m at {name}" for name, (low, high) in ranges.items())
    turns = [row for row in spike_causes.cause_spikes(settings, results, "s2m") if row.cause.name == "quick turns"]
    spiking = verdicts.judge_spikes(
        sum(row.hit for row in turns), sum(row.count for row in turns), max(row.longest_s for row in turns),
        sum(row.calm for row in turns),
    )  # fmt: skip
    return (
        Finding("Figure 9, S2S", "stable in the range 0.02 to 0.03", _describe_medians(scan),
                verdicts.judge_steady({name: (value, value) for name, value in scan.items()}, metres), ANCHOR),
        Finding("Figure 9, S2S for all v < 0.3 m/s", "stable in the range 0.02 to 0.03",
                f"{text} ({speeds[0]:g} to {speeds[-1]:g} m/s)", verdicts.judge_steady(ranges, metres), ANCHOR),
        Finding("Figure 9, S2M in steady motion", "remains low", _describe_medians(by_map),
                verdicts.judge_low(max(by_map[name] / scan[name] for name in scan)), ANCHOR),
        Finding("Figure 9, S2M in turns", "only short-lived spikes during turning phases",
                f"quick turns of {settings['turn_dps']:g} deg/s over {', '.join(scan)}: {_describe_durations(turns)}",
                spiking, ANCHOR),
    )  # fmt: skip


def _describe_medians(medians: Mapping[str, float]) -> str:
    return ", ".join(f"{value:.3f} m at {name}" for name, value in medians.items()) + " (medians of straight parts)"


def _describe_durations(turns: Sequence[spike_causes.CauseSpikes]) -> str:
    return "; ".join(f"{row.hit} of {row.count} with a spike, back after {row.longest_s:.1f} s" for row in turns)


def _log_distance(value: float) -> float:
    """Distance of a value from the printed range, in factors of e; 0 inside."""
    return float(max(np.log(PRINTED_M[0] / value), np.log(value / PRINTED_M[1]), 0.0))


def _fit_readings(settings: Settings, results: Results) -> dict[str, float]:
    """Mean distance of every reading of S2S from the printed range, in factors of e, over all rates."""
    medians = [lab_drives.medians(settings, results, rate, "s2s") for rate in lab_drives.rates(settings)]
    return {
        reading: float(np.mean([_log_distance(values[index]) for values in medians]))
        for index, reading in enumerate(stage_errors.READINGS)
    }


def _readings_table(settings: Settings, results: Results) -> Table:
    fits, rates = _fit_readings(settings, results), lab_drives.rates(settings)
    columns: list[Column | str] = ["Reading of the error"]
    columns += [
        Column(f"{stage.upper()} at {rate:g} Hz", number=True) for stage in stage_errors.STAGES for rate in rates
    ]
    columns.append(Column("off by", "factors of e", number=True, tip="mean distance of the logarithms; 0 inside"))
    rows: list[list[Cell | str]] = []
    for index, reading in enumerate(stage_errors.READINGS):
        unit = "m^2" if "mean square" in reading and "root" not in reading else "m"
        values = [
            lab_drives.medians(settings, results, rate, stage)[index] for stage in stage_errors.STAGES for rate in rates
        ]
        marked = [value if column < len(rates) else 0.0 for column, value in enumerate(values)]  # S2S alone has a range
        cells = [
            Cell(f"{value:.4f}", value, "good" if own and _log_distance(own) == 0.0 else "")
            for value, own in zip(values, marked, strict=True)
        ]
        rows.append([f"{reading} [{unit}]", *cells, Cell(f"{fits[reading]:.2f}", fits[reading])])
    return Table(
        columns, rows, "Medians of the straight parts of the drive with slow turns. The text says 0.02 to 0.03 "
        "for S2S, without a rate; values inside are marked. It gives no number for S2M. 'Every pair': without the "
        "one-to-one filter.",
    )  # fmt: skip


def _describe_readings(settings: Settings, results: Results) -> str:
    fits = _fit_readings(settings, results)
    order = sorted(fits, key=lambda reading: fits[reading])
    ruled_out = [reading for reading in order if fits[reading] > 1.0]
    return (
        f"Closest to the printed range of S2S over all rates is the {order[0]} (off by a factor of "
        f"{np.exp(fits[order[0]]):.2f} on average), then the {order[1]} ({np.exp(fits[order[1]]):.2f}); the mean "
        f"distance over the one-to-one pairs, which Table 1 fits, is off by {np.exp(fits['mean distance']):.2f}. "
        f"Ruled out, by a factor of {np.exp(min((fits[reading] for reading in ruled_out), default=0.0)):.0f} or more: "
        f"{', '.join(ruled_out) or 'none'}. Figure 9 therefore shows a distance in metres, not equation 5 as printed; "
        "the text does not determine which distance and at which rate."
    )


def _time_figure(settings: Settings, results: Results, rate: float) -> Figure:
    quick = lab_drives.causes(settings)[1]
    return _panel_figure(results, quick, rate,
        f"{rate:g} Hz, quick turns of {settings['turn_dps']:g} deg/s: S2S, S2M and yaw rate over time",
        "Shaded: quick turns. Dashed: the paper's 0.02 to 0.03 m for S2S.",
    )  # fmt: skip


def _panel_figure(results: Results, cause: Case, rate: float, title: str, caption: str) -> Figure:
    result = results[lab_drives.name(cause, rate)]
    times, events = result["times_s"], result["events"]
    label = {"turns": "quick turn", "slips": "slip", "people": "people", "start": "start"}.get(cause.mark, "lost scans")
    spans = [ShadedSpan(float(begin), float(end), label) for begin, end in events]
    ends = np.array([times[0], times[-1]])
    printed = [
        Curve("the paper's range" if index == 0 else "", ends, np.full(2, level), stroke=Stroke(BAR, (4.0, 2.0)))
        for index, level in enumerate(PRINTED_M)
    ]
    top = max(0.06, 1.05 * float(np.nanmax([np.nanmax(result[stage][:, 0]) for stage in stage_errors.STAGES])))
    groups = [
        ([Curve(f"{stage.upper()} residual", times, result[stage][:, 0], stroke=charts.stroke(number)),
          *(printed if stage == "s2s" else [])],
         Axis(f"{stage.upper()} [m]", low=0.0, high=top))
        for number, stage in enumerate(stage_errors.STAGES)
    ]  # fmt: skip
    groups.append(([Curve("yaw rate", times, result["yaw_dps"], stroke=charts.stroke(2))], Axis("[deg/s]", low=0.0)))
    return Figure(charts.panels(groups, Axis("time [s]"), spans, height=1.7), title, caption)


def _cause_figures(settings: Settings, results: Results) -> Iterator[Figure]:
    rate = lab_drives.figure_rate(settings)
    for cause in lab_drives.causes(settings):
        if cause.name != "quick turns":
            yield _panel_figure(results, cause, rate, f"{cause.name}, {rate:g} Hz", "")


def _turn_blocks(settings: Settings, results: Results) -> Iterator[Block]:
    yaw_rates = lab_drives.parse_numbers(settings["yaw_dps"])
    curves: list[Curve] = []
    rows: list[list[Cell | str]] = []
    for rate in lab_drives.rates(settings):
        found = [results[lab_drives.turn_name(dps, rate)] for dps in yaw_rates]
        ratio = [each["peak"] / each["median"] for each in found]
        curves.append(Curve(f"{rate:g} Hz", np.array(yaw_rates), np.array(ratio), marks=True))
        limit = [1.0 + spikes.SPIKE_SIGMAS * each["sigma"] / each["median"] for each in found]
        first = next((dps for dps, high, bar in zip(yaw_rates, ratio, limit, strict=True) if high > bar), None)
        rows.append(
            [
                f"{rate:g} Hz", *(Cell(f"{MM * each['peak']:.1f}", each["peak"]) for each in found),
                Cell("none" if first is None else f"{first:g}", first or 0.0),
            ]
        )  # fmt: skip
    yield Figure(
        charts.lines(curves, Axis("yaw rate of the turns [deg/s]"), Axis("highest S2S in turns / steady S2S", low=0.0)),
        "Highest S2S residual in turns relative to the steady one, by yaw rate",
        "Scan-to-scan only, with odometry, not deskewed. The distortion of a scan is the yaw rate divided by the scan "
        "rate.",
    )
    yield Table(
        ["Rate", *(Column(f"{dps:g} deg/s", "mm", number=True) for dps in yaw_rates),
         Column("spikes from", "deg/s", number=True)],
        rows, "Highest S2S residual in turns, and the lowest yaw rate at which it is a spike.",
    )  # fmt: skip


CHAPTER = Chapter("residuals", PARAMETERS, tasks, sections, findings)
