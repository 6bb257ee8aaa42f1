"""Hypotheses about one step of an ICP whose pairs are not known: which other rule leads to the observed pose.

The reference's pairs are known. Each hypothesis changes one rule: the start, the neighbours, the outliers that are
dropped, the age of the pairs, or the step. The one whose pose is the observed one names the cause.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from evalkit.commands.validate.equivalence.diagnosis import (
    EXPLAINED,
    DivergenceKind,
    Mistake,
    best_step,
    find_mistake,
    mistakes_in_start,
    mistakes_in_step,
    motion_distance_m,
)
from evalkit.commands.validate.equivalence.other_points import mistaken_points
from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.se2 import Floats

MIN_PAIRS = 2

LIMIT_SHARES = (0.5, 0.05, 0.95)
"""Where the largest distance of a pair, which is not known, is assumed between two distances that enclose it."""


@dataclass(frozen=True, eq=False)
class ObservedStep:
    """One iteration: the clouds (M, 2) and (N, 2), the pose (3,) before it, and the reference's pairs (K, 2).

    ``right``, ``observed``: the poses (3,) after it, the reference's and the one to explain, which reports ``count``
    pairs. ``first``, ``previous``: the reference's pairs of the first iteration and of the one before, None without.
    ``guess``: the start (3,) of the first iteration.
    """

    target: Floats
    source: Floats
    before: Floats
    guess: Floats
    pairs: Ints
    right: Floats
    observed: Floats
    count: int
    first: Ints | None
    previous: Ints | None
    lever_m: float
    limit_share: float = 0.5

    def explain(self) -> Mistake | None:
        """The mistake that gives the observed pose; None if no hypothesis does."""
        return (
            find_mistake(list(self._simple()), self.right, self.observed, self.lever_m)
            or self._scale_step()
            or self._weight_pairs()
        )

    def _simple(self) -> Iterator[Mistake]:
        moved = se2.transform(self.before, self.source)
        yield from mistakes_in_step(self.before, moved[self.pairs[:, 0]], self.target[self.pairs[:, 1]], moved)
        yield from self._of_points(moved)
        for share in LIMIT_SHARES:
            for kind, what, pairs in replace(self, limit_share=share)._other_pairs(moved):
                if len(pairs) >= MIN_PAIRS:
                    yield Mistake(kind, what, self._after(self.before, pairs))
        yield from self._exchange_clouds()
        if self.previous is None:
            right_start = self._take_shortest(*_nearest(moved, self.target))
            for mistake in mistakes_in_start(self.guess):
                found = _nearest(se2.transform(mistake.row, self.source), self.target)
                for pairs in (self._filter_pairs(*found), self._take_shortest(*found)):
                    if len(pairs) >= MIN_PAIRS and not np.array_equal(pairs, right_start):
                        yield Mistake("start", f"another start: {mistake.what}", self._after(mistake.row, pairs))

    def _of_points(self, moved: Floats) -> Iterator[Mistake]:
        """Steps of other points; after another motion also by as many pairs as are reported, if they are others."""
        right = self._take_shortest(*_nearest(moved, self.target))
        for kind, what, target, other in mistaken_points(self.before, self.target, self.source):
            found = _nearest(other, target)
            others = [self._filter_pairs(*found)]
            if kind == "step" and not np.array_equal(counted := self._take_shortest(*found), right):
                others.append(counted)
            for pairs in others:
                if len(pairs) >= MIN_PAIRS:
                    step = best_step(other[pairs[:, 0]], target[pairs[:, 1]])
                    yield Mistake(kind, what, se2.compose(step, self.before))

    def _exchange_clouds(self) -> Iterator[Mistake]:
        """The step of the target onto the source: inverted, or as it is where the guess is not inverted either."""
        for inverted in (True, False):
            start = se2.inverse(self.before) if inverted else self.before
            moved = se2.transform(start, self.target)
            onto, distance = _nearest(moved, self.source)
            for pairs in (self._filter_pairs(onto, distance), self._take_shortest(onto, distance)):
                if len(pairs) >= MIN_PAIRS:
                    row = se2.compose(best_step(moved[pairs[:, 0]], self.source[pairs[:, 1]]), start)
                    row = se2.inverse(row) if inverted else row
                    yield Mistake("neighbours", "target and source are exchanged", row)

    def _after(self, before: Floats, pairs: Ints) -> Floats:
        moved = se2.transform(before, self.source[pairs[:, 0]])
        return se2.compose(best_step(moved, self.target[pairs[:, 1]]), before)

    @property
    def _limit_m(self) -> float:
        """The reference's largest distance of a pair: from its longest pair to the next free neighbour, at a share."""
        onto, distance = _nearest(se2.transform(self.before, self.source), self.target)
        paired = np.isin(np.arange(len(onto)), self.pairs[:, 0])
        free = ~paired & ~np.isin(onto, self.pairs[:, 1])
        longest = float(distance[paired].max(initial=0.0))
        next_m = float(distance[free].min(initial=math.inf))
        return longest + self.limit_share * (next_m - longest) if math.isfinite(next_m) else math.inf

    @property
    def _one_to_one(self) -> bool:
        return len(np.unique(self.pairs[:, 1])) == len(self.pairs)

    def _filter_pairs(
        self,
        onto: Ints,
        distance: Floats,
        limit_m: float | None = None,
        keep: str | None = None,
        rows: Ints | None = None,
    ) -> Ints:
        """The pairs (K, 2) of neighbours (N,): within the limit, and one to one if the reference's are."""
        rows = np.arange(len(onto)) if rows is None else rows
        within = distance < (self._limit_m if limit_m is None else limit_m)
        rows, onto, distance = rows[within], onto[within], distance[within]
        keep = keep or ("closest" if self._one_to_one else "all")
        if keep != "all":
            order = {"closest": np.lexsort((rows, distance)), "first": np.argsort(rows), "last": np.argsort(-rows)}[
                keep
            ]
            _, chosen = np.unique(onto[order], return_index=True)
            kept = np.sort(order[chosen])
            rows, onto = rows[kept], onto[kept]
        return np.stack([rows, onto], axis=1)

    def _take_shortest(self, onto: Ints, distance: Floats) -> Ints:
        """As many pairs of neighbours (N,) as are reported, the shortest ones."""
        every = self._filter_pairs(onto, distance, limit_m=math.inf)
        return every[np.sort(np.argsort(distance[every[:, 0]], kind="stable")[: max(self.count, 0)])]

    def _other_pairs(self, moved: Floats) -> Iterator[tuple[DivergenceKind, str, Ints]]:
        for old, when in ((self.previous, "of the iteration before"), (self.first, "of the first iteration")):
            if old is not None:
                yield "stale pairs", f"stale pairs: those {when}", old
        onto, distance = _nearest(moved, self.target)
        if self._one_to_one:
            shortest = np.sort(np.argsort(distance, kind="stable")[: max(self.count, 0)])
            for shared in (
                self._filter_pairs(onto, distance, keep="all"),
                np.stack([shortest, onto[shortest]], axis=1),
            ):
                if len(np.unique(shared[:, 1])) < len(shared):
                    yield "outlier rule", "one-to-one filter: several source points may share a target", shared
            for which in ("first", "last"):
                what = f"one-to-one filter: the {which} source point of a target is kept, not the closest"
                yield "outlier rule", what, self._filter_pairs(onto, distance, keep=which)
        else:
            yield (
                "outlier rule",
                "one-to-one filter: a target keeps its closest source point only",
                self._filter_pairs(onto, distance, keep="closest"),
            )
        yield from self._by_length(moved, onto, distance)
        yield from self._by_neighbours(moved)
        yield from self._by_points(moved)

    def _by_length(self, moved: Floats, onto: Ints, distance: Floats) -> Iterator[tuple[DivergenceKind, str, Ints]]:
        """Other limits: none, and as many pairs as are reported, the shortest ones."""
        every = self._filter_pairs(onto, distance, limit_m=math.inf)
        yield "outlier rule", "maximum distance: there is none", every
        length = np.linalg.norm(moved[every[:, 0]] - self.target[every[:, 1]], axis=1)
        order = np.argsort(length, kind="stable")
        if MIN_PAIRS <= self.count <= len(every) and self.count != len(self.pairs):
            yield from self._by_range(self.pairs)
            kept = every[order[: self.count]]
            longest, known = float(length[order[self.count - 1]]), len(self.pairs)
            right = float(np.linalg.norm(moved[self.pairs[:, 0]] - self.target[self.pairs[:, 1]], axis=1).max())
            longer, shorter = format_apart(longest, right)
            what = f"maximum distance: pairs up to {longer} m are kept instead of {shorter} m"
            if self.count < known:
                what = f"the longest {known - self.count} of {known} pairs are dropped, beyond {longest:.4g} m"
            yield "outlier rule", what, kept

    def _by_range(self, pairs: Ints) -> Iterator[tuple[DivergenceKind, str, Ints]]:
        """As many pairs as are reported, without those whose source point is near the sensor, or far from it."""
        if not MIN_PAIRS <= self.count < len(pairs):
            return
        away = np.linalg.norm(self.source[pairs[:, 0]], axis=1)
        order = np.argsort(away, kind="stable")
        for name, kept, limit in (("nearer", order[-self.count :], order[-self.count]),
                                  ("farther", order[: self.count], order[self.count - 1])):  # fmt: skip
            what = f"source points {name} to the origin than {away[limit]:.3g} m are dropped"
            yield "outlier rule", what.replace("farther to", "farther from"), pairs[np.sort(kept)]

    def _by_neighbours(self, moved: Floats) -> Iterator[tuple[DivergenceKind, str, Ints]]:
        """Other neighbours than the nearest ones."""
        if len(self.target) > 1:
            distances, two = map(np.asarray, cKDTree(self.target).query(moved, k=2))
            yield "neighbours", "the second nearest neighbour is taken", self._filter_pairs(two[:, 1], distances[:, 1])
            both = self._filter_pairs(two[:, 1], distances[:, 0])
            yield "neighbours", "the second nearest neighbour is taken", both
        for power, name in ((1.0, "the sum of x and y"), (math.inf, "the larger of x and y")):
            measured, onto = map(np.asarray, cKDTree(self.target).query(moved, p=power))
            exact = np.linalg.norm(moved - self.target[onto], axis=1)
            for distance in (exact, measured):
                yield "neighbours", f"neighbours are nearest by {name}", self._filter_pairs(onto, distance)
                yield "neighbours", f"neighbours are nearest by {name}", self._take_shortest(onto, distance)
        for axis, name in ((0, "x"), (1, "y")):
            onto = np.asarray(cKDTree(self.target[:, [axis]]).query(moved[:, [axis]])[1])
            distance = np.linalg.norm(moved - self.target[onto], axis=1)
            yield "neighbours", f"neighbours are nearest by {name} alone", self._filter_pairs(onto, distance)
        for axes, name in (([0], "x = 0"), ([1], "y = 0"), ([0, 1], "zero")):
            onto, distance = _nearest_of_one_sign(moved, self.target, axes)
            yield "neighbours", f"neighbours across {name} are not found", self._filter_pairs(onto, distance)
        unmoved = se2.transform(self.guess, self.source)
        for points, name in ((unmoved, "the guess"), (self.source, "the identity")):
            onto, distance = _nearest(points, self.target)
            yield "stale pairs", f"stale pairs: neighbours from {name}", self._filter_pairs(onto, distance)

    def _by_points(self, moved: Floats) -> Iterator[tuple[DivergenceKind, str, Ints]]:
        """Points that are not used."""
        parts: tuple[tuple[str, Callable[[int], slice]], ...] = (
            ("the first {} point is not used", lambda _: slice(1, None)),
            ("the last {} point is not used", lambda count: slice(0, count - 1)),
            ("only every second {} point is used", lambda _: slice(0, None, 2)),
            ("only the first half of the {} points is used", lambda count: slice(0, count // 2)),
        )
        for text, part in parts:
            some = np.arange(len(self.target))[part(len(self.target))]
            if len(some):
                onto, distance = _nearest(moved, self.target[some])
                yield "neighbours", text.format("target"), self._filter_pairs(some[onto], distance)
            rows = np.arange(len(moved))[part(len(moved))]
            if len(rows):
                onto, distance = _nearest(moved[rows], self.target)
                yield "neighbours", text.format("source"), self._filter_pairs(onto, distance, rows=rows)

    def _scale_step(self) -> Mistake | None:
        """A share of the least-squares step, or of its angle."""
        moved = se2.transform(self.before, self.source)
        p, q = moved[self.pairs[:, 0]], self.target[self.pairs[:, 1]]
        p_bar, q_bar = p.mean(axis=0), q.mean(axis=0)
        theta = best_step(p, q)[2]
        found = float(se2.wrap(self.observed[2] - self.before[2]))
        if abs(theta) < 1e-12:
            return None
        gain = found / theta
        for what, share in ((f"the step is {gain:.3g} times the least-squares step", gain),
                            (f"the step's angle is {gain:.3g} times the least-squares angle", 1.0)):  # fmt: skip
            goal = p_bar + share * (q_bar - p_bar)
            turn = np.array([0.0, 0.0, found])
            step = np.array([*(goal - se2.transform(turn, p_bar[None])[0]), found])
            row = se2.compose(step, self.before)
            if self._unexplained_share(row) < EXPLAINED:
                return Mistake("step", what, row)
        return None

    def _weight_pairs(self) -> Mistake | None:
        """A least-squares step whose pairs weigh by their distance, with any scale."""
        from scipy.optimize import minimize_scalar  # noqa: PLC0415 - slow to import, and only for this mistake

        moved = se2.transform(self.before, self.source)
        p, q = moved[self.pairs[:, 0]], self.target[self.pairs[:, 1]]
        distance = np.linalg.norm(p - q, axis=1)
        typical = float(np.median(distance)) or 1e-3

        def row(exponent: float, power: float) -> Floats:
            weights = 1.0 / (1.0 + (distance / (typical * 10.0**exponent)) ** power)
            return se2.compose(_weighted_step(p, q, weights), self.before)

        for power in (1.0, 2.0, 4.0):
            tried = [self._unexplained_share(row(exponent, power)) for exponent in np.linspace(-2.0, 3.0, 21)]
            middle = -2.0 + 0.25 * int(np.argmin(tried))
            found = minimize_scalar(
                lambda exponent, power=power: self._unexplained_share(row(exponent, power)),
                bounds=(middle - 0.3, middle + 0.3), method="bounded", options={"xatol": 1e-6},
            )  # fmt: skip
            if found.fun < EXPLAINED:
                return Mistake("step", "the step weighs near pairs more than far ones", row(float(found.x), power))
        inverse = se2.compose(_weighted_step(p, q, distance), self.before)
        if self._unexplained_share(inverse) < EXPLAINED:
            return Mistake("step", "the step weighs far pairs more than near ones", inverse)
        return None

    def _unexplained_share(self, row: Floats) -> float:
        """The share of the difference that a hypothesis leaves unexplained."""
        whole = motion_distance_m(self.right, self.observed, self.lever_m)
        return motion_distance_m(row, self.observed, self.lever_m) / max(whole, 1e-300)


def _nearest(moved: Floats, target: Floats) -> tuple[Ints, Floats]:
    distance, onto = map(np.asarray, cKDTree(target).query(moved))
    return onto, distance


def _nearest_of_one_sign(moved: Floats, target: Floats, axes: list[int]) -> tuple[Ints, Floats]:
    """The nearest neighbours (N,) with the same signs on some axes, and their distances (inf: none)."""
    onto, distance = np.zeros(len(moved), dtype=np.int64), np.full(len(moved), np.inf)
    signs = (target[:, axes] < 0.0) @ (1, 2)[: len(axes)]
    own = (moved[:, axes] < 0.0) @ (1, 2)[: len(axes)]
    for sign in np.unique(signs):
        rows, some = np.flatnonzero(own == sign), np.flatnonzero(signs == sign)
        if len(rows):
            nearest, distance[rows] = _nearest(moved[rows], target[some])
            onto[rows] = some[nearest]
    return onto, distance


def _weighted_step(source: Floats, target: Floats, weights: Floats) -> Floats:
    share = (weights / max(float(weights.sum()), 1e-300))[:, None]
    p_bar, q_bar = (share * source).sum(axis=0), (share * target).sum(axis=0)
    cross = (share * (source - p_bar)).T @ (target - q_bar)
    turn = np.array([0.0, 0.0, math.atan2(cross[0, 1] - cross[1, 0], cross[0, 0] + cross[1, 1])])
    return np.array([*(q_bar - se2.transform(turn, p_bar[None])[0]), turn[2]])


def format_apart(one: float, other: float) -> tuple[str, str]:
    """Return two numbers with four digits, or with as many as tell them apart."""
    digits = next((n for n in range(4, 17) if f"{one:.{n}g}" != f"{other:.{n}g}"), 17)
    return f"{one:.{digits}g}", f"{other:.{digits}g}"
