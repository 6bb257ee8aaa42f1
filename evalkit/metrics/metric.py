"""The types of a metric: its card, its input, helpers for METRICS tables. To add a metric, see ``evalkit.metrics``."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import wraps
from importlib.resources import files
from typing import Any, Literal, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.known_map import KnownMap
from evalkit.core.pose import Pose
from evalkit.core.run_result import RunResult, Score
from evalkit.core.scan import Scan
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory

Group = Literal[
    "drift",
    "relations",
    "loop closures",
    "residuals",
    "runtime",
    "localisation",
    "map against truth",
    "map consistency",
]
MAP_GROUPS: tuple[Group, ...] = ("map against truth", "map consistency")
PlacedScan = tuple[Scan, Floats]
"""A deskewed scan and ``world_from_sensor`` (3,)."""

PlacedScans = tuple[PlacedScan, ...]

NO_POSES = "the run has no poses"
NO_TRUE_TRAJECTORY = "no ground-truth trajectory"
NO_FINAL = "the method does not correct earlier poses"
NO_TRUE_MAP = "no ground-truth map"
NO_KNOWN_MAP = "no known map"
DIVERGED = "not finite: the estimate has diverged"


@dataclass(frozen=True, eq=False)
class MatchedPoses:
    """Estimate and ground truth at the same times.

    ``stamps_ns`` (N,). ``estimate``, ``truth``: ``world_from_base`` (N, 3), the estimate aligned. ``alignment``,
    ``rule``: the alignment method and the matching rule, in words.
    ``world_from_start``: the alignment. ``is_in_map``: it was not fitted, the world is the known map.
    """

    stamps_ns: Stamps
    estimate: Floats
    truth: Floats
    alignment: str
    rule: str
    world_from_start: Pose = field(default_factory=Pose)
    is_in_map: bool = False


@dataclass(frozen=True)
class Unmatched:
    """Estimate and ground truth could not be matched, and the reason."""

    reason: str


@dataclass(frozen=True)
class MissingMap:
    """A run without a map, and the reason."""

    reason: str


@dataclass(frozen=True, eq=False)
class Evidence:
    """The input of every metric.

    ``matched``: the result of ``trajectory.match_trajectories``. ``grid``: the map of the estimated trajectory, in the
    world frame. ``mapped``: the deskewed scans in that map with ``world_from_sensor``, in the order of time.
    ``first_half``, ``second_half``: maps of ``mapped[:n]`` and ``mapped[n:]``, n = len(mapped) // 2, by the same
    mapper. ``successive``: pairs of a scan and the next scan of the sequence, evenly spaced over the sequence.
    ``odometry``: the wheel odometry of the scans, None if there is none or if it was not read. ``known_map``:
    in which the methods tracked the robot. ``final``: of a SLAM,
    the same for its corrected poses; then only ``final`` has maps, and the map metrics are computed from it.
    """

    run: RunResult
    truth: Truth
    matched: MatchedPoses | Unmatched = Unmatched(NO_TRUE_TRAJECTORY)
    grid: OccupancyGrid | MissingMap = MissingMap(NO_POSES)
    mapped: PlacedScans = ()
    first_half: OccupancyGrid | MissingMap = MissingMap(NO_POSES)
    second_half: OccupancyGrid | MissingMap = MissingMap(NO_POSES)
    successive: tuple[tuple[PlacedScan, PlacedScan], ...] = ()
    odometry: Trajectory | None = None
    known_map: KnownMap | None = None
    final: Evidence | None = None


@dataclass(frozen=True)
class Metric:
    """The card of a metric and its function.

    ``better``: the better direction, "" if there is none. ``limitations``: errors that the metric does not show, a list
    that completes "does not show: ...". ``digits``: decimals in tables. ``headline``: part of the first table of a
    report. ``compute``: returns a Score; without sufficient evidence, a Score without value and with the reason.
    ``support``: what the support of a score counts. ``no_value``: the possible reasons for a missing value; "..."
    stands for the variable part. ``slam_only``: only methods that correct earlier poses have a value. ``counterpart``:
    of a metric of corrected poses, the name of the same metric of the answers; else "".
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
    slam_only: bool = False
    counterpart: str = ""

    @property
    def sign(self) -> float:
        """The sign that makes smaller products with a value the better ones."""
        return -1.0 if self.better == "higher" else 1.0


