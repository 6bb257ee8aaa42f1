"""What the residuals are where nothing happens: the bands that spikes of Figure 9 are held against."""

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
"""Straight parts are calm from here on, when the local map has filled."""


def numbers(words: str) -> list[float]:
    """The numbers of a text."""
    return [float(word) for word in words.split()]


def rates(settings: Settings) -> list[float]:
    """Revolutions a second (Hz)."""
    return numbers(settings["rates_hz"])


def shown(settings: Settings) -> float:
    """The rate of the small figures: the middle one."""
    known = rates(settings)
    return known[len(known) // 2]


def spread(values: Sequence[float]) -> str:
    """From the least to the greatest, in words."""
    low, high = f"{min(values):.3f}", f"{max(values):.3f}"
    return low if low == high else f"{low} to {high}"


def calm(result: Result) -> Bools:
    """Which scans (N,) of a drive are on straight parts, the local map filled."""
    return np.asarray((result["yaw_dps"] < CALM_DPS) & (result["times_s"] > SETTLED_S))


def quiet(settings: Settings, results: Results, rate: float) -> Result:
    """The drive in which nothing happens."""
    return results[lab_drives.name(lab_drives.causes(settings)[0], rate)]


def band(settings: Settings, results: Results, rate: float, stage: str) -> Band:
    """Where a stage's residual (mean distance) is in it."""
    drive = quiet(settings, results, rate)
    return spikes.band(drive[stage][:, 0], calm(drive))


def medians(settings: Settings, results: Results, rate: float, stage: str) -> Floats:
    """The medians (6,) of the straight parts of the drive in which nothing happens, by reading."""
    drive = quiet(settings, results, rate)
    return np.asarray(np.nanmedian(drive[stage][calm(drive)], axis=0))
