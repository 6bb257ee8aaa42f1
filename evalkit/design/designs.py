"""Designs of experiments: few informative points of a factor space instead of the full grid.

A design is an array (N, K) of positions: 0 is a factor's first level, 1 its second, 0.5 half-way between the two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import combinations, count, product
from operator import xor

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.se2 import Floats

MAX_PASSES = 12
RIDGE = 1e-6
"""Added to X'X so that its determinant is positive before a design supports its model."""


@dataclass(frozen=True)
class DesignAxis:
    """A factor of a design: the number of its levels, and their coordinates if they are ordered.

    ``scores`` (L,), increasing: the levels' coordinates (logarithms for a logarithmic axis); None: unordered names.
    """

    name: str
    levels: int
    scores: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.levels < 2:
            raise ValueError(f"{self.name}: a factor needs at least two levels, got {self.levels}")
        if self.scores is not None and len(self.scores) != self.levels:
            raise ValueError(f"{self.name}: expected {self.levels} scores, got {len(self.scores)}")

    @cached_property
    def main(self) -> Floats:
        """The columns (L, L - 1) of the factor's own effect: deviations from the mean over the levels."""
        return np.vstack([np.eye(self.levels - 1), -np.ones(self.levels - 1)])

    @cached_property
    def crossed(self) -> Floats:
        """The columns (L, C) of the factor in interactions: its slope if ordered, otherwise ``main``.

        A slope is centred over the levels and spans 2 from the first level to the last.
        """
        if self.scores is None:
            return self.main
        scores = np.asarray(self.scores, dtype=np.float64)
        return np.asarray((scores - scores.mean()) * 2.0 / (scores[-1] - scores[0]))[:, None]


@dataclass(frozen=True)
class Model:
    """A linear model: the mean, the levels of every factor and, if ``pairs``, products of every two factors' slopes.

    ``terms``: the factors (one or two) that each column of ``matrix`` belongs to.
    """

    axes: tuple[DesignAxis, ...]
    pairs: bool = True

    @cached_property
    def terms(self) -> tuple[tuple[int, ...], ...]:
        """The factors of every column, () for the mean."""
        own = [(k,) for k, axis in enumerate(self.axes) for _ in range(axis.main.shape[1])]
        return ((), *own, *(tuple(sorted((self.owner[a], self.owner[b]))) for a, b in self.pairings.T))

    def matrix(self, positions: Floats | Ints) -> Floats:
        """The columns (N, P) at positions (N, K)."""
        rows = np.asarray(positions, dtype=np.float64)
        own = [interpolate_rows(axis.main, rows[:, k]) for k, axis in enumerate(self.axes)]
        slopes = self.slopes(rows)
        first, second = self.pairings
        return np.hstack([np.ones((len(rows), 1)), *own, slopes[:, first] * slopes[:, second]])

    def slopes(self, positions: Floats | Ints) -> Floats:
        """The columns (N, S) of the factors in interactions at positions (N, K)."""
        rows = np.asarray(positions, dtype=np.float64)
        return np.hstack([interpolate_rows(axis.crossed, rows[:, k]) for k, axis in enumerate(self.axes)])

    @property
    def full_grid(self) -> float:
        """The logarithm of det(X'X / N) over the full grid, where all terms are orthogonal."""
        own = [_compute_log_det(axis.main) for axis in self.axes]
        crossed = [(_compute_log_det(axis.crossed), axis.crossed.shape[1]) for axis in self.axes]
        pairs = combinations(crossed, 2) if self.pairs else ()
        return float(sum(own) + sum(one * m + other * n for (one, n), (other, m) in pairs))

    @cached_property
    def owner(self) -> list[int]:
        """The factor of each column of ``slopes``."""
        return [k for k, axis in enumerate(self.axes) for _ in range(axis.crossed.shape[1])]

    @cached_property
    def pairings(self) -> Ints:
        """The columns of ``slopes`` to multiply (2, Q)."""
        columns = range(len(self.owner) if self.pairs else 0)
        crossed = [(a, b) for a, b in combinations(columns, 2) if self.owner[a] != self.owner[b]]
        return np.array(crossed, dtype=np.int64).reshape(-1, 2).T


