"""What a metric is, and what it may look at."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import wraps
from typing import Literal, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.run_result import RunResult, Score
from evalkit.core.scan import Scan
from evalkit.core.se2 import Floats, Stamps

Group = Literal["drift", "relations", "residuals", "runtime", "map against truth", "map consistency"]
PlacedScan = tuple[Scan, Floats]
"""A scan, deskewed, and ``world_from_sensor`` (3,)."""

PlacedScans = tuple[PlacedScan, ...]


@dataclass(frozen=True, eq=False)
class MatchedPoses:
    """Estimate and truth at the same times: ``stamps_ns`` (N,), both (N, 3) ``world_from_base``, estimate aligned.

    ``world_from_start``: the alignment. ``alignment`` and ``rule`` say in words how it was found and what was matched.
    """

    stamps_ns: Stamps
    estimate: Floats
    truth: Floats
    alignment: str
    rule: str
    world_from_start: Pose = field(default_factory=Pose)


@dataclass(frozen=True, eq=False)
class Evidence:
    """All a metric may look at.

    ``matched``: what ``trajectory.match`` answers; a text says why there is none, None: there is no true trajectory.
    ``grid``: the map of the estimated trajectory, in the world frame. ``mapped``: the scans it was made of (deskewed),
    with ``world_from_sensor``, in the order of time. ``first_half``, ``second_half``: maps by the same mapper of
    ``mapped[:n]`` and ``mapped[n:]``, n = len(mapped) // 2. ``no_grid``: why there is no map where ``grid`` is None.
    ``successive``: pairs of a scan and the very next one of the sequence, evenly spaced over it.
    """

    run: RunResult
    truth: Truth
    matched: MatchedPoses | str | None
    grid: OccupancyGrid | None
    mapped: PlacedScans
    first_half: OccupancyGrid | None = None
    second_half: OccupancyGrid | None = None
    no_grid: str = "the run answered no scan"
    successive: tuple[tuple[PlacedScan, PlacedScan], ...] = ()


@dataclass(frozen=True)
class Metric:
    """A metric's card and its function.

    ``better`` is "" where neither direction is better. ``limitations`` completes "it is blind to ...". ``digits``:
    decimals in tables. ``headline``: shown in the first table of a report. ``compute`` answers a Score and never raises
    for lack of evidence: it says why instead. ``support``: what the number stands on; the score tells how many.
    ``no_value``: the reasons it gives for having none; "..." stands for what differs from case to case.
    """

    name: str
    label: str
    unit: str
    better: Literal["lower", "higher", ""]
    group: Group
    definition: str
    source: str
    limitations: str
    compute: Callable[[Evidence], Score]
    digits: int = 3
    headline: bool = False
    support: str = ""
    no_value: tuple[str, ...] = ()


DIVERGED = "not finite: the estimate has diverged"

Standing = Mapping[str, tuple[str, tuple[str, ...]]]
"""What metrics stand on and why they may have no value, by pattern of their names ("ate_*")."""


def with_support(metrics: Iterable[Metric], told: Standing) -> tuple[Metric, ...]:
    """The metrics with ``support`` and ``no_value`` of the first pattern that their name fits, if one does."""

    def one(metric: Metric) -> Metric:
        found = next((told[pattern] for pattern in told if fnmatchcase(metric.name, pattern)), None)
        return metric if found is None else replace(metric, support=found[0], no_value=found[1])

    return tuple(map(one, metrics))


Found = TypeVar("Found")


def cached(look: Callable[[Evidence], Found]) -> Callable[[Evidence], Found]:
    """The same look at evidence, taken once however many metrics share it, and forgotten with the evidence."""
    taken: WeakKeyDictionary[Evidence, Found] = WeakKeyDictionary()

    @wraps(look)
    def looked(evidence: Evidence) -> Found:
        if evidence not in taken:
            taken[evidence] = look(evidence)
        return taken[evidence]

    return looked


def make_score(value: float | np.floating, support: int) -> Score:
    """The score of a computed number; without value where the estimate is so far off that it is not finite."""
    if not np.isfinite(value):
        return Score(None, support, DIVERGED)
    return Score(float(value), support)
