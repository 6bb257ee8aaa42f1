"""Effects of factors and of their interactions, fitted by least squares, with intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats
from evalkit.design.designs import DesignAxis, Model
from evalkit.stats.intervals import CONFIDENCE, Interval, student_quantile


@dataclass(frozen=True)
class Effect:
    """The difference of the response between two levels of a factor, averaged over all others.

    ``value``: the interval is adjusted for all pairs of levels of all factors (Bonferroni), because it is the largest
    difference that is looked at.
    """

    factor: str
    level: int
    against: int
    value: Interval


@dataclass(frozen=True)
class FactorEffect:
    """A factor's effects: every level's distance from the mean over its levels, and the worst level against the best.

    ``levels``: intervals (L,) of the levels' distances. ``share`` of the response's variance that is lost without the
    factor's own columns (type III).
    """

    factor: str
    levels: tuple[Interval, ...]
    largest: Effect
    share: float


@dataclass(frozen=True)
class Interaction:
    """How the effect of one factor depends on another: the difference of its effects at two levels of the other.

    ``value``: (effect of ``a_levels`` at ``b_levels[1]``) - (the same at ``b_levels[0]``), for the pair of corners with
    the largest difference; the interval is adjusted for all corners of all pairs (Bonferroni).
    """

    a: str
    b: str
    a_levels: tuple[int, int]
    b_levels: tuple[int, int]
    value: Interval
    share: float

    @property
    def significant(self) -> bool:
        """Whether the interval excludes zero."""
        return self.value.excludes(0.0)


@dataclass(frozen=True, eq=False)
class ModelFit:
    """A model fitted to the response (N,) at positions (N, K) by least squares.

    Intervals are Student's t with a covariance that allows unequal variances (HC3, MacKinnon and White, J. Econometrics
    29, 1985). Raises ValueError if there are not more points than columns, or the columns are not independent.
    """

    model: Model
    positions: Floats
    response: Floats

    def __post_init__(self) -> None:
        points, columns = self._columns.shape
        if points <= columns:
            raise ValueError(f"{points} points are too few for the {columns} columns of the model")
        if np.linalg.matrix_rank(self._columns) < columns:
            raise ValueError("the model's columns are not independent in these points")

    @cached_property
    def mean(self) -> Interval:
        """The response averaged over all levels."""
        return self._interval(np.eye(self._columns.shape[1])[0])

    @cached_property
    def residual(self) -> float:
        """The standard deviation of the residuals, in the response's unit."""
        return float(np.sqrt(np.sum(self._residuals**2) / self._free))

    @cached_property
    def explained(self) -> float:
        """The share of the response's variance that the model explains."""
        total = self._total
        return 1.0 - float(np.sum(self._residuals**2)) / total if total > 0.0 else 1.0

    def predict(self, positions: Floats) -> Floats:
        """The predicted response (M,) at positions (M, K)."""
        return np.asarray(self.model.matrix(positions) @ self._coefficients)

    @property
    def effects(self) -> list[FactorEffect]:
        """The effects of all factors, in the order of the model's axes."""
        return [self.factor(number) for number in range(len(self.model.axes))]

    def factor(self, number: int) -> FactorEffect:
        """The effects of one factor."""
        axis = self.model.axes[number]
        rows = self._own(number)
        levels = tuple(self._interval(row) for row in rows)
        middles = [level.value for level in levels]
        best, worst = int(np.argmin(middles)), int(np.argmax(middles))
        strict = _adjust_confidence(self.differences)
        largest = Effect(axis.name, worst, best, self._interval(rows[worst] - rows[best], strict))
        return FactorEffect(axis.name, levels, largest, self._share((number,)))

    @property
    def differences(self) -> int:
        """The number of pairs of levels of one factor, over all factors."""
        return sum(math.comb(axis.levels, 2) for axis in self.model.axes)

    @property
    def corners(self) -> int:
        """The number of differences of differences of which interactions are the largest, over all pairs of factors."""
        steps = [len(_list_steps(axis)) for axis in self.model.axes]
        return sum(one * other for one, other in combinations(steps, 2)) if self.model.pairs else 0

    def expected(self, levels: Mapping[int, int]) -> Interval:
        """The response at levels of some factors, given by number, averaged over the levels of all others."""
        row = np.zeros(self._columns.shape[1])
        row[0] = 1.0
        for number, level in levels.items():
            row[self._mask((number,))] = self.model.axes[number].main[level]
        for a, b in combinations(sorted(levels), 2) if self.model.pairs else ():
            one, other = self.model.axes[a].crossed[levels[a]], self.model.axes[b].crossed[levels[b]]
            row[self._mask((a, b))] = np.outer(one, other).ravel()
        return self._interval(row)

    def interactions(self) -> tuple[Interaction, ...]:
        """All interactions, the largest share of the variance first; none in a model without pairs."""
        pairs = list(combinations(range(len(self.model.axes)), 2)) if self.model.pairs else []
        unordered = [self._interaction(a, b) for a, b in pairs]
        return tuple(sorted(unordered, key=lambda item: -item.share))

    @cached_property
    def _columns(self) -> Floats:
        return self.model.matrix(self.positions)

    @cached_property
    def _inverse(self) -> Floats:
        return np.asarray(np.linalg.inv(self._columns.T @ self._columns), dtype=np.float64)

    @cached_property
    def _coefficients(self) -> Floats:
        solution = np.linalg.lstsq(self._columns, np.asarray(self.response, dtype=np.float64), rcond=None)[0]
        return np.asarray(solution, dtype=np.float64)

    @cached_property
    def _residuals(self) -> Floats:
        return np.asarray(self.response - self._columns @ self._coefficients)

    @cached_property
    def _total(self) -> float:
        return float(np.sum((self.response - np.mean(self.response)) ** 2))

    @property
    def _free(self) -> int:
        points, columns = self._columns.shape
        return int(points - columns)

    @cached_property
    def _covariance(self) -> Floats:
        leverage = np.einsum("ij,jk,ik->i", self._columns, self._inverse, self._columns)
        weighted = self._columns * (self._residuals / np.maximum(1.0 - leverage, 1e-9))[:, None]
        return np.asarray(self._inverse @ (weighted.T @ weighted) @ self._inverse)

    def _interval(self, contrast: Floats, confidence: float = CONFIDENCE) -> Interval:
        value = float(contrast @ self._coefficients)
        spread = float(np.sqrt(max(float(contrast @ self._covariance @ contrast), 0.0)))
        half = spread * student_quantile(self._free, confidence)
        return Interval(value, value - half, value + half, len(self.response), confidence)

    def _mask(self, term: tuple[int, ...]) -> Bools:
        return np.array([found == term for found in self.model.terms])

    def _own(self, number: int) -> Floats:
        """The contrasts (L, P) of a factor's levels against their mean."""
        axis = self.model.axes[number]
        rows = np.zeros((axis.levels, self._columns.shape[1]))
        rows[:, self._mask((number,))] = axis.main
        return rows

    def _share(self, term: tuple[int, ...]) -> float:
        mask = self._mask(term)
        own = self._coefficients[mask]
        lost = float(own @ np.linalg.solve(self._inverse[np.ix_(mask, mask)], own))
        return lost / self._total if self._total > 0.0 else 0.0

    def _interaction(self, a: int, b: int) -> Interaction:
        """The corner with the largest difference of differences, first level against another for both factors."""
        one, other = self.model.axes[a], self.model.axes[b]
        mask = self._mask((a, b))
        corners: list[tuple[float, Floats, tuple[int, int], tuple[int, int]]] = []
        for from_a, to_a in _list_steps(one):
            for from_b, to_b in _list_steps(other):
                row = np.zeros(len(mask))
                step_a, step_b = one.crossed[to_a] - one.crossed[from_a], other.crossed[to_b] - other.crossed[from_b]
                row[mask] = np.outer(step_a, step_b).ravel()
                corners.append((abs(float(row @ self._coefficients)), row, (from_a, to_a), (from_b, to_b)))
        _, row, a_levels, b_levels = max(corners, key=lambda corner: corner[0])
        value = self._interval(row, _adjust_confidence(self.corners))
        return Interaction(one.name, other.name, a_levels, b_levels, value, self._share((a, b)))


def _adjust_confidence(comparisons: int) -> float:
    """Return the confidence of each of so many intervals that all together hold with 95 % (Bonferroni)."""
    return 1.0 - (1.0 - CONFIDENCE) / comparisons


def _list_steps(axis: DesignAxis) -> list[tuple[int, int]]:
    """Return the steps between levels that interactions compare: one along an ordered axis, else every pair."""
    return [(0, axis.levels - 1)] if axis.scores is not None else list(combinations(range(axis.levels), 2))
