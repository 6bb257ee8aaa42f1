"""Nearest neighbours for ICP without asking or building a KD-tree more often than needed."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Generic, TypeVar
from weakref import ref

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Built = TypeVar("Built")


class Association:
    """The nearest target point of each point of a source that moves a little from call to call.

    Exact: a point keeps its neighbour unasked only while it has moved less than half the way by which the second
    nearest (or the limit) was farther; until then no other point can have come nearer (triangle inequality).
    """

    def __init__(self, tree: cKDTree, sources: int, limit_m: float = math.inf) -> None:
        self._tree, self._limit_m = tree, limit_m
        self._targets = np.asarray(tree.data)
        self._nearest = np.zeros(sources, dtype=np.int64)
        self._asked_at = np.zeros((sources, 2))
        self._slack = np.full(sources, -np.inf)  # how far a point may move before it must ask again; -inf: no neighbour

    def of(self, points: Floats) -> tuple[Ints, Floats]:
        """Target indices (N,) and distances (N,) in metres; inf where no target point is nearer than the limit."""
        stale = np.flatnonzero(_length(points - self._asked_at) >= self._slack)
        if len(stale):
            self._ask(stale, points.take(stale, axis=0))
        distance = _length(points - self._targets.take(self._nearest, axis=0))
        return self._nearest, np.where(self._slack == -np.inf, np.inf, distance)

    def _ask(self, rows: Ints, points: Floats) -> None:
        distances, nearest = map(np.asarray, self._tree.query(points, k=2, distance_upper_bound=self._limit_m))
        first, second = distances.T
        self._slack[rows] = 0.5 * (np.minimum(second, self._limit_m) - first)
        self._nearest[rows] = np.where(np.isfinite(first), nearest[:, 0], 0)
        self._asked_at[rows] = points


class Recent(Generic[Built]):
    """What was built over the last few clouds; the least recently used goes first."""

    def __init__(self, size: int = 4) -> None:
        self._kept: deque[tuple[ref[Cloud], Built]] = deque(maxlen=size)

    def of(self, cloud: Cloud, build: Callable[[Cloud], Built]) -> Built:
        """``build(cloud)``, or what it gave for the same cloud before."""
        entry = next((kept for kept in self._kept if kept[0]() is cloud), None)
        if entry is None:
            entry = ref(cloud), build(cloud)
        else:
            self._kept.remove(entry)
        self._kept.appendleft(entry)
        return entry[1]


def _length(vectors: Floats) -> Floats:
    x, y = vectors.T
    return np.asarray(np.sqrt(x * x + y * y))
