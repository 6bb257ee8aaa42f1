"""Causes of different correspondences: a tie, another outlier rule, or another start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from evalkit.commands.validate.equivalence.diagnosis import DivergenceKind, mistakes_in_start
from evalkit.commands.validate.equivalence.lockstep import Question
from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats

NEARLY_ALL = 0.98
"""Another start explains the pairs if at least this share of them are nearest neighbours from there."""

Explanation = tuple[DivergenceKind, str]


def same_pairs(a: Ints, b: Ints) -> bool:
    """Whether two lists of pairs (K, 2) are equal in any order."""
    return len(a) == len(b) and bool(np.array_equal(_sort_pairs(a), _sort_pairs(b)))


def explain_difference(
    question: Question, before: Pose, a: Ints, b: Ints, tolerance_m: float, first: bool
) -> Explanation:
    """The class of a difference between pairs (K, 2) and (L, 2) from the same pose, and a description.

    ``tolerance_m``: distances within it count as equal. ``first``: whether this is the first iteration, which may have
    started from another pose.
    """
    impossible = _impossible_reason(question, b)
    if impossible:
        return _explain_by_start(question, b) or ("different", impossible)
    correspondences = Correspondences.of(question, before, a, b, tolerance_m)
    if not correspondences.unexplained.any():
        return correspondences.describe_tie()
    if not correspondences.farther.any():
        return correspondences.describe_outliers()
    return (_explain_by_start(question, b) if first else None) or correspondences.describe_wrong()


@dataclass(frozen=True, eq=False)
class Correspondences:
    """The pairs of both sides by source point: target indices (N,), -1 if unpaired, and distances (N,) (m)."""

    a: Ints
    b: Ints
    distance_a: Floats
    distance_b: Floats
    tied: Bools
    tolerance_m: float

    @classmethod
    def of(cls, question: Question, before: Pose, a: Ints, b: Ints, tolerance_m: float) -> Correspondences:
        """The pairs of both sides, with distances from the source moved by the pose of A."""
        moved, target = before.transform(question.source.points), question.target.points
        tree = cKDTree(target)
        nearest = np.asarray(tree.query(moved, k=min(2, len(target)))[0]).reshape(len(moved), -1)
        tied = nearest[:, -1] - nearest[:, 0] <= tolerance_m if nearest.shape[1] == 2 else np.zeros(len(moved), bool)
        sides = []
        for pairs in (a, b):
            onto = np.full(len(moved), -1, dtype=np.int64)
            onto[pairs[:, 0]] = pairs[:, 1]
            distance = np.full(len(moved), np.nan)
            distance[pairs[:, 0]] = np.linalg.norm(moved[pairs[:, 0]] - target[pairs[:, 1]], axis=1)
            sides.append((onto, distance))
        (onto_a, distance_a), (onto_b, distance_b) = sides
        return cls(onto_a, onto_b, distance_a, distance_b, tied, tolerance_m)

    @property
    def differing(self) -> Bools:
        """Source points (N,) with different partners."""
        return np.asarray(self.a != self.b)

    @property
    def farther(self) -> Bools:
        """Source points (N,) whose two partners are at different distances, so that one is not the nearest."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.differing & (np.abs(self.distance_a - self.distance_b) > self.tolerance_m))

    @property
    def unexplained(self) -> Bools:
        """Differing source points (N,) that a tie does not explain, neither their own nor that of a competing point."""
        left = self.farther | (self.differing & ~self.tied)
        for one, other, own, others in (
            (self.a, self.b, self.distance_a, self.distance_b),
            (self.b, self.a, self.distance_b, self.distance_a),
        ):
            holders = {target: row for row, target in enumerate(other.tolist()) if target >= 0}
            for row in np.flatnonzero(left & (one >= 0) & (other < 0)).tolist():
                holder = holders.get(int(one[row]), -1)
                if holder >= 0 and (self.tied[holder] or abs(others[holder] - own[row]) <= self.tolerance_m):
                    left[row] = False
        return np.asarray(left & ~self._among_equals)

    @property
    def _among_equals(self) -> Bools:
        """Differing source points (N,) with two partners at equal distance."""
        return np.asarray(self.differing & (self.a >= 0) & (self.b >= 0) & ~self.farther)

    def describe_tie(self) -> Explanation:
        """The explanation of pairs that differ only among equal distances."""
        count = int(np.count_nonzero(self.differing))
        return (
            "nearest-neighbour tie",
            f"{count} points have partners at equal distance, within {self.tolerance_m:.1g} m",
        )

    def describe_outliers(self) -> Explanation:
        """The explanation of sides with the same nearest neighbours that keep different pairs."""
        counts = f"{np.count_nonzero(self.a >= 0)} pairs against {np.count_nonzero(self.b >= 0)}"
        shared_a, shared_b = _count_shared(self.a), _count_shared(self.b)
        if bool(shared_a) != bool(shared_b):
            many, one = ("A", "B") if shared_a else ("B", "A")
            return (
                "outlier rule",
                f"one-to-one filter: {many} pairs a target with several points, {one} does not ({counts})",
            )
        longest_a, longest_b = np.nanmax(self.distance_a, initial=0.0), np.nanmax(self.distance_b, initial=0.0)
        only_a, only_b = self.distance_a[self.b < 0], self.distance_b[self.a < 0]
        beyond = not (only_a <= longest_b).any() and not (only_b <= longest_a).any()
        if beyond:
            return (
                "outlier rule",
                f"maximum distance: longest pair {longest_a:.4g} m against {longest_b:.4g} m ({counts})",
            )
        return "outlier rule", f"different pairs are kept, nearest neighbours agree ({counts})"

    def describe_wrong(self) -> Explanation:
        """The explanation of sides of which one does not take the nearest neighbour."""
        row = int(np.flatnonzero(self.farther)[0])
        near, far = self.distance_a[row], self.distance_b[row]
        side = "B" if far > near else "A"
        where = f"source point {row}: {near:.4g} m against {far:.4g} m"
        return (
            "different",
            f"{side} does not take the nearest neighbour ({where}, {int(self.farther.sum())} points in all)",
        )


