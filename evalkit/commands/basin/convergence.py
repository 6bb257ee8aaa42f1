"""Convergence basins: counts of successes against the error of the guess, with confidence intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from evalkit.commands.basin.observability import Observability
from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints
from evalkit.core.se2 import Floats
from evalkit.stats.intervals import Interval, wilson_interval

PLASTIC = 1.2207440846057596
"""The real root above 1 of x^4 = x + 1: its powers fill a cube evenly (Roberts 2018, after the golden ratio)."""

KINDS = 4
"""One of so many trials is only shifted, and one only turned; the others fill the volume."""

QUANTILES = (0.50, 0.75, 0.95)
"""A50, A75 and A95 of Pomerleau et al., "Comparing ICP variants on real-world data sets", Autonomous Robots 2013."""


def draw_offsets(count: int, reach_m: float, reach_rad: float, rng: np.random.Generator) -> Floats:
    """Rows (count, 3) of x, y (m), theta (rad) that fill a disc of ``reach_m`` and turns up to ``reach_rad`` evenly.

    Even in the distance, the bearing and the turn: an additive low-discrepancy sequence from a random start.
    """
    steps = 1.0 / PLASTIC ** np.arange(1, 4)
    share = (rng.random(3) + np.arange(1, count + 1)[:, None] * steps) % 1.0
    distance, bearing, turn = share[:, 0] * reach_m, share[:, 1] * 2.0 * np.pi, (2.0 * share[:, 2] - 1.0) * reach_rad
    return np.stack([distance * np.cos(bearing), distance * np.sin(bearing), turn], axis=1)


def with_axes(offsets: Floats) -> Floats:
    """The same offsets (N, 3) in another order, every fourth without its turn and every fourth without its shift.

    Each kind is a part of the sequence without gaps: every fourth offset would not fill it evenly.
    """
    kinds = np.minimum(np.arange(len(offsets)) % KINDS, 2)
    rows = np.empty_like(offsets)
    rows[np.argsort(kinds, kind="stable")] = offsets
    rows[0::KINDS, 2] = 0.0
    rows[1::KINDS, :2] = 0.0
    return rows


def compute_offsets(rows: Floats, truths: Floats, world_from_target: Floats) -> Floats:
    """Differences (N, 3) of motions to the truth (N, 3), all ``target_from_source``, along the axes of the world."""
    cos, sin = np.cos(world_from_target[:, 2]), np.sin(world_from_target[:, 2])
    x, y = (rows - truths)[:, :2].T
    return np.stack([cos * x - sin * y, sin * x + cos * y, se2.wrap(rows[:, 2] - truths[:, 2])], axis=1)


def make_guesses(offsets: Floats, truths: Floats, world_from_target: Floats) -> Floats:
    """The motions (N, 3) that differ from the truth by offsets (N, 3)."""
    cos, sin = np.cos(world_from_target[:, 2]), np.sin(world_from_target[:, 2])
    x, y = offsets[:, :2].T
    turned = np.stack([cos * x + sin * y, cos * y - sin * x, offsets[:, 2]], axis=1)
    rows = truths + turned
    rows[:, 2] = se2.wrap(rows[:, 2])
    return np.asarray(rows)


@dataclass(frozen=True, eq=False)
class SuccessCounts:
    """Successes and trials of cells (...,), the share of success and its Wilson interval; nan without trials.

    ``edges``: one array of K + 1 borders for each axis of the cells, K cells along it.
    """

    edges: tuple[Floats, ...]
    successes: Ints
    trials: Ints
    share: Floats
    low: Floats
    high: Floats

    @classmethod
    def of(cls, coordinates: Sequence[Floats], success: Bools, edges: Sequence[ArrayLike]) -> SuccessCounts:
        """Counts of trials (N,) at coordinates (N,) each; trials outside the edges do not count."""
        borders = tuple(np.asarray(edge, dtype=np.float64) for edge in edges)
        points = np.stack(coordinates, axis=1)
        trials = np.histogramdd(points, borders)[0].astype(np.int64)
        successes = np.histogramdd(points[success], borders)[0].astype(np.int64)
        return cls.from_counts(borders, successes, trials)

    @classmethod
    def from_counts(cls, edges: tuple[Floats, ...], successes: Ints, trials: Ints) -> SuccessCounts:
        """The shares and intervals of given counts."""
        bounds = np.full((3, *trials.shape), np.nan)
        for at in np.argwhere(trials > 0):
            cell = tuple(at)
            interval = wilson_interval(int(successes[cell]), int(trials[cell]))
            bounds[(slice(None), *cell)] = interval.value, interval.low, interval.high
        return cls(edges, successes, trials, *bounds)

    def reach(self, level: float) -> float:
        """The border up to which every cell of the (only) axis succeeds in at least this share of its trials."""
        reached = np.where(self.trials > 0, self.share >= level, False)
        return float(self.edges[0][int(np.argmin(reached)) if not reached.all() else len(reached)])


@dataclass(frozen=True, eq=False)
class Criterion:
    """Success: an error within these limits along the observable directions."""

    within_m: float
    within_rad: float

    def met(self, errors: Floats) -> Bools:
        """Whether errors (N, 3) of x, y (m), theta (rad) are small enough; nan is not."""
        near = np.hypot(errors[:, 0], errors[:, 1]) <= self.within_m
        return np.asarray(near & (np.abs(errors[:, 2]) <= self.within_rad))


@dataclass(frozen=True, eq=False)
class Basin:
    """Trials (N,) of one back end in one scene: errors of guess and answer, along observable directions only.

    ``errors``: nan where there was no answer. ``claimed`` (N,): it reported convergence. ``only_shifted`` and
    ``only_turned`` (N,): trials for curves over one of both; all others fill the volume, and shares, cells and
    accuracy refer to these.
    """

    offsets: Floats
    errors: Floats
    success: Bools
    claimed: Bools
    only_shifted: Bools
    only_turned: Bools

    @classmethod
    def of(cls, offsets: Floats, errors: Floats, claimed: Bools, known: Observability, criterion: Criterion) -> Basin:
        """The basin of guesses with errors (N, 3) and answers with errors (N, 3)."""
        errors = known.observable(errors)
        shifted, turned = np.asarray(offsets[:, 2] == 0.0), np.asarray(~offsets[:, :2].any(axis=1))
        return cls(known.observable(offsets), errors, criterion.met(errors), claimed, shifted, turned)

    @property
    def filling(self) -> Bools:
        """The trials (N,) that fill the volume."""
        return ~(self.only_shifted | self.only_turned)

    @property
    def distance_m(self) -> Floats:
        """The shift (N,) of the guess (m)."""
        return np.asarray(np.hypot(self.offsets[:, 0], self.offsets[:, 1]))

    @property
    def turn_rad(self) -> Floats:
        """The absolute turn (N,) of the guess (rad)."""
        return np.asarray(np.abs(self.offsets[:, 2]))

    def overall(self) -> Interval:
        """The share of success over the volume."""
        return wilson_interval(int(self.success[self.filling].sum()), int(self.filling.sum()))

    def falsely_claimed(self) -> Interval | None:
        """The share of failures reported as converged; None without failures."""
        failed = int((~self.success).sum())
        return wilson_interval(int((self.claimed & ~self.success).sum()), failed) if failed else None

    def by_distance_and_turn(self, distances: ArrayLike, turns: ArrayLike) -> SuccessCounts:
        """Cells over the distance (m) and the turn (rad)."""
        return self._shares((self.distance_m, self.turn_rad), (distances, turns), self.filling)

    def by_place(self, borders: ArrayLike) -> SuccessCounts:
        """Cells over the offset in x and y (m), whatever the turn."""
        return self._shares((self.offsets[:, 0], self.offsets[:, 1]), (borders, borders), self.filling)

    def along(self, borders: ArrayLike) -> SuccessCounts:
        """Bins over the distance (m) of guesses that were not turned."""
        return self._shares((self.distance_m,), (borders,), self.only_shifted)

    def around(self, borders: ArrayLike) -> SuccessCounts:
        """Bins over the turn (rad) of guesses that were not shifted."""
        return self._shares((self.turn_rad,), (borders,), self.only_turned)

    def _shares(self, values: Sequence[Floats], borders: Sequence[ArrayLike], chosen: Bools) -> SuccessCounts:
        return SuccessCounts.of([one[chosen] for one in values], self.success[chosen], borders)

    def accuracy(self) -> Floats:
        """A50, A75 and A95 (3, 2) of the error in m and rad over the volume; inf where too many had no answer."""
        errors = self.errors[self.filling]
        sizes = np.stack([np.hypot(errors[:, 0], errors[:, 1]), np.abs(errors[:, 2])], axis=1)
        sizes = np.where(np.isfinite(sizes), sizes, np.inf)
        return np.asarray(np.quantile(sizes, QUANTILES, axis=0, method="inverted_cdf"))

    def worst(self, count: int) -> Ints:
        """Up to ``count`` failures (K,) with the best guesses, relative to the worst guess."""
        failed = np.flatnonzero(~self.success)
        far = self.distance_m / max(self.distance_m.max(), 1e-12) + self.turn_rad / max(self.turn_rad.max(), 1e-12)
        return np.asarray(failed[np.argsort(far[failed], kind="stable")][:count])
