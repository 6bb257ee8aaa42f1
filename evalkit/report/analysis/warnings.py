"""What a verdict has to be read with: no truth, one run, damaged data, scans left to the guess."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence

from evalkit.metrics.table import Metric
from evalkit.metrics.validated import shipped
from evalkit.report.analysis.cells import MAX_GUESSED
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.map_agreement import by_maps
from evalkit.report.analysis.standings import Standing, guessed_percent
from evalkit.report.html.formatting import bounds, joined, plain
from evalkit.results.run_record import RunRecord

# Notes that tell of scans that never reached anybody; readers name them by these words.
LOST_SCANS = re.compile(r"^(?!reference).*\b(damaged|skipped|dropped)\b|^scans .*left out")
MAX_LOST_PERCENT = 1.0

NAMED_GUESSED = 10.0
"""From this share of scans (%) left to the guess on, a method is named."""


def of_evidence(found: Standing) -> list[str]:
    """What the deciding metric cannot tell: sentences."""
    caveats = []
    if by_maps(found):
        blind = plain(found.metric.limitations)
        caveats.append(f"There is no truth here: {found.metric.label} compares maps only, and is blind to {blind}.")
        caveats += _trust(found.metric)
    if found.ranked and not found.repeated:
        caveats.append("One run each: how much repetitions would differ is not known.")
    return caveats


def _trust(metric: Metric) -> list[str]:
    """A sentence on how far a metric without a truth followed the true error where that was known."""
    trust = shipped().of(metric.name)
    if trust is None or trust.overall is None:
        return []
    found = trust.overall
    return [
        f"Of {found.support} maps with a known error it ranked with a Spearman correlation of {found.value:.2f} "
        f"(95\u00a0% interval {bounds(found, 2)})."
    ]


def of_data(records: Sequence[RunRecord]) -> str:
    """A sentence on scans that were damaged or left out, if they are more than 1 % of a run's scans; else ""."""
    worst: dict[str, tuple[int, float]] = {}
    for record in records:
        for name, count in record.result.notes.items():
            percent = 100.0 * count / max(record.result.expected, 1)
            if LOST_SCANS.search(name) and percent > worst.get(name, (0, MAX_LOST_PERCENT))[1]:
                worst[name] = (int(count), percent)
    if not worst:
        return ""
    listed = joined(f"{count:,} {name} ({percent:.0f} % of the scans)" for name, (count, percent) in worst.items())
    return f"The data are damaged: {listed}."


def of_times(records: Sequence[RunRecord]) -> str:
    """A sentence on times that were measured on different processors, which no ranking can compare; else ""."""
    timed = [record for record in records if len(record.result.steps) and record.result.steps["wall_ns"].any()]
    by_processor: dict[str, list[str]] = defaultdict(list)
    for record in timed:
        by_processor[str(record.result.provenance.get("processor", "")) or "a processor nobody noted"].append(
            record.method
        )
    if len(by_processor) < 2:
        return ""
    who = joined(f"those of {joined(dict.fromkeys(them))} on {where}" for where, them in sorted(by_processor.items()))
    return f"Times were not all measured on one kind of processor, and no order by time holds: {who}."


def of_guesses(comparison: Comparison, sequence: str) -> str:
    """Sentences on who left more than 10 % of the scans to the guess, and who cannot be ranked for it; else ""."""
    grouped = comparison.by_method(sequence).items()
    shares = {who: guessed_percent([t for t in own if t.result.is_complete]) for who, own in grouped}
    named = {who: share for who, share in shares.items() if share > NAMED_GUESSED}
    if not named:
        return ""
    said = f"{joined(f'{who} left {share:.0f} % of the scans to the guess' for who, share in named.items())}."
    unranked = [who for who, share in named.items() if share > MAX_GUESSED]
    return f"{said} {joined(unranked)} registered too little to be ranked." if unranked else said