def make_metrics(
    family: str, functions: Mapping[str, Callable[[Evidence], Score]], **constants: float | str
) -> tuple[Metric, ...]:
    """Return the metrics of a family in the order of ``functions``, with their cards from ``cards/FAMILY.toml``.

    ``functions``: by the name of the metric. ``constants``: numbers and texts that the cards name in braces. Raises
    KeyError for a metric without a card or a card without a function.
    """
    content: dict[str, dict[str, Any]] = tomllib.loads(
        files("evalkit.metrics").joinpath("cards", f"{family}.toml").read_text(encoding="utf-8")
    )
    shared = content.pop("*", {})
    if unknown := content.keys() - functions.keys():
        raise KeyError(f"cards/{family}.toml: no function for {', '.join(sorted(unknown))}")

    def fill(value: Any) -> Any:
        if isinstance(value, list):
            return tuple(value)
        return " ".join(value.split()).format(**constants) if isinstance(value, str) else value

    return tuple(
        Metric(name, compute=compute, **{key: fill(value) for key, value in {**shared, **content[name]}.items()})
        for name, compute in functions.items()
    )


Given = TypeVar("Given", Evidence, OccupancyGrid)
Computed = TypeVar("Computed")


def cached(compute: Callable[[Given], Computed]) -> Callable[[Given], Computed]:
    """Cache a function of the evidence, or of a map; the value is released together with it."""
    values: WeakKeyDictionary[Given, Computed] = WeakKeyDictionary()

    @wraps(compute)
    def cached_compute(given: Given) -> Computed:
        if given not in values:
            values[given] = compute(given)
        return values[given]

    return cached_compute


@cached
def find_occupied(grid: OccupancyGrid) -> Bools:
    """Return the occupied cells (H, W) of a map, read-only, computed once for all metrics."""
    occupied = grid.occupied()
    occupied.flags.writeable = False
    return occupied


@cached
def find_probabilities(grid: OccupancyGrid) -> Floats:
    """Return the probability of occupancy (H, W) of a map, read-only, computed once for all metrics."""
    probabilities = grid.probability()
    probabilities.flags.writeable = False
    return probabilities


@cached
def find_surprises(grid: OccupancyGrid) -> Floats:
    """Return -ln p of the likelier state of each cell (H, W) of a map (nat), read-only, computed once for all metrics.

    The other state has |log-odds| more.
    """
    p = find_probabilities(grid)
    surprises = -np.log(np.maximum(p, 1.0 - p))
    surprises.flags.writeable = False
    return surprises


def place_hits(placed: PlacedScan) -> Floats:
    """Return the hits (N, 2) of a scan in the world (m), read-only; kept while the scan exists, for the last pose."""
    scan, world_from_sensor = placed
    kept = _PLACED_HITS.get(scan)
    if kept is None or not np.array_equal(kept[0], world_from_sensor):
        hits = se2.transform(world_from_sensor, scan.points())
        hits.flags.writeable = False
        _PLACED_HITS[scan] = kept = np.array(world_from_sensor), hits
    return kept[1]


_PLACED_HITS: WeakKeyDictionary[Scan, tuple[Floats, Floats]] = WeakKeyDictionary()


def make_score(value: float | np.floating, support: int, not_finite: str = DIVERGED) -> Score:
    """Return the score of a computed number; without value and with the reason ``not_finite`` if it is not finite."""
    if not np.isfinite(value):
        return Score(None, support, not_finite)
    return Score(float(value), support)


def with_grid(measure: Callable[[OccupancyGrid], Score]) -> Callable[[Evidence], Score]:
    """Return ``measure`` of the map as a function of the evidence; no value without a map."""

    def compute(evidence: Evidence) -> Score:
        if isinstance(evidence.grid, MissingMap):
            return Score(None, reason=f"no map: {evidence.grid.reason}")
        return measure(evidence.grid)

    return compute


def with_true_grid(measure: Callable[[OccupancyGrid, OccupancyGrid], Score]) -> Callable[[Evidence], Score]:
    """Return ``measure`` of the map and the ground-truth map as a function of the evidence; no value without both."""

    def compute(evidence: Evidence) -> Score:
        true = evidence.truth.grid
        if true is None:
            return Score(None, reason=NO_TRUE_MAP)
        return with_grid(lambda mapped: measure(mapped, true))(evidence)

    return compute
