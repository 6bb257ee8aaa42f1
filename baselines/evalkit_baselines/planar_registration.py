"""What the adapters of 3D registration libraries share: cached clouds, two clocks, and results that are rejected."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.core.timing import Cost, Stopwatch
from evalkit.odometry import planar3d

MIN_PAIRS = 3  # two pairs always fit a planar pose exactly

_prepared: WeakKeyDictionary[Cloud, dict[Hashable, Any]] = WeakKeyDictionary()
"""What was made for a cloud, by its key: both stages and the next scan use it. Clouds are frozen, so it stays valid."""


@dataclass(frozen=True)
class AdapterClocks:
    """CPU time of one registration in the adapter: conversion of values, and preparation (normals, covariances)."""

    conversion: Stopwatch = field(default_factory=Stopwatch)
    preparation: Stopwatch = field(default_factory=Stopwatch)

    @property
    def cost(self) -> Cost:
        """The cost to report."""
        return Cost(self.conversion.cpu_ns, preparation_ns=self.preparation.cpu_ns)


class LibraryAnswer(NamedTuple):
    """Answer of a library: matrix (4, 4) ``target_from_source``, number of pairs, error (m), and how it ended."""

    matrix: Floats
    pairs: int
    error: float
    converged: bool = True
    iterations: int = 0


Prepare = Callable[[Cloud, AdapterClocks], Any]
"""Makes the library's form of a cloud."""


def keep_prepared(key: Hashable, make: Prepare) -> Prepare:
    """The same ``make`` with its results kept as long as the cloud; ``key`` holds all settings they depend on."""

    def look_up(cloud: Cloud, clocks: AdapterClocks) -> Any:
        known = _prepared.setdefault(cloud, {})
        if key not in known:
            known[key] = make(cloud, clocks)
        return known[key]

    return look_up


@dataclass(frozen=True)
class PlanarRegistration:
    """A Registration by a 3D library on clouds at z = 0: ``align`` gets both prepared clouds and the guess (4, 4)."""

    target: Prepare
    source: Prepare
    align: Callable[[Any, Any, Floats], LibraryAnswer]

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``.

        Not converged, with the guess as the answer, where fewer than three points have a partner or where the result
        left the plane: pairs on one line let a rotation by half a turn about that line fit as well.
        """
        clocks = AdapterClocks()
        if min(len(target), len(source)) < MIN_PAIRS:
            return Match.not_converged(guess, 0, clocks.cost)
        fixed, moving = self.target(target, clocks), self.source(source, clocks)
        with clocks.conversion:
            initial = planar3d.matrix_4x4(guess)
        found = self.align(fixed, moving, initial)
        if found.pairs < MIN_PAIRS:
            return Match.not_converged(guess, found.pairs, clocks.cost)
        try:
            with clocks.conversion:
                answer = planar3d.pose_2d(found.matrix)
        except ValueError:  # left the plane
            return Match.not_converged(guess, 0, clocks.cost)
        return Match(answer, found.converged, found.iterations, found.error, found.pairs, cost=clocks.cost)