@dataclass(frozen=True)
class Quality:
    """How well a design supports a model.

    ``efficiency``: D-efficiency, information per point and column relative to the full grid, which is orthogonal;
    above 1 if points at the ends of ordered factors determine their slopes better.
    ``correlation``: the largest between two factors' own slopes.
    """

    efficiency: float
    correlation: float


def make_fractional(factors: int, resolution: int) -> Ints:
    """The levels (2^b, K) 0 and 1 of a two-level fractional factorial of at least that resolution.

    Resolution 3: main effects are not confounded with each other; 4: nor with two-factor interactions; 5: nor are these
    with each other (Box and Hunter, Technometrics 3, 1961). Columns are parities of the run's number; any
    ``resolution - 1`` of them are independent, picked in order, smallest first, like the words of a lexicographic code.
    b is the smallest that this gives.
    """
    if factors < 1 or not 3 <= resolution <= 5:
        raise ValueError(f"fractional: expected factors from 1 and resolution 3, 4 or 5, got {factors}, {resolution}")
    for base in count(1):
        words = _find_independent(base, factors, resolution - 1)
        if len(words) == factors:
            return np.array([[(run & word).bit_count() % 2 for word in words] for run in range(1 << base)])
    raise AssertionError  # counting has no end


def make_optimal(model: Model, points: int, rng: np.random.Generator) -> Ints:
    """The levels (N, K) of a D-optimal design.

    Coordinate exchange (Meyer and Nachtsheim, Technometrics 37, 1995) from a Latin hypercube over the levels, which is
    balanced. Raises ValueError if there are fewer points than columns of the model.
    """
    if points < len(model.terms):
        raise ValueError(f"points: {points} are too few for a model of {len(model.terms)} columns")
    levels = np.array([axis.levels for axis in model.axes])
    search = _Exchange(model, np.asarray((_draw_hypercube(len(levels), points, rng) * levels).astype(np.int64)))
    for _ in range(MAX_PASSES):
        search.renew()
        changed = [search.improve(row, factor) for row, factor in product(range(points), range(len(levels)))]
        if not any(changed):
            break
    return search.design


def make_space_filling(factors: int, points: int, rng: np.random.Generator, kind: str = "sobol") -> Floats:
    """Space-filling points (N, K) within (0, 1): "sobol" (scrambled) or "latin" (hypercube)."""
    if kind == "latin":
        return _draw_hypercube(factors, points, rng)
    from scipy.stats import qmc  # noqa: PLC0415 - slow to import

    drawn = qmc.Sobol(factors, scramble=True, seed=rng).random_base2(max(points - 1, 1).bit_length())
    return np.asarray(drawn[:points])


def make_grid(levels: Sequence[int]) -> Ints:
    """Every combination (N, K) of the levels of each factor; the last factor changes fastest."""
    return np.array(list(product(*map(range, levels))), dtype=np.int64).reshape(-1, len(levels))


def assess_design(model: Model, positions: Floats) -> Quality:
    """How well positions (N, K) support a model."""
    rows = np.asarray(positions, dtype=np.float64)
    columns = model.matrix(rows)
    sign, logarithm = np.linalg.slogdet(columns.T @ columns / len(rows))
    slopes = [interpolate_rows(_select_slopes(axis), rows[:, k]) for k, axis in enumerate(model.axes)]
    centred = [slope - slope.mean(axis=0) for slope in slopes]
    correlations = [
        abs(float(a @ b)) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-12)
        for one, other in combinations(centred, 2)
        for a, b in product(one.T, other.T)
    ]
    efficiency = float(np.exp((logarithm - model.full_grid) / columns.shape[1])) if sign > 0 else 0.0
    return Quality(efficiency, max(correlations, default=0.0))


