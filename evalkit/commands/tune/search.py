"""Which points to try next: the default, an even spread, then steps from the best so far."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from evalkit.commands.study.design import make_grid, make_space_filling
from evalkit.commands.study.factors import Factor
from evalkit.commands.tune.space import Candidate, Space, is_continuous
from evalkit.core.se2 import Floats

ROUNDS = 4
"""So often the steps of the second half are told what has become of those before."""

STEP = 0.2
"""Standard deviation of a step, as a share of a factor's range (Tolson and Shoemaker's choice)."""

SPARE = 8
"""So many times the points are drawn before a spread counts as exhausted."""


@dataclass(frozen=True)
class Search:
    """A search of ``budget`` points, the default among them; the same seed and scores give the same points.

    Half are spread evenly (scrambled Sobol), and half are steps from the best so far that change fewer and fewer of the
    parameters at once (dynamically dimensioned search; Tolson and Shoemaker, Water Resources Research 43, 2007), which
    was made for budgets too small to converge. No point is tried twice; a space of fewer points than the budget is
    tried in full.
    """

    space: Space
    budget: int
    seed: int = 0

    def next(self, tried: Sequence[Candidate], best: Candidate | None) -> tuple[Candidate, ...]:
        """The points to try after those tried, of which ``best`` is the best; none where the search is over."""
        left = self._most() - len(tried)
        if not tried:
            return self._spread()
        if left <= 0 or best is None:
            return ()
        return self._steps(tried, best, min(left, math.ceil((self._most() - self._first()) / ROUNDS)))

    def _most(self) -> int:
        """Points in all; the default may lie outside the space's own."""
        if not self.space.factors:
            return 1
        if self.space.size is None or self.space.size >= self.budget:
            return self.budget
        beyond = self.space.start().key not in {candidate.key for candidate in self._everything()}
        return min(self.budget, self.space.size + beyond)

    def _first(self) -> int:
        most = self._most()
        return most if most < self.budget else math.ceil(most / 2)

    def _everything(self) -> Iterator[Candidate]:
        levels = [len(factor.levels) for factor in self.space.factors]
        for row in make_grid(levels).tolist():
            yield self.space.at([(at + 0.5) / of for at, of in zip(row, levels, strict=True)], "all")

    def _spread(self) -> tuple[Candidate, ...]:
        start = self.space.start()
        if not self.space.factors:
            return (start,)
        if self._most() < self.budget:
            return _distinct(chain([start], self._everything()), (), self._most())
        factors, rng = len(self.space.factors), np.random.default_rng(self.seed)
        shares = make_space_filling(factors, SPARE * self._first(), rng)
        return _distinct(chain([start], (self.space.at(row, "spread") for row in shares)), (), self._first())

    def _steps(self, tried: Sequence[Candidate], best: Candidate, points: int) -> tuple[Candidate, ...]:
        rng = np.random.default_rng([self.seed, len(tried)])
        begun, steps = self._first(), max(self._most() - self._first(), 2)

        def drawn() -> Iterator[Candidate]:
            for attempt in range(SPARE * SPARE * points):
                step = len(tried) - begun + attempt % points + 1
                share = max(1.0 - math.log(step) / math.log(steps), 0.0) if step < steps else 0.0
                yield self.space.at(_moved(self.space.factors, best.shares, share, rng), "step")

        anywhere = (self.space.at(row, "spread") for row in rng.random((SPARE * SPARE * points, len(best.shares))))
        return _distinct(chain(drawn(), anywhere), tried, points)


def _moved(factors: Sequence[Factor], shares: Sequence[float], share: float, rng: np.random.Generator) -> Floats:
    """A place near another: each coordinate is moved with a probability, one at least."""
    chosen = rng.random(len(shares)) < share
    chosen[rng.integers(len(shares))] = True
    made = np.array(shares)
    for number in np.flatnonzero(chosen).tolist():
        made[number] = _step(factors[number])(made[number], rng)
    return made


def _step(factor: Factor) -> Callable[[float, np.random.Generator], float]:
    """What moves a coordinate: a step along a range, to a neighbour in a list, or to any other name."""
    count = len(factor.levels)

    def along(at: float, rng: np.random.Generator) -> float:
        return _reflected(at + STEP * rng.standard_normal())

    def to_level(at: float, rng: np.random.Generator) -> float:
        known = min(int(at * count), count - 1)
        reach = count - 1 if factor.numbers is None else max(1, round(STEP * count))
        others = [i for i in range(count) if 0 < abs(i - known) <= reach]
        return (others[rng.integers(len(others))] + 0.5) / count

    return along if is_continuous(factor) else to_level


def _reflected(share: float) -> float:
    """Back from the border by what lies beyond it."""
    inside = abs(share)
    inside = 2.0 - inside if inside > 1.0 else inside
    return min(max(inside, 0.0), 1.0)


def _distinct(candidates: Iterable[Candidate], tried: Sequence[Candidate], points: int) -> tuple[Candidate, ...]:
    """The first so many candidates whose values have not been tried."""
    seen = {candidate.key for candidate in tried}
    chosen: list[Candidate] = []
    for candidate in candidates:
        if len(chosen) == points:
            break
        if candidate.key not in seen:
            seen.add(candidate.key)
            chosen.append(candidate)
    return tuple(chosen)
