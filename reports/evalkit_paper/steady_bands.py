"""Steady residuals on straight parts of a drive: the bands that define the spikes of Figure 9."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats
from evalkit.execution.task import Result
from evalkit_paper import lab_drives, spikes
from evalkit_paper.chapter import Results, Settings
from evalkit_paper.spikes import Band

CALM_DPS = 10.0
SETTLED_S = 15.0
"""Time (s) from which straight parts are calm: the local map has filled."""


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


def format_range(values: Sequence[float]) -> str:
    """Format the range of values."""
    low, high = f"{min(values):.3f}", f"{max(values):.3f}"
    return low if low == high else f"{low} to {high}"


def find_calm(result: Result) -> Bools:
    """Which scans (N,) of a drive are calm: straight parts after ``SETTLED_S``."""
    return np.asarray((result["yaw_dps"] < CALM_DPS) & (result["times_s"] > SETTLED_S))


def undisturbed_drive(settings: Settings, results: Results, rate: float) -> Result:
    """Result of the drive without disturbances."""
    return results[lab_drives.name(lab_drives.causes(settings)[0], rate)]


def band(settings: Settings, results: Results, rate: float, stage: str) -> Band:
    """Band of a stage's residual (mean distance, m) on the drive without disturbances."""
    drive = undisturbed_drive(settings, results, rate)
    return spikes.compute_band(drive[stage][:, 0], find_calm(drive))


def medians(settings: Settings, results: Results, rate: float, stage: str) -> Floats:
    """Medians (6,) of the calm scans of the drive without disturbances, by reading of the error."""
    drive = undisturbed_drive(settings, results, rate)
    return np.asarray(np.nanmedian(drive[stage][find_calm(drive)], axis=0))
