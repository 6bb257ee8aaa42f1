"""What a metric is, and what it may look at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from evalkit.se2 import Floats, Stamps
from evalkit.types import OccupancyGrid, Run, Scan, Score, Truth

Group = Literal["drift", "relations", "residuals", "runtime", "map against truth", "map consistency"]


@dataclass(frozen=True, eq=False)
class Matched:
    """Estimate and truth at the same times: ``stamps_ns`` (N,), both (N, 3) ``world_from_base``, estimate aligned."""

    stamps_ns: Stamps
    estimate: Floats
    truth: Floats
    alignment: str
    rule: str


@dataclass(frozen=True, eq=False)
class Evidence:
    """All a metric may look at. ``mapped``: the scans the map was made of (deskewed), with ``world_from_sensor``."""

    run: Run
    truth: Truth
    matched: Matched | None
    grid: OccupancyGrid | None
    mapped: tuple[tuple[Scan, Floats], ...]


@dataclass(frozen=True)
class Metric:
    """A metric's card and its function.

    ``better`` is "" where neither direction is better. ``digits``: decimals in tables. ``headline``: shown in the first
    table of a report. ``compute`` answers a Score and never raises for lack of evidence: it says why instead.
    """

    name: str
    label: str
    unit: str
    better: Literal["lower", "higher", ""]
    group: Group
    definition: str
    source: str
    blind_to: str
    compute: Callable[[Evidence], Score]
    digits: int = 3
    headline: bool = False
