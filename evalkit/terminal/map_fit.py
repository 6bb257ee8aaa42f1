"""How likely positions in a known map are wrong, in lines for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

from evalkit.metrics.fit_calibration import WRONG_M, describe_calibration
from evalkit.report.analysis.analysis import Analysis

PREDICTED, TRUE = "map_wrong_percent", "map_truly_wrong_percent"


def describe_map_fit(analysis: Analysis) -> Iterator[str]:
    """Yield a line for each sequence in a known map, then what the probabilities were learnt on; nothing without."""
    shown = False
    for sequence in analysis.sequences:
        predicted, true = sequence.rankings.get(PREDICTED), sequence.rankings.get(TRUE)
        in_map = [label for label, own in sequence.runs.items() if any(one.result.start for one in own)]
        parts = []
        for label in in_map:
            score = predicted.of(label) if predicted else None
            known = true.of(label) if true else None
            if score is not None and score.median is not None:
                shown = True
                truly = f" (true: {known.median:.1f} %)" if known is not None and known.median is not None else ""
                parts.append(f"{label} {score.median:.1f} %{truly}")
            elif score is not None and score.reason:
                parts.append(f"{label}: no number, {score.reason}")
        if parts:
            yield f"More than {100.0 * WRONG_M:g} cm off by map fit, {sequence.label}: {'; '.join(parts)}"
    if shown:
        yield describe_calibration()
