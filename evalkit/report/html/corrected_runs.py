"""Corrected poses of a SLAM as runs of their own, beside its answers, for charts over time and the player."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from evalkit.report.html.method_colours import Stroke
from evalkit.results.run_record import RunRecord

SUFFIX = ", corrected"
"""What is added to the label of a method for its corrected poses; filter.js knows it."""

FINE: tuple[float, ...] = (1.0, 1.5)
"""Dashes of corrected poses, in the colour of the method."""


def with_corrected(records: Sequence[RunRecord]) -> list[RunRecord]:
    """Return the runs, each of a SLAM followed by its corrected poses; the map remains that of the first."""
    shown: list[RunRecord] = []
    for record in records:
        shown.append(record)
        corrected, final = record.result.with_final_answers, record.scores.final
        if corrected is None or final is None:
            continue
        method = replace(record.spec.method, label=f"{record.method}{SUFFIX}")
        scores = replace(
            record.scores, world_from_start=final.world_from_start, alignment=final.alignment, errors_m=final.errors_m,
            lost=None, final=None,
        )  # fmt: skip
        steps = corrected.steps.copy()
        steps["s2s_error"] = steps["s2m_error"] = np.nan  # residuals belong to the answers
        result = replace(corrected, steps=steps, final=None, loop_closures=(), path_corrections=())
        shown.append(replace(record, spec=replace(record.spec, method=method), result=result, scores=scores))
    return shown


def add_strokes(strokes: Mapping[str, Stroke]) -> dict[str, Stroke]:
    """Return the strokes with those of corrected poses."""
    return dict(strokes) | {f"{label}{SUFFIX}": Stroke(stroke.colour, FINE) for label, stroke in strokes.items()}
