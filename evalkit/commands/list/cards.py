"""The card of a metric: definition, source, limitations, and how far it follows the true error."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from evalkit.metrics.metric import Metric
from evalkit.metrics.validated import load_validation
from evalkit.stats.intervals import Interval

DIRECTIONS = {"lower": "lower is better", "higher": "higher is better", "": "neither direction is better"}


def card_as_json(metric: Metric) -> dict[str, Any]:
    """Return the card of a metric as JSON."""
    agreement = load_validation().agreement_of(metric.name)
    overall = None if agreement is None or agreement.overall is None else asdict(agreement.overall)
    return {
        "name": metric.name, "label": metric.label, "unit": metric.unit, "better": metric.better,
        "group": metric.group, "definition": metric.definition, "source": metric.source,
        "limitations": metric.limitations, "support": metric.support, "no_value": list(metric.no_value),
        "follows_the_true_error": overall and {name: round(value, 4) for name, value in overall.items()},
    }  # fmt: skip


def card_facts(metric: Metric) -> list[tuple[str, str]]:
    """Return the card of a metric as pairs of a name and a text; texts may be empty."""
    unit = f" [{metric.unit}]" if metric.unit else ""
    return [
        ("What", f"{metric.label}{unit}, {DIRECTIONS[metric.better]}"),
        ("Group", metric.group),
        ("Definition", metric.definition),
        ("Source", metric.source),
        ("Limitations", metric.limitations),
        ("Support", metric.support),
        ("No value", "; ".join(metric.no_value)),
        ("Follows the true error", _correlations(metric.name)),
    ]


def _correlations(metric: str) -> str:
    """Return Spearman's correlation of a metric with the true error: overall, by perturbation and by world."""
    agreement = load_validation().agreement_of(metric)
    if agreement is None:
        return ""
    parts = ", ".join(
        f"{name} {_number(one)}" for name, one in {**agreement.by_perturbation, **agreement.by_world}.items()
    )
    overall = agreement.overall
    if overall is None:
        return parts
    return f"Spearman {overall.value:.2f} (95 %: {overall.low:.2f} to {overall.high:.2f}): {parts}"


def _number(found: Interval | None) -> str:
    return "-" if found is None else f"{found.value:.2f}"
