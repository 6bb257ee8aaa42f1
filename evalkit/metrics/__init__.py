"""All metrics: pure functions of a run, listed in one table; start here to add a metric.

A metric is one function, one row of the ``METRICS`` table at the end of its module, and one card in ``cards/``. This
module joins these tables in the order of a report.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from evalkit.core.errors import NotInstalled
from evalkit.core.run_result import Score
from evalkit.metrics import (
    clouds,
    consistency,
    corrected_poses,
    drift,
    gaussians,
    images,
    landmarks,
    localisation,
    loop_closures,
    maps,
    occupancy,
    pairs,
    registration,
    relations,
    revisits,
    runtime,
    spans,
    surfaces,
    trajectory,
)
from evalkit.metrics.metric import MAP_GROUPS, Evidence, Metric
from evalkit.plugins import registry

METRICS: tuple[Metric, ...] = (
    *trajectory.METRICS,
    *drift.METRICS,
    *pairs.METRICS,
    *relations.METRICS,
    *revisits.METRICS,
    *spans.METRICS,
    *maps.METRICS,
    *gaussians.METRICS,
    *occupancy.METRICS,
    *images.METRICS,
    *landmarks.METRICS,
    *consistency.METRICS,
    *clouds.METRICS,
    *surfaces.METRICS,
    *registration.METRICS,
    *runtime.METRICS,
    *localisation.METRICS,
    *loop_closures.METRICS,
    *corrected_poses.METRICS,
)


def all_metrics() -> tuple[Metric, ...]:
    """Return the metrics of evalkit, followed by the entry points ``evalkit.metrics`` of other packages.

    Raises NotInstalled for one that does not load, or that has the name of another metric.
    """
    known = {metric.name: metric for metric in METRICS}
    for point in registry.names("metrics"):
        metric = registry.load("metrics", point, Metric)
        if metric.name in known:
            raise NotInstalled(point, f"there is another metric of the name {metric.name}", "rename it in its Metric")
        known[metric.name] = metric
    return tuple(known.values())


def compute_scores(evidence: Evidence, table: Iterable[Metric] = METRICS) -> dict[str, Score]:
    """Return the score of every metric by name, in the order of the table.

    The map of a SLAM is that of its corrected poses. A metric that raises an exception or returns no Score has a score
    without value, and that as its reason.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # a diverged estimate yields a score with a reason
        return {metric.name: _compute_score(metric, evidence) for metric in table}


def _compute_score(metric: Metric, evidence: Evidence) -> Score:
    if evidence.final is not None and metric.group in MAP_GROUPS:
        evidence = evidence.final
    try:
        score: object = metric.compute(evidence)
        if not isinstance(score, Score):
            raise TypeError(f"it returns a {type(score).__name__}, expected a Score")
        value = None if score.value is None else float(score.value)  # a NumPy number is not written to JSON
        return Score(value, int(score.support), score.reason)
    except Exception as error:  # noqa: BLE001 - a plug-in's metric must not prevent the other scores
        return Score(None, reason=f"could not be computed: {type(error).__name__}: {error}")
