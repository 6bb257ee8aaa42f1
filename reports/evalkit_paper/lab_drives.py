"""Drives of Figure 9: the paper's vehicle in the laboratory, one drive for each possible cause of a spike."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats
from evalkit.execution.task import AnyTask, Result, make_task
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value
from evalkit.plugins.protocols import Sequence
from evalkit_paper import spikes, stage_errors
from evalkit_paper.chapter import Case, Results, Settings
from evalkit_paper.spikes import Band

QUICK_DPS = 60.0
"""Yaw rate (deg/s) from which a turn is quick."""

TURNED = 0.5 * QUICK_DPS
"""Mean yaw rate (deg/s) from which lost scans count as lost in a turn."""

START_S = 5.0
"""Duration (s) of the start of a drive: the local map holds only a few scans."""

CALM_DPS = 10.0
SETTLED_S = 15.0
"""Time (s) from which straight parts are calm: the local map has filled."""

HIDDEN = 0.1
"""Share of beams hidden by people from which a scan is an event."""


def causes(settings: Settings) -> tuple[Case, ...]:
    """All causes of spikes; the first is the drive without disturbances.

    ``mark``: the kind of its events: "turns", "slips", "gaps", "gaps in turns", "people" or "start".
    """
    slow: dict[str, Value] = {"turn_dps": settings["slow_dps"], "laps": settings["laps"]}
    quick: dict[str, Value] = {"turn_dps": settings["turn_dps"], "laps": settings["turn_laps"]}
    every, lasts = settings["every_s"], settings["lasts_s"]
    slips: dict[str, Value] = {"slip_every_s": every, "slip_s": lasts, "slip_mps": settings["slip_mps"]}
    lost: dict[str, Value] = {"drop_every_s": every, "drop_s": lasts}
    lost_in_turn: dict[str, Value] = {"drop_every_s": settings["turn_drop_every_s"], "drop_s": lasts}
    raw: dict[str, Value] = {"deskew": False}
    blind: dict[str, Value] = {"deskew": False, "prior": "constant-velocity"}
    return (
        Case("slow turns", "paper", raw, slow, "start"),
        Case("quick turns", "paper", raw, quick, "turns"),
        Case("quick turns, deskewed", "paper", {"deskew": True}, quick, "turns"),
        Case("wheel slip", "paper", raw, slow | slips, "slips"),
        Case("lost scans", "paper", raw, slow | lost, "gaps"),
        Case("quick turns and lost scans", "paper", raw, quick | lost_in_turn, "gaps in turns"),
        Case("quick turns and lost scans, no odometry", "paper", blind, quick | lost_in_turn, "gaps in turns"),
        Case("people", "paper", raw, slow | {"people": settings["people"]}, "people"),
    )


def make_drive_task(settings: Settings, cause: Case, rate_hz: float) -> AnyTask:
    """Computation of one drive."""
    sequence = {"seed": settings["seed"], "speed_mps": settings["speed_mps"], "rate_hz": rate_hz, **cause.sequence}
    return make_task(
        name(cause, rate_hz), run_drive, sequence=sequence, parameters=dict(cause.parameters), marked=cause.mark,
        every_pair=cause.mark == "start",
    ).depending_on(*USES)  # fmt: skip


def make_turn_task(settings: Settings, turn_dps: float, rate_hz: float) -> AnyTask:
    """Computation of a drive whose turns have one yaw rate."""
    sequence = {
        "seed": settings["seed"], "speed_mps": settings["speed_mps"], "rate_hz": rate_hz, "turn_dps": turn_dps,
        "laps": settings["yaw_laps"],
    }  # fmt: skip
    return make_task(turn_name(turn_dps, rate_hz), measure_turn_peak, sequence=sequence).depending_on(*USES)


def make_speed_task(settings: Settings, speed_mps: float, rate_hz: float) -> AnyTask:
    """Computation of the undisturbed drive at one speed."""
    sequence = {
        "seed": settings["seed"], "speed_mps": speed_mps, "rate_hz": rate_hz, "turn_dps": settings["slow_dps"],
        "laps": settings["speed_laps"],
    }  # fmt: skip
    return make_task(speed_name(speed_mps, rate_hz), measure_steady, sequence=sequence).depending_on(*USES)


def speed_name(speed_mps: float, rate_hz: float) -> str:
    """Name of the result of a drive at one speed."""
    return f"{speed_mps:g} m per s at {rate_hz:g} Hz"


def turn_name(turn_dps: float, rate_hz: float) -> str:
    """Name of the result of a drive at one yaw rate."""
    return f"turns of {turn_dps:g} deg per s at {rate_hz:g} Hz"


def name(cause: Case, rate_hz: float) -> str:
    """Name of the result of a drive."""
    return f"{cause.name} at {rate_hz:g} Hz"


USES = ("evalkit_datasets.worlds.synthetic", "evalkit_baselines.paper")


def run_drive(
    *, sequence: Mapping[str, Any], parameters: Mapping[str, Any], marked: str, every_pair: bool
) -> dict[str, Any]:  # fmt: skip
    """One drive through the laboratory with ``paper``.

    Keys: "times_s" (N,), "yaw_dps" (N,), "s2s" and "s2m" (N, 6) in the order of ``stage_errors.READINGS``,
    "true" and "estimate" (N, 3), "events" (E, 2) in s, "ate_m".
    """
    lab = registry.dataset("lab").make(**sequence)
    found = stage_errors.run_with_errors(lab, "paper", parameters, every_pair)
    truth = stage_errors.true_trajectory(lab)
    times = np.asarray(found.stamps_ns * 1e-9, dtype=np.float64)
    yaw = stage_errors.yaw_rates_dps(truth.stamps_ns, truth.poses)
    errors = stage_errors.position_errors_m(found.estimate, truth)
    return {
        "times_s": times,
        "yaw_dps": yaw,
        **{stage: found.errors[stage] for stage in stage_errors.STAGES},
        "true": truth.poses,
        "estimate": found.poses,
        "events": np.reshape(_events(marked, times, yaw, lab, sequence), (-1, 2)),
        "ate_m": float(np.sqrt(np.mean(errors**2))),
    }


def _events(
    marked: str, times: Floats, yaw: Floats, lab: Sequence, sequence: Mapping[str, Any]
) -> list[tuple[float, float]]:  # fmt: skip
    """Begin and end (s) of the events: from ground truth or schedule, never from the residuals."""
    if marked == "turns":
        return spikes.find_events(times, yaw >= QUICK_DPS)
    if marked == "slips":
        begins = np.arange(0.5 * sequence["slip_every_s"], times[-1], sequence["slip_every_s"])
        return [(float(begin), float(begin) + sequence["slip_s"]) for begin in begins]
    if marked in ("gaps", "gaps in turns"):
        after = np.flatnonzero(np.diff(times) > 1.5 / sequence["rate_hz"]) + 1
        gaps = [(float(times[index - 1]), float(times[index])) for index in after]
        return (
            gaps if marked == "gaps" else [gap for gap, turned in zip(gaps, yaw[after], strict=True) if turned > TURNED]
        )
    if marked == "people":
        return spikes.find_events(times, hidden_share(lab, sequence) >= HIDDEN)
    return [(0.0, START_S)]


def hidden_share(busy: Sequence, sequence: Mapping[str, Any]) -> Floats:
    """Share (N,) of beams of each scan that hit people: those that differ from the empty laboratory."""
    empty = registry.dataset("lab").make(**{**sequence, "people": 0})
    return np.array(
        [
            float(np.mean(~np.isclose(one.scan.ranges, other.scan.ranges, equal_nan=True)))
            for one, other in zip(busy.frames(), empty.frames(), strict=True)
        ]
    )


def measure_steady(*, sequence: Mapping[str, Any]) -> dict[str, Any]:
    """Median (m) of the scan-to-scan residual on straight parts, without the second stage and without deskewing."""
    residual, yaw = _run_first_stage(sequence)
    return {"median": spikes.compute_band(residual, yaw < CALM_DPS).median}


def measure_turn_peak(*, sequence: Mapping[str, Any]) -> dict[str, Any]:
    """Peak of the scan-to-scan residual in turns, and its steady median and sigma (m)."""
    residual, yaw = _run_first_stage(sequence)
    steady = spikes.compute_band(residual, yaw < 0.5 * sequence["turn_dps"])
    turning = np.isfinite(residual) & (yaw > 0.5 * sequence["turn_dps"])
    peak = float(residual[turning].max()) if turning.any() else None
    return {"peak": peak, "median": steady.median, "sigma": steady.sigma}


def _run_first_stage(sequence: Mapping[str, Any]) -> tuple[Floats, Floats]:
    """Scan-to-scan residuals (N,) in m and yaw rates (N,) in deg/s, without the second stage and deskewing."""
    lab = registry.dataset("lab").make(**sequence)
    found = stage_errors.run_with_errors(lab, "paper", {"scan_to_map": False, "deskew": False})
    truth = stage_errors.true_trajectory(lab)
    return found.errors["s2s"][:, 0], stage_errors.yaw_rates_dps(truth.stamps_ns, truth.poses)


def parse_numbers(words: str) -> list[float]:
    """Parse numbers separated by spaces."""
    return [float(word) for word in words.split()]


def rates(settings: Settings) -> list[float]:
    """Lidar rates (Hz)."""
    return parse_numbers(settings["rates_hz"])


def figure_rate(settings: Settings) -> float:
    """Rate (Hz) of the small figures: the middle one."""
    known = rates(settings)
    return known[len(known) // 2]


def find_calm(result: Result) -> Bools:
    """Which scans (N,) of a drive are calm: straight parts after ``SETTLED_S``."""
    return np.asarray((result["yaw_dps"] < CALM_DPS) & (result["times_s"] > SETTLED_S))


def undisturbed_drive(settings: Settings, results: Results, rate: float) -> Result:
    """Result of the drive without disturbances."""
    return results[name(causes(settings)[0], rate)]


def band(settings: Settings, results: Results, rate: float, stage: str) -> Band:
    """Band of a stage's residual (mean distance, m) on the drive without disturbances."""
    drive = undisturbed_drive(settings, results, rate)
    return spikes.compute_band(drive[stage][:, 0], find_calm(drive))


def medians(settings: Settings, results: Results, rate: float, stage: str) -> Floats:
    """Medians (6,) of the calm scans of the drive without disturbances, by reading of the error."""
    drive = undisturbed_drive(settings, results, rate)
    return np.asarray(np.nanmedian(drive[stage][find_calm(drive)], axis=0))
