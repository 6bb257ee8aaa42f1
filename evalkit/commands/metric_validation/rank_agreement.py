"""Rank agreement of metrics without ground truth with the true error: Spearman's correlation with intervals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from evalkit import metrics
from evalkit.commands.metric_validation.map_rebuilding import CLEAN
from evalkit.core.se2 import Floats
from evalkit.metrics.metric import Metric
from evalkit.metrics.validated import RankAgreement
from evalkit.stats.intervals import CONFIDENCE, Interval
from evalkit.stats.ranks import spearman_correlation

ERROR = "ate_rmse_m"
DRAWS = 1000
MIN_MAPS = 4
"""Fewer maps have no correlation."""


@dataclass(frozen=True)
class MapScores:
    """One map: world, perturbation of its poses and its size, true error (m), and values by metric."""

    world: str
    perturbation: str
    size: float
    error_m: float
    scores: Mapping[str, float | None]


def reference_free_metrics() -> tuple[Metric, ...]:
    """Return the map metrics that need no ground truth."""
    return tuple(metric for metric in metrics.METRICS if metric.group == "map consistency")


def read_map_scores(world: str, perturbation: str, result: Mapping[str, Any]) -> list[MapScores]:
    """Return the maps in the result of a task; maps without a true error are omitted."""
    names = [metric.name for metric in reference_free_metrics()]
    return [
        MapScores(world, perturbation, row["size"], row[ERROR], {name: row[name] for name in names})
        for row in result["rows"]
        if row[ERROR] is not None
    ]


def compute_agreement(maps: Sequence[MapScores], rng: np.random.Generator) -> tuple[RankAgreement, ...]:
    """Return the rank agreement of every map metric without ground truth, the best first.

    If higher is better, the sign of the correlation is changed. Metrics without any correlation come last.
    """
    perturbations = [name for name in dict.fromkeys(row.perturbation for row in maps) if name != CLEAN]
    worlds = dict.fromkeys(row.world for row in maps)
    agreement = []
    for metric in reference_free_metrics():
        by_perturbation = {
            name: _correlate([row for row in maps if row.perturbation in (name, CLEAN)], metric, rng)
            for name in perturbations
        }
        by_world = {w: _correlate([row for row in maps if row.world == w], metric, rng) for w in worlds}
        overall = _correlate(maps, metric, rng)
        agreement.append(RankAgreement(metric.name, overall, by_perturbation, by_world))
    return tuple(sorted(agreement, key=lambda one: -np.inf if one.overall is None else one.overall.value, reverse=True))


def _correlate(maps: Iterable[MapScores], metric: Metric, rng: np.random.Generator) -> Interval | None:
    """Return the mean over worlds of the correlation within each; the interval resamples maps within their worlds."""
    worlds: dict[str, list[tuple[float, float]]] = {}
    for row in maps:
        value = row.scores[metric.name]
        if value is not None:
            worlds.setdefault(row.world, []).append((row.error_m, metric.sign * value))
    tables = [np.array(pairs).T for pairs in worlds.values() if len(pairs) >= MIN_MAPS]
    values = np.array([float(spearman_correlation(error, score)) for error, score in tables])
    if not np.isfinite(values).any():
        return None
    draws = np.array([_draw_correlations(error, score, rng) for error, score in tables])
    value = float(np.nanmean(values))
    means = np.nanmean(draws[np.isfinite(values)], axis=0)
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = np.nanquantile(means, [tail, 1.0 - tail])
    return Interval(value, min(float(low), value), max(float(high), value), sum(table.shape[1] for table in tables))


def _draw_correlations(error: Floats, score: Floats, rng: np.random.Generator) -> Floats:
    chosen = rng.integers(0, len(error), (DRAWS, len(error)))
    correlations = spearman_correlation(error[chosen], score[chosen])
    return np.where(np.isfinite(correlations), correlations, 0.0)  # a draw of equal maps has no correlation
