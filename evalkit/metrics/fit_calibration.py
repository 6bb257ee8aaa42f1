"""How likely a position in a known map is wrong, by the fit of its scan: a probability for each bin, learnt on drives.

``fit_calibration.json`` holds the bins and how they were checked on worlds that they were not learnt on.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.arrays import Ints
from evalkit.core.se2 import Floats

FILE = "fit_calibration.json"
SCHEMA = {"name": "evalkit-fit-calibration", "version": 2}

WRONG_M = 0.1
"""A position with a larger error is wrong."""

LIMITS_M = (0.01, 0.02, 0.03, 0.04, 0.05, 0.07, 0.1, 0.12, 0.15, 0.2, 0.3, 0.5)
"""Limits between the bins of the predicted error; the lower one belongs to a bin."""


@dataclass(frozen=True)
class FitCalibration:
    """The share of wrong positions by the error (m) that the fit of a scan predicts.

    ``probabilities`` (13,): of the bins between ``LIMITS_M``, never falling. ``misfit``: of scans without a prediction.
    ``cells_m``: smallest and largest cells of the maps, ``min_points``: fewest points of a scan that it was learnt on.
    ``worlds``: their names. ``check``: how well it holds on worlds that it was not learnt on.
    """

    probabilities: tuple[float, ...]
    misfit: float
    cells_m: tuple[float, float]
    min_points: int
    worlds: tuple[str, ...]
    check: Mapping[str, Any]

    def predict(self, fit_m: ArrayLike, points: ArrayLike, cell_m: float) -> Floats:
        """Return the probability of a wrong position for each scan (N,); nan outside the range that was learnt.

        ``fit_m``: predicted error, nan for a scan that does not fit. ``points``: number of points of each scan.
        ``cell_m``: side of the map's cells.
        """
        predicted = np.asarray(fit_m, dtype=np.float64)
        probability = np.where(np.isnan(predicted), self.misfit, np.asarray(self.probabilities)[find_bins(predicted)])
        low, high = self.cells_m
        known = (np.asarray(points) >= self.min_points) & (low - 1e-6 <= cell_m <= high + 1e-6)
        return np.where(known, probability, np.nan)


@cache
def load_calibration() -> FitCalibration:
    """Return the calibration of this version."""
    content = json.loads(files("evalkit.metrics").joinpath(FILE).read_text(encoding="utf-8"))
    low, high = content["cells_m"]
    return FitCalibration(
        tuple(one["probability"] for one in content["bins"]), content["misfit"]["probability"], (low, high),
        content["min_points"], tuple(content["worlds"]), content["check"],
    )  # fmt: skip


def find_bins(fit_m: Floats) -> Ints:
    """Return the bin of each predicted error (N,) (m), the last one for nan."""
    return np.asarray(np.searchsorted(LIMITS_M, fit_m, side="right"))


def learn_bins(fit_m: Floats, wrong: ArrayLike) -> tuple[tuple[float, ...], float]:
    """Return the probability of a wrong position of each bin, never falling, and that of scans that do not fit.

    ``fit_m`` (N,): predicted error, nan without one. ``wrong`` (N,): whether the position was wrong. A scan that is
    wrong and one that is not are added to every bin, so that no probability is 0 or 1 (Laplace's rule of succession).
    """
    was_wrong, fits = np.asarray(wrong, dtype=np.float64), np.isfinite(fit_m)
    bins = len(LIMITS_M) + 1
    counts = np.bincount(find_bins(fit_m[fits]), minlength=bins).astype(np.float64) + 2.0
    wrongs = np.bincount(find_bins(fit_m[fits]), was_wrong[fits], minlength=bins) + 1.0
    probabilities = pool_adjacent_violators(wrongs / counts, counts)
    misfit = (was_wrong[~fits].sum() + 1.0) / ((~fits).sum() + 2.0)
    return tuple(probabilities.tolist()), float(misfit)


def pool_adjacent_violators(values: Floats, weights: Floats) -> Floats:
    """Return the values (N,), never falling, that are nearest to ``values`` in weighted least squares.

    Neighbours that fall are replaced by their weighted mean until none does (Ayer, Brunk, Ewing, Reid and Silverman,
    1955).
    """
    pools: list[tuple[float, float, int]] = []
    for value, weight in zip(values.tolist(), weights.tolist(), strict=True):
        pool = (value, weight, 1)
        while pools and pools[-1][0] >= pool[0]:
            before, its_weight, count = pools.pop()
            both = its_weight + pool[1]
            pool = ((before * its_weight + pool[0] * pool[1]) / both, both, count + pool[2])
        pools.append(pool)
    return np.repeat([value for value, _, _ in pools], [count for _, _, count in pools])


def describe_calibration() -> str:
    """Return in three sentences what the calibration was learnt on, how it was checked, and where it holds."""
    known = load_calibration()
    check = known.check
    wrong = 100 * check["wrong_share"]
    low, high = (100.0 * size for size in known.cells_m)
    return (
        f"Learnt on simulated drives in {', '.join(known.worlds)}, with and without faults, in maps with cells of "
        f"{low:g} to {high:g} cm, from scans of at least {known.min_points} points; no probability is given outside "
        f"this range. Each world predicted from the others: {check['scans']:,} scans, {100 * check['predicted']:.1f} % "
        f"predicted and {wrong:.1f} % truly wrong, AUC {check['auc']:.2f}, Brier score "
        f"{check['brier']:.3f}. It holds where about {wrong:.0f} % of the positions are wrong, as in these drives "
        "with faults; of a drive without any it predicts too many."
    )
