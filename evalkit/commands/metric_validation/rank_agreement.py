"""How well a metric without a truth ranks maps as their true error does: Spearman's correlation, with intervals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from evalkit import metrics
from evalkit.commands.metric_validation.map_rebuilding import CLEAN
from evalkit.core.se2 import Floats
from evalkit.metrics.table import Metric
from evalkit.stats.intervals import CONFIDENCE, Interval

ERROR = "ate_rmse_m"
DRAWS = 1000
FEWEST = 4
"""Ranks of fewer maps say nothing."""


@dataclass(frozen=True)
class Row:
    """One map: the world, how and how much its poses were spoiled, its true error (m) and its scores by metric."""

    world: str
    way: str
    size: float
    error_m: float
    scores: Mapping[str, float | None]


@dataclass(frozen=True)
class Rank:
    """How a metric ranks maps as the true error does: 1 exactly so, 0 not at all, -1 the wrong way round.

    ``overall`` and ``by_way``: the mean over worlds of Spearman's correlation within each, None where it has none;
    ``by_world``: each world's own.
    ``flipped``: higher is better, so the correlation's sign was changed.
    """

    metric: str
    overall: Interval | None
    by_way: Mapping[str, Interval | None]
    by_world: Mapping[str, Interval | None]
    flipped: bool = False


def reference_free() -> tuple[Metric, ...]:
    """The map metrics that need no truth: what has to be trusted."""
    return tuple(metric for metric in metrics.METRICS if metric.group == "map consistency")


def rows_of(world: str, way: str, result: Mapping[str, Any]) -> list[Row]:
    """The rows of a job's result; those without a true error are left out."""
    names = [metric.name for metric in reference_free()]
    return [
        Row(world, way, row["size"], row[ERROR], {name: row[name] for name in names})
        for row in result["rows"]
        if row[ERROR] is not None
    ]


def ranks(rows: Sequence[Row], rng: np.random.Generator) -> tuple[Rank, ...]:
    """Every reference-free map metric, the best first; a metric without any correlation comes last."""
    ways = [way for way in dict.fromkeys(row.way for row in rows) if way != CLEAN]
    worlds = dict.fromkeys(row.world for row in rows)
    found = []
    for metric in reference_free():
        sign = -1.0 if metric.better == "higher" else 1.0
        by_way = {way: _correlation([r for r in rows if r.way in (way, CLEAN)], metric.name, sign, rng) for way in ways}
        by_world = {w: _correlation([r for r in rows if r.world == w], metric.name, sign, rng) for w in worlds}
        overall = _correlation(rows, metric.name, sign, rng)
        found.append(Rank(metric.name, overall, by_way, by_world, sign < 0.0))
    return tuple(sorted(found, key=lambda rank: -np.inf if rank.overall is None else rank.overall.value, reverse=True))


def spearman(a: Floats, b: Floats) -> Floats:
    """Spearman's rank correlation (...,) along the last axis of series (..., N); nan where one has no differences."""
    one, other = (stats.rankdata(series, axis=-1) for series in (a, b))
    one = one - one.mean(axis=-1, keepdims=True)
    other = other - other.mean(axis=-1, keepdims=True)
    sizes = np.sqrt((one**2).sum(axis=-1) * (other**2).sum(axis=-1))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(sizes > 0.0, (one * other).sum(axis=-1) / sizes, np.nan))


def _correlation(rows: Iterable[Row], metric: str, sign: float, rng: np.random.Generator) -> Interval | None:
    """Mean over worlds of the correlation within each; maps are drawn again within their worlds for the interval."""
    worlds: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        value = row.scores[metric]
        if value is not None:
            worlds.setdefault(row.world, []).append((row.error_m, sign * value))
    tables = [np.array(pairs).T for pairs in worlds.values() if len(pairs) >= FEWEST]
    values = np.array([float(spearman(error, score)) for error, score in tables])
    if not np.isfinite(values).any():
        return None
    drawn = np.array([_drawn(error, score, rng) for error, score in tables])
    value = float(np.nanmean(values))
    means = np.nanmean(drawn[np.isfinite(values)], axis=0)
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.nanquantile(means, [tail, 1.0 - tail])
    return Interval(value, min(float(low), value), max(float(high), value), sum(table.shape[1] for table in tables))


def _drawn(error: Floats, score: Floats, rng: np.random.Generator) -> Floats:
    chosen = rng.integers(0, len(error), (DRAWS, len(error)))
    found = spearman(error[chosen], score[chosen])
    return np.where(np.isfinite(found), found, 0.0)  # a draw of one map only says nothing
