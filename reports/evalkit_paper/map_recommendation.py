"""Recommend map settings from the measurements by a fixed rule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.se2 import Floats

MARGIN = 0.01
RULE = (
    "Candidates are all measured maps that differ only in settings of the mapper and whose log-loss is not worse than "
    "that of the paper's settings at the same cell size: a higher F1 must not cost wrong probabilities. Recommended is "
    f"the candidate with the fewest changes from the paper's settings whose mean F1 is within {MARGIN:g} of the best; "
    "among equals the one with the lowest log-loss, at the threshold with the highest F1."
)


@dataclass(frozen=True, slots=True)
class Recommendation:
    """Index of the recommended variant and threshold, and of the pair with the best F1."""

    variant: int
    threshold: int
    best_variant: int
    best_threshold: int


def recommend(f1: Floats, loss: Floats, peers: Ints, departures: Ints, default_threshold: int) -> Recommendation:
    """Apply ``RULE`` to F1 (V, T, U) and log-loss (V, U) of V variants at T thresholds on U drives.

    ``peers`` (V,): index of the variant with the paper's settings at the same cell size; ``departures`` (V,): number of
    settings that differ from the paper's; another threshold counts as one more.
    """
    means, losses = f1.mean(axis=2), loss.mean(axis=1)
    surprise = losses / losses[peers]
    means = np.where((surprise <= 1.0 + 1e-12)[:, None], means, -np.inf)
    best_variant, best_threshold = np.unravel_index(int(np.argmax(means)), means.shape)
    count = departures[:, None] + (np.arange(means.shape[1]) != default_threshold)
    near = means >= means.max() - MARGIN
    least = near & (count == count[near].min())
    variant = int(np.argmin(np.where(least.any(axis=1), surprise, np.inf)))
    threshold = int(np.argmax(np.where(least[variant], means[variant], -np.inf)))
    return Recommendation(variant, threshold, int(best_variant), int(best_threshold))