def _explain_by_start(question: Question, pairs: Ints) -> Explanation | None:
    """The wrong start from which the pairs are nearest neighbours, or exchanged clouds; None if none explains them."""
    source, target, guess = question.source.points, question.target.points, question.guess.row
    tree = cKDTree(target)
    candidates: list[tuple[float, Explanation]] = []
    if not _impossible_reason(question, pairs):
        for mistake in mistakes_in_start(guess):
            share = _nearest_share(tree, se2.transform(mistake.row, source), pairs)
            candidates.append((share, (mistake.kind, f"another start: {mistake.what}")))
    exchanged = pairs[:, ::-1]
    if not _out_of_range(exchanged, len(source), len(target)):
        for row in (guess, se2.inverse(guess)):
            share = _nearest_share(cKDTree(se2.transform(se2.inverse(row), source)), target, pairs)
            candidates.append((share, ("different", "target and source are exchanged")))
    share, best = max(candidates, key=lambda one: one[0], default=(0.0, None))
    return best if share >= NEARLY_ALL else None


def _nearest_share(tree: cKDTree, moved: Floats, pairs: Ints) -> float:
    if not len(pairs):
        return 0.0
    at = moved[pairs[:, 0]]
    nearest = np.asarray(tree.query(at)[0])
    distance = np.linalg.norm(at - tree.data[pairs[:, 1]], axis=1)
    return float(np.mean(distance <= nearest + 1e-9))


def _impossible_reason(question: Question, pairs: Ints) -> str:
    """Why these cannot be pairs of this question, "" if they can."""
    if _out_of_range(pairs, len(question.source), len(question.target)):
        return "its pairs contain indices out of range"
    if len(np.unique(pairs[:, 0])) < len(pairs):
        return "a source point has several partners"
    return ""


def _out_of_range(pairs: Ints, sources: int, targets: int) -> bool:
    return bool(len(pairs)) and bool(
        (pairs.min() < 0) | (pairs[:, 0].max() >= sources) | (pairs[:, 1].max() >= targets)
    )


def _count_shared(onto: Ints) -> int:
    """The number of pairs that share their target with another pair."""
    paired = onto[onto >= 0]
    return len(paired) - len(np.unique(paired))


def _sort_pairs(pairs: Ints) -> Ints:
    return pairs[np.lexsort(pairs.T)]
