"""The metrics of trajectories and relations for the corrected poses of a SLAM, each beside that of its answers."""

from __future__ import annotations

from dataclasses import replace

from evalkit.core.run_result import Score
from evalkit.metrics import drift, pairs, relations, revisits, spans, trajectory
from evalkit.metrics.metric import NO_FINAL, Evidence, Metric

SAME_FOR_BOTH = ("answered_percent", "covered_percent", "relations_answered_percent")
"""Metrics of stamps alone: corrected poses have those of the answers."""


def make_final_metric(metric: Metric) -> Metric:
    """Return the metric of the corrected poses that corresponds to one of the answers; it is no headline metric."""

    def compute(evidence: Evidence) -> Score:
        return Score(None, reason=NO_FINAL) if evidence.final is None else metric.compute(evidence.final)

    return replace(
        metric,
        name=f"final_{metric.name}",
        label=f"{metric.label}, corrected poses",
        definition=f"Of the poses that a SLAM has at the end, after all corrections: {metric.definition}",
        compute=compute,
        headline=False,
        no_value=(NO_FINAL, *metric.no_value),
        slam_only=True,
        counterpart=metric.name,
    )


METRICS: tuple[Metric, ...] = tuple(
    make_final_metric(metric)
    for family in (trajectory, drift, pairs, relations, revisits, spans)
    for metric in family.METRICS
    if metric.name not in SAME_FOR_BOTH
)
