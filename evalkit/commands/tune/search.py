"""The next points to try: the default, an even spread, then steps from the best point so far."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from evalkit.commands.tune.space import Space, TuningCandidate, is_continuous
from evalkit.core.se2 import Floats
from evalkit.design.designs import make_grid, make_space_filling
from evalkit.design.factors import Factor

ROUNDS = 4
"""Rounds of the second half; the steps of a round start from the best point of the rounds before."""

STEP = 0.2
"""Standard deviation of a step, as a share of a factor's range (Tolson and Shoemaker's choice)."""

SPARE = 8
"""Points to draw for each point needed, because some draws repeat a tried point."""


@dataclass(frozen=True)
class Search:
    """A search of ``budget`` points including the default; the same seed and scores give the same points.

    Half of the points are spread evenly (scrambled Sobol). The other half are steps from the best point so far that
    change fewer and fewer parameters at once (dynamically dimensioned search; Tolson and Shoemaker, Water Resources
    Research 43, 2007), a method for budgets too small to converge. No point is tried twice; a space of fewer points
    than the budget is tried completely.
    """

    space: Space
    budget: int
    seed: int = 0

    def next(self, tried: Sequence[TuningCandidate], best: TuningCandidate | None) -> tuple[TuningCandidate, ...]:
        """The points to try after ``tried``, of which ``best`` is the best; none if the search is over."""
        left = self._point_count() - len(tried)
        if not tried:
            return self._spread()
        if left <= 0 or best is None:
            return ()
        return self._steps(tried, best, min(left, math.ceil((self._point_count() - self._spread_count()) / ROUNDS)))

    def _point_count(self) -> int:
        """The number of points in all; the default may lie outside the levels of the space."""
        if not self.space.factors:
            return 1
        if self.space.size is None or self.space.size >= self.budget:
            return self.budget
        beyond = self.space.start().key not in {candidate.key for candidate in self._all_combinations()}
        return min(self.budget, self.space.size + beyond)

    def _spread_count(self) -> int:
        most = self._point_count()
        return most if most < self.budget else math.ceil(most / 2)

    def _all_combinations(self) -> Iterator[TuningCandidate]:
        levels = [len(factor.levels) for factor in self.space.factors]
        for row in make_grid(levels).tolist():
            yield self.space.at([(at + 0.5) / of for at, of in zip(row, levels, strict=True)], "all")

    def _spread(self) -> tuple[TuningCandidate, ...]:
        start = self.space.start()
        if not self.space.factors:
            return (start,)
        if self._point_count() < self.budget:
            return _take_untried(chain([start], self._all_combinations()), (), self._point_count())
        factors, rng = len(self.space.factors), np.random.default_rng(self.seed)
        shares = make_space_filling(factors, SPARE * self._spread_count(), rng)
        return _take_untried(chain([start], (self.space.at(row, "spread") for row in shares)), (), self._spread_count())

    def _steps(
        self, tried: Sequence[TuningCandidate], best: TuningCandidate, points: int
    ) -> tuple[TuningCandidate, ...]:
        rng = np.random.default_rng([self.seed, len(tried)])
        spread, steps = self._spread_count(), max(self._point_count() - self._spread_count(), 2)

        def draw_steps() -> Iterator[TuningCandidate]:
            for attempt in range(SPARE * SPARE * points):
                step = len(tried) - spread + attempt % points + 1
                share = max(1.0 - math.log(step) / math.log(steps), 0.0) if step < steps else 0.0
                yield self.space.at(_change_some(self.space.factors, best.shares, share, rng), "step")

        anywhere = (self.space.at(row, "spread") for row in rng.random((SPARE * SPARE * points, len(best.shares))))
        return _take_untried(chain(draw_steps(), anywhere), tried, points)


def _change_some(factors: Sequence[Factor], shares: Sequence[float], share: float, rng: np.random.Generator) -> Floats:
    """A place near another: each coordinate moves with probability ``share``, and at least one does."""
    chosen = rng.random(len(shares)) < share
    chosen[rng.integers(len(shares))] = True
    moved = np.array(shares)
    for number in np.flatnonzero(chosen).tolist():
        moved[number] = _make_step(factors[number])(moved[number], rng)
    return moved


def _make_step(factor: Factor) -> Callable[[float, np.random.Generator], float]:
    """A function that moves a coordinate: along a range, to a nearby level, or to any other unordered level."""
    count = len(factor.levels)

    def along(at: float, rng: np.random.Generator) -> float:
        return _reflect_share(at + STEP * rng.standard_normal())

    def to_level(at: float, rng: np.random.Generator) -> float:
        known = min(int(at * count), count - 1)
        reach = count - 1 if factor.numbers is None else max(1, round(STEP * count))
        others = [i for i in range(count) if 0 < abs(i - known) <= reach]
        return (others[rng.integers(len(others))] + 0.5) / count

    return along if is_continuous(factor) else to_level


def _reflect_share(share: float) -> float:
    """A share reflected into 0 to 1."""
    inside = abs(share)
    inside = 2.0 - inside if inside > 1.0 else inside
    return min(max(inside, 0.0), 1.0)


def _take_untried(
    candidates: Iterable[TuningCandidate], tried: Sequence[TuningCandidate], points: int
) -> tuple[TuningCandidate, ...]:
    """The first ``points`` candidates whose values are not tried yet."""
    seen = {candidate.key for candidate in tried}
    chosen: list[TuningCandidate] = []
    for candidate in candidates:
        if len(chosen) == points:
            break
        if candidate.key not in seen:
            seen.add(candidate.key)
            chosen.append(candidate)
    return tuple(chosen)
