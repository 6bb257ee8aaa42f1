"""Why two registrations pair the same points differently: a tie, another rule for outliers, or another start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from evalkit.commands.validate.equivalence.diagnosis import Kind, in_start
from evalkit.commands.validate.equivalence.lockstep import Question
from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats

NEARLY_ALL = 0.98
"""Another start explains pairs if this share of them are nearest neighbours from there."""

Told = tuple[Kind, str]


def same(a: Ints, b: Ints) -> bool:
    """Whether two lists of pairs (K, 2) hold the same pairs in any order."""
    return len(a) == len(b) and bool(np.array_equal(_ordered(a), _ordered(b)))


def told(question: Question, before: Pose, a: Ints, b: Ints, tolerance_m: float, first: bool) -> Told:
    """The class of a difference between pairs (K, 2) and (L, 2) found from one pose, and what differs.

    ``tolerance_m``: distances this near to each other are equal. ``first``: whether this is the first iteration, which
    may have started from somewhere else.
    """
    impossible = _impossible(question, b)
    if impossible:
        return _another_start(question, b) or ("different", impossible)
    pairing = Pairing.of(question, before, a, b, tolerance_m)
    if not pairing.unexplained.any():
        return pairing.tie()
    if not pairing.farther.any():
        return pairing.outliers()
    return (_another_start(question, b) if first else None) or pairing.wrong()


@dataclass(frozen=True, eq=False)
class Pairing:
    """Both sides' pairs by source point: target indices (N,), -1 where unpaired, and distances (N,) (m)."""

    a: Ints
    b: Ints
    distance_a: Floats
    distance_b: Floats
    tied: Bools
    tolerance_m: float

    @classmethod
    def of(cls, question: Question, before: Pose, a: Ints, b: Ints, tolerance_m: float) -> Pairing:
        """The pairs of both sides, held against each other where A's pose puts the source."""
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
        """Source points (N,) that the two sides treat differently."""
        return np.asarray(self.a != self.b)

    @property
    def farther(self) -> Bools:
        """Source points (N,) with two partners of which one is farther: somebody's is not the nearest."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.differing & (np.abs(self.distance_a - self.distance_b) > self.tolerance_m))

    @property
    def unexplained(self) -> Bools:
        """Differing source points (N,) that neither have two nearest targets nor lost theirs through a tie."""
        left = self.farther | (self.differing & ~self.tied)
        for mine, theirs, own, others in (
            (self.a, self.b, self.distance_a, self.distance_b),
            (self.b, self.a, self.distance_b, self.distance_a),
        ):
            holders = {target: row for row, target in enumerate(theirs.tolist()) if target >= 0}
            for row in np.flatnonzero(left & (mine >= 0) & (theirs < 0)).tolist():
                holder = holders.get(int(mine[row]), -1)
                if holder >= 0 and (self.tied[holder] or abs(others[holder] - own[row]) <= self.tolerance_m):
                    left[row] = False
        return np.asarray(left & ~self._among_equals)

    @property
    def _among_equals(self) -> Bools:
        """Differing source points (N,) with two partners at equal distance."""
        return np.asarray(self.differing & (self.a >= 0) & (self.b >= 0) & ~self.farther)

    def tie(self) -> Told:
        """What is said of pairs that differ among equals."""
        count = int(np.count_nonzero(self.differing))
        return (
            "nearest-neighbour tie",
            f"{count} points have partners at equal distance, within {self.tolerance_m:.1g} m",
        )

    def outliers(self) -> Told:
        """What is said of sides that agree on who is nearest but keep different pairs."""
        counts = f"{np.count_nonzero(self.a >= 0)} pairs against {np.count_nonzero(self.b >= 0)}"
        shared_a, shared_b = _shared(self.a), _shared(self.b)
        if bool(shared_a) != bool(shared_b):
            many, one = ("A", "B") if shared_a else ("B", "A")
            return (
                "outlier rule",
                f"one-to-one filter: {many} gives a target to several points, {one} does not ({counts})",
            )
        longest_a, longest_b = np.nanmax(self.distance_a, initial=0.0), np.nanmax(self.distance_b, initial=0.0)
        only_a, only_b = self.distance_a[self.b < 0], self.distance_b[self.a < 0]
        beyond = not (only_a <= longest_b).any() and not (only_b <= longest_a).any()
        if beyond:
            return (
                "outlier rule",
                f"maximum distance: longest pair {longest_a:.4g} m against {longest_b:.4g} m ({counts})",
            )
        return "outlier rule", f"other pairs are kept, nearest neighbours agree ({counts})"

    def wrong(self) -> Told:
        """What is said of sides of which one does not take the nearest."""
        row = int(np.flatnonzero(self.farther)[0])
        near, far = self.distance_a[row], self.distance_b[row]
        side = "B" if far > near else "A"
        where = f"source point {row}: {near:.4g} m against {far:.4g} m"
        return (
            "different",
            f"{side} does not take the nearest neighbour ({where}, {int(self.farther.sum())} points in all)",
        )


def _another_start(question: Question, pairs: Ints) -> Told | None:
    """The wrong start whose nearest neighbours the pairs are, or exchanged clouds; None where none explains them."""
    source, target, guess = question.source.points, question.target.points, question.guess.row
    tree = cKDTree(target)
    found: list[tuple[float, Told]] = []
    if not _impossible(question, pairs):
        for mistake in in_start(guess):
            share = _nearest_share(tree, se2.transform(mistake.row, source), pairs)
            found.append((share, (mistake.kind, f"it starts elsewhere: {mistake.what}")))
    exchanged = pairs[:, ::-1]
    if not _beyond(exchanged, len(source), len(target)):
        for row in (guess, se2.inverse(guess)):
            share = _nearest_share(cKDTree(se2.transform(se2.inverse(row), source)), target, pairs)
            found.append((share, ("different", "target and source are exchanged")))
    share, best = max(found, key=lambda one: one[0], default=(0.0, None))
    return best if share >= NEARLY_ALL else None


def _nearest_share(tree: cKDTree, moved: Floats, pairs: Ints) -> float:
    if not len(pairs):
        return 0.0
    at = moved[pairs[:, 0]]
    nearest = np.asarray(tree.query(at)[0])
    distance = np.linalg.norm(at - tree.data[pairs[:, 1]], axis=1)
    return float(np.mean(distance <= nearest + 1e-9))


def _impossible(question: Question, pairs: Ints) -> str:
    """Why these cannot be pairs of this question, or ""."""
    if _beyond(pairs, len(question.source), len(question.target)):
        return "its pairs name points that are not there"
    if len(np.unique(pairs[:, 0])) < len(pairs):
        return "a source point has several partners"
    return ""


def _beyond(pairs: Ints, sources: int, targets: int) -> bool:
    return bool(len(pairs)) and bool(
        (pairs.min() < 0) | (pairs[:, 0].max() >= sources) | (pairs[:, 1].max() >= targets)
    )


def _shared(onto: Ints) -> int:
    """How many pairs share their target with another."""
    paired = onto[onto >= 0]
    return len(paired) - len(np.unique(paired))


def _ordered(pairs: Ints) -> Ints:
    return pairs[np.lexsort(pairs.T)]
