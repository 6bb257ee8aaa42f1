"""The page of every metric, from the METRICS tables and their cards."""

from __future__ import annotations

from evalkit.metrics import all_metrics
from evalkit.metrics.table import Metric
from evalkit.metrics.validated import Trust, shipped
from evalkit.stats.intervals import Interval
from evalkit_docs.markup import code, facts, heading, page, text

ARROWS = {"lower": "lower is better", "higher": "higher is better", "": "neither direction is better"}
LEAD = """\
Names collide in the field, so here is what each number is, what it is **blind to**, what it stands on, and when it has
no value. `evalkit metrics show NAME` prints the same card. Metres, radians and degrees stand in the unit; times are of
one scan. How to read them together: [Read the report](../report.md)."""


def metrics() -> str:
    """Markdown: a card for every metric, by group."""
    every = all_metrics()
    parts = ["# Metrics", LEAD, _trust_told()]
    for group in dict.fromkeys(metric.group for metric in every):
        parts.append(f"## {group.capitalize()}")
        parts += [_card(metric) for metric in every if metric.group == group]
    return page(*parts)


def _card(metric: Metric) -> str:
    unit = f" [{metric.unit}]" if metric.unit else ""
    rows = [
        ("What", text(f"{metric.label}{unit}, {ARROWS[metric.better]}")),
        ("Definition", text(metric.definition)),
        ("Source", text(metric.source)),
        ("Blind to", text(metric.limitations)),
        ("Stands on", text(metric.support)),
        ("No value", "<br>".join(map(text, metric.no_value))),
        ("Follows the true error", _follows(shipped().of(metric.name))),
    ]
    return page(heading(3, metric.name, metric.name), facts(rows)).rstrip()


def _follows(trust: Trust | None) -> str:
    if trust is None:
        return ""
    apart = {**trust.by_way, **trust.by_world}
    told = ", ".join(f"{name} {_number(found)}" for name, found in apart.items())
    if trust.overall is None:
        return text(told)
    return text(f"{trust.overall.value:.2f} (95 %: {trust.overall.low:.2f} to {trust.overall.high:.2f}); {told}")


def _number(found: Interval | None) -> str:
    return "-" if found is None else f"{found.value:.2f}"


def _trust_told() -> str:
    measured = shipped()
    return (
        f"*Follows the true error* is Spearman's correlation with the true error over {measured.maps} maps that were "
        f"spoiled in known ways (worlds: {', '.join(measured.worlds)}; measured {measured.made} by "
        f"{code(measured.command)}): 1 ranks maps as the truth does, 0 knows nothing of it."
    )