def interpolate_rows(levels: Floats, positions: Floats) -> Floats:
    """Rows of (L, C) at positions (N,), linear between two levels."""
    low = np.clip(np.floor(positions).astype(np.int64), 0, len(levels) - 1)
    high = np.minimum(low + 1, len(levels) - 1)
    share = (positions - low)[:, None]
    return np.asarray((1.0 - share) * levels[low] + share * levels[high])


def _find_independent(base: int, factors: int, together: int) -> list[int]:
    """Up to ``factors`` numbers of ``base`` bits of which any ``together`` have no subset whose exclusive or is 0."""
    words: list[int] = []
    reached = {0}  # what subsets of up to together - 1 words give
    for word in range(1, 1 << base):
        if len(words) == factors:
            break
        if word not in reached:
            words.append(word)
            reached |= {
                reduce(xor, chosen, word) for size in range(together - 1) for chosen in combinations(words[:-1], size)
            }
    return words


class _Exchange:
    """The coordinate exchange of one design; ``slopes`` are the factors' ``crossed`` columns."""

    def __init__(self, model: Model, design: Ints) -> None:
        self.model, self.design = model, design
        self.columns, self.slopes = model.matrix(design), model.slopes(design)
        self.inverse: Floats = np.zeros((0, 0))
        self.own = [np.array([term == (k,) for term in model.terms]) for k in range(len(model.axes))]
        self.sloped = [np.array([owner == k for owner in model.owner]) for k in range(len(model.axes))]
        self.paired = np.array([len(term) == 2 for term in model.terms])

    def renew(self) -> None:
        """Compute the inverse from scratch, because rounding errors of updates add up."""
        size = self.columns.shape[1]
        information = self.columns.T @ self.columns + RIDGE * np.eye(size)
        self.inverse = np.asarray(np.linalg.inv(information), dtype=np.float64)

    def improve(self, row: int, factor: int) -> bool:
        """Set one coordinate to the level with the largest determinant; return whether it changed.

        det(X'X - x x' + y y') / det(X'X) = (1 + y'Dy)(1 - x'Dx) + (x'Dy)^2 with D = inv(X'X).
        """
        candidates, slopes = self._try_levels(row, factor)
        old = self.columns[row].copy()
        spread, leverage = candidates @ self.inverse, float(old @ self.inverse @ old)
        gain = (1.0 + np.einsum("ij,ij->i", spread, candidates)) * (1.0 - leverage) + (spread @ old) ** 2
        best = int(np.argmax(gain))
        if best == self.design[row, factor] or gain[best] < 1.0 + 1e-6:
            return False
        self.design[row, factor], self.columns[row], self.slopes[row] = best, candidates[best], slopes[best]
        self.inverse = _update_inverse(_update_inverse(self.inverse, candidates[best], 1.0), old, -1.0)
        return True

    def _try_levels(self, row: int, factor: int) -> tuple[Floats, Floats]:
        """The row's columns and slopes (L, ...) with every level of the factor."""
        axis = self.model.axes[factor]
        columns = np.repeat(self.columns[row : row + 1], axis.levels, axis=0)
        slopes = np.repeat(self.slopes[row : row + 1], axis.levels, axis=0)
        columns[:, self.own[factor]] = axis.main
        slopes[:, self.sloped[factor]] = axis.crossed
        first, second = self.model.pairings
        columns[:, self.paired] = slopes[:, first] * slopes[:, second]
        return columns, slopes


def _update_inverse(inverse: Floats, column: Floats, sign: float) -> Floats:
    """The inverse of (A + sign c c') from that of A (Sherman and Morrison)."""
    moved = inverse @ column
    return np.asarray(inverse - sign * np.outer(moved, moved) / (1.0 + sign * float(column @ moved)))


def _draw_hypercube(factors: int, points: int, rng: np.random.Generator) -> Floats:
    from scipy.stats import qmc  # noqa: PLC0415 - slow to import

    return np.asarray(qmc.LatinHypercube(factors, seed=rng).random(points))


def _compute_log_det(columns: Floats) -> float:
    return float(np.linalg.slogdet(columns.T @ columns / len(columns))[1])


def _select_slopes(axis: DesignAxis) -> Floats:
    return axis.crossed if axis.scores is not None else axis.main
