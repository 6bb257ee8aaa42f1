"""Nearest neighbours for ICP with few queries and few KD-tree builds."""

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

    Exact: a point keeps its neighbour without a query only while it has moved less than half the distance by which the
    second nearest point (or the limit) was farther; until then no other point can be nearer (triangle inequality).
    """

    def __init__(self, tree: cKDTree, sources: int, limit_m: float = math.inf) -> None:
        self._tree, self._limit_m = tree, limit_m
        self._targets = np.asarray(tree.data)
        self._nearest = np.zeros(sources, dtype=np.int64)
        self._query_points = np.zeros((sources, 2))
        self._slack = np.full(sources, -np.inf)  # how far a point may move before its next query; -inf: no neighbour

    def find(self, points: Floats) -> tuple[Ints, Floats]:
        """Return target indices (N,) and distances (N,) in metres; inf where no target point is within the limit."""
        stale = np.flatnonzero(_length(points - self._query_points) >= self._slack)
        if len(stale):
            self._query(stale, points.take(stale, axis=0))
        distance = _length(points - self._targets.take(self._nearest, axis=0))
        return self._nearest, np.where(self._slack == -np.inf, np.inf, distance)

    def _query(self, rows: Ints, points: Floats) -> None:
        distances, nearest = map(np.asarray, self._tree.query(points, k=2, distance_upper_bound=self._limit_m))
        first, second = distances.T
        self._slack[rows] = 0.5 * (np.minimum(second, self._limit_m) - first)
        self._nearest[rows] = np.where(np.isfinite(first), nearest[:, 0], 0)
        self._query_points[rows] = points


class CloudCache(Generic[Built]):
    """Cache of values built from the last few clouds; the least recently used entry is dropped first."""

    def __init__(self, size: int = 4) -> None:
        self._kept: deque[tuple[ref[Cloud], Built]] = deque(maxlen=size)

    def get(self, cloud: Cloud, build: Callable[[Cloud], Built]) -> Built:
        """Return ``build(cloud)``, from the cache if the same cloud object was used before."""
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
