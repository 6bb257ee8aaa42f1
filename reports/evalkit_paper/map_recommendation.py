"""Settings of the map that the measurements recommend, by a rule that is stated and applied, not by taste."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.se2 import Floats

MARGIN = 0.01
RULE = (
    "Of all maps measured that differ in settings of the mapper, those count whose log-loss is not worse than that of "
    "the paper's settings at the same cell size: walls must not be bought with wrong probabilities. Of these, the one "
    f"with the fewest departures from the paper's settings whose mean F1 is within {MARGIN:g} of the best is "
    "recommended; of equals the one that lowers the log-loss most, at the threshold with the highest F1."
)


@dataclass(frozen=True, slots=True)
class Choice:
    """A variant and a threshold by number, and the pair with the best F1 that was held against it."""

    variant: int
    threshold: int
    best_variant: int
    best_threshold: int


def recommended(f1: Floats, loss: Floats, peers: Ints, departures: Ints, default_threshold: int) -> Choice:
    """The choice by ``RULE`` from F1 (V, T, U) and log-loss (V, U) of V variants at T thresholds in U maps of each.

    ``peers`` (V,): which variant has the paper's settings at the same cell size; ``departures`` (V,): how many settings
    differ from the paper's; another threshold is one more.
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
    return Choice(variant, threshold, int(best_variant), int(best_threshold))
