"""The reference page of the metrics, generated from the tables of metrics."""

from __future__ import annotations

from evalkit.commands.list.cards import card_facts
from evalkit.metrics import all_metrics
from evalkit.metrics.validated import load_validation
from evalkit_docs.markup import code, facts, heading, page, text

LEAD = """\
The definition of every metric, its source, its **limitations**, the samples it is computed from (support), and the
reasons for which it has no value. `evalkit list NAME` prints the same card. Times are per scan. How to read the metrics
together: [Read the report](../report.md)."""


def write_metrics() -> str:
    """Return the page with a card for every metric, by group (Markdown)."""
    metrics = all_metrics()
    parts = ["# Metrics", LEAD, _describe_validation()]
    for group in dict.fromkeys(metric.group for metric in metrics):
        parts.append(f"## {group.capitalize()}")
        for metric in metrics:
            if metric.group == group:
                rows = [(name, text(value)) for name, value in card_facts(metric) if name != "Group"]
                parts.append(page(heading(3, metric.name, metric.name), facts(rows)).rstrip())
    return page(*parts)


def _describe_validation() -> str:
    validation = load_validation()
    return (
        f"*Follows the true error* is Spearman's rank correlation with the true error, over {validation.map_count} "
        f"maps from perturbed trajectories (worlds: {', '.join(validation.worlds)}; measured {validation.created} by "
        f"{code(validation.command)}): 1 means that the metric ranks maps like the true error, 0 that it does not."
    )
