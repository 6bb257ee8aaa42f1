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

    Exact: a point keeps its neighbour without a query only while its distance to it, and how far it has moved since the
    query, are together less than the distance to all other points was then (triangle inequality).
    """

    def __init__(self, tree: cKDTree, sources: int, limit_m: float = math.inf) -> None:
        self._tree, self._limit_m = tree, limit_m
        self._targets = np.asarray(tree.data)
        self._nearest = np.zeros(sources, dtype=np.int64)
        self._query_points = np.zeros((sources, 2))
        self._others = np.full(sources, -np.inf)  # at the query: no other point is nearer; -inf: no neighbour

    def find(self, points: Floats) -> tuple[Ints, Floats]:
        """Return target indices (N,) and distances (N,) in metres; inf where no target point is within the limit."""
        distance = _length(points - self._targets.take(self._nearest, axis=0))
        stale = np.flatnonzero(distance + _length(points - self._query_points) >= self._others)
        if len(stale):
            distance[stale] = self._query(stale, points.take(stale, axis=0))
        return self._nearest, distance

    def _query(self, rows: Ints, points: Floats) -> Floats:
        distances, nearest = map(np.asarray, self._tree.query(points, k=2, distance_upper_bound=self._limit_m))
        first, second = distances.T
        found = np.isfinite(first)
        self._others[rows] = np.where(found, np.minimum(second, self._limit_m), -np.inf)
        self._nearest[rows] = np.where(found, nearest[:, 0], 0)
        self._query_points[rows] = points
        return np.asarray(first)


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
