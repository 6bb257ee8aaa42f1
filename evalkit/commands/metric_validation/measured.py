"""The trust in metrics, measured: jobs over worlds and ways to go wrong, and what they show, as one JSON value."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from evalkit.commands.metric_validation import fault_injection, map_rebuilding, rank_agreement
from evalkit.commands.metric_validation.fault_injection import NO_MISTAKE, PLANTS, Sighting
from evalkit.commands.metric_validation.map_rebuilding import CLEAN
from evalkit.commands.metric_validation.perturbation import WAYS
from evalkit.commands.metric_validation.rank_agreement import Row
from evalkit.execution.task import AnyTask, Result
from evalkit.stats.intervals import Interval

WORLDS = ("lab", "office", "room")
SCANS = 150

PILOT = {
    "map_entropy": 0.94,
    "wall_thickness_m": 0.93,
    "split_distance_m": 0.93,
    "cleared_percent": 0.90,
    "mme_nat": 0.84,
    "enclosed_areas": 0.64,
    "corners": 0.56,
    "occupied_percent": -0.33,
}
"""An earlier measurement by other code: one synthetic office, 64 trajectories, all ways together."""


@dataclass(frozen=True)
class Asked:
    """What is measured: worlds by name, sizes of every way, mapper and scans; ``plants_in``: the world of mistakes."""

    worlds: tuple[str, ...] = WORLDS
    sizes: int = 5
    seed: int = 0
    mapper: str = "log-odds"
    scans: int = SCANS
    plants_in: str = "lab"


def jobs(asked: Asked) -> list[AnyTask]:
    """A job for every world and way, and for every planted mistake."""
    return [*_spoiling(asked), *planting(asked)]


def planting(asked: Asked) -> list[AnyTask]:
    """A job for every planted mistake, and for the run without one."""
    at = (asked.plants_in, asked.seed, asked.mapper, asked.scans)
    return [fault_injection.job(plant, *at) for plant in (NO_MISTAKE, *PLANTS)]


def _spoiling(asked: Asked) -> list[AnyTask]:
    return [
        map_rebuilding.job(world, way, sizes(way, asked.sizes), asked.seed, asked.mapper, asked.scans)
        for world in asked.worlds
        for way in (CLEAN, *WAYS)
    ]


def sizes(way: str, count: int) -> tuple[float, ...]:
    """So many of a way's sizes, the smallest and the largest among them."""
    if way == CLEAN:
        return ()
    every = WAYS[way].sizes
    return tuple(
        every[i] for i in np.unique(np.linspace(0, len(every) - 1, min(count, len(every))).round().astype(int))
    )


def rows(asked: Asked, results: Mapping[str, Result]) -> list[Row]:
    """Every map that was made, world by world."""
    return [
        row
        for world in asked.worlds
        for way in (CLEAN, *WAYS)
        for row in rank_agreement.rows_of(world, way, results[f"{world} {way}"])
    ]


def sightings(results: Mapping[str, Result]) -> dict[str, tuple[Sighting, ...]]:
    """The metrics that show each mistake, the plainest first."""
    without = results[f"planted {NO_MISTAKE}"]["scores"]
    return {plant: fault_injection.sightings(without, results[f"planted {plant}"]["scores"]) for plant in PLANTS}


def record(asked: Asked, results: Mapping[str, Result], made: Mapping[str, Any]) -> dict[str, Any]:
    """The JSON form; ``made`` tells command, date and versions."""
    every = rows(asked, results)
    found = rank_agreement.ranks(every, np.random.default_rng(asked.seed))
    return {
        "schema": {"name": "evalkit-metrics-validated", "version": 1},
        **made,
        **asdict(asked),
        "swift": map_rebuilding.SWIFT,
        "ways": {
            name: {"what": way.what, "unit": way.unit, "sizes": sizes(name, asked.sizes)} for name, way in WAYS.items()
        },
        "trust": [_trust(rank) for rank in found],
        "planted": [told(name, seen) for name, seen in sightings(results).items()],
        "rows": [asdict(row) for row in every],
    }


def as_csv(every: Sequence[Row]) -> str:
    """A line for each map."""
    names = [metric.name for metric in rank_agreement.reference_free()]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["world", "way", "size", rank_agreement.ERROR, *names])
    for row in every:
        writer.writerow([row.world, row.way, row.size, row.error_m, *(row.scores[name] for name in names)])
    return out.getvalue()


def _trust(rank: rank_agreement.Rank) -> dict[str, Any]:
    return {
        "metric": rank.metric,
        "overall": interval(rank.overall),
        "by_way": {way: interval(one) for way, one in rank.by_way.items()},
        "by_world": {world: interval(one) for world, one in rank.by_world.items()},
        "flipped": rank.flipped,
    }


def told(name: str, seen: Sequence[Sighting]) -> dict[str, Any]:
    """A planted mistake and the metrics that caught it, as JSON."""
    caught = [
        {"metric": s.metric.name, "without": s.without, "planted": s.planted, "factor": s.factor}
        for s in seen
        if s.factor >= fault_injection.CAUGHT
    ]
    return {"plant": name, "what": PLANTS[name].what, "caught": bool(caught), "seen": caught}


def interval(found: Interval | None) -> dict[str, float] | None:
    """An interval as JSON, to four decimals."""
    return None if found is None else {name: round(value, 4) for name, value in asdict(found).items()}
