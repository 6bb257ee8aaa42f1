"""The card of a metric: definition, source, limitations, and how far it follows the true error."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from evalkit.metrics.table import Metric
from evalkit.metrics.validated import shipped
from evalkit.stats.intervals import Interval

DIRECTIONS = {"lower": "lower is better", "higher": "higher is better", "": "neither direction is better"}


def card_as_json(metric: Metric) -> dict[str, Any]:
    """Return the card of a metric as JSON."""
    trust = shipped().of(metric.name)
    overall = None if trust is None or trust.overall is None else asdict(trust.overall)
    return {
        "name": metric.name, "label": metric.label, "unit": metric.unit, "better": metric.better,
        "group": metric.group, "definition": metric.definition, "source": metric.source,
        "limitations": metric.limitations, "support": metric.support, "no_value": list(metric.no_value),
        "follows_the_true_error": overall and {name: round(value, 4) for name, value in overall.items()},
    }  # fmt: skip


def card_lines(metric: Metric) -> list[str]:
    """Return the card of a metric as lines of text."""
    lines = [
        f"{metric.name}: {metric.label} [{metric.unit or '-'}], {DIRECTIONS[metric.better]}",
        f"  group       {metric.group}",
        f"  definition  {metric.definition}",
        f"  source      {metric.source}",
        f"  blind to    {metric.limitations}",
        f"  stands on   {metric.support or 'not given by its package'}",
        *(f"  no value    {reason}" for reason in metric.no_value),
    ]
    trust = shipped().of(metric.name)
    if trust is not None:
        parts = ", ".join(f"{name} {_number(one)}" for name, one in {**trust.by_way, **trust.by_world}.items())
        lines.append(f"  follows the true error (Spearman)  {_number(trust.overall)}: {parts}")
    return lines


def _number(found: Interval | None) -> str:
    return "-" if found is None else f"{found.value:.2f}"
