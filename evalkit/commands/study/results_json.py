"""A study's runs, effects and envelopes as rows for CSV and as JSON."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any

from evalkit.commands.study.envelope import Panel, compute_panels, find_envelope_axes
from evalkit.commands.study.plan import Design, EnvelopeChoice
from evalkit.commands.study.result import StudyResult
from evalkit.design.responses import Response
from evalkit.stats.intervals import Interval

JsonRow = dict[str, Any]

EFFECT_COLUMNS = (
    "design", "metric", "scale", "kind", "factor", "level", *(field.name for field in fields(Interval)), "share",
)  # fmt: skip
"""The columns of effects.csv."""


def make_run_rows(outcome: StudyResult) -> list[JsonRow]:
    """A row for every run of every design: levels, scores, and why it is lost, or ""."""
    study = outcome.study
    names = [factor.name for factor in study.factors]
    rows: list[JsonRow] = []
    for design in study.designs:
        for point in design.points:
            levels = {name: point.levels[name].label if name in point.levels else "" for name in names}
            for seed in design.runs(point):
                result = outcome.result(point.key, seed)
                head = {"key": point.key, "design": design.name, **levels, "seed": "" if seed is None else seed}
                tail = {"status": result["status"], "reason": result["reason"], "lost": outcome.lost(point.key, seed)}
                rows.append({**head, **tail, **result["scores"], "cpu_s": result["cpu_s"]})
    return rows


def make_effect_rows(outcome: StudyResult) -> list[JsonRow]:
    """A row for every level's distance from the mean, and for every interaction's largest corner; natural logarithms.

    ``scale`` "log": exp(value) is a ratio.
    """
    rows: list[JsonRow] = []
    fits = [(design, response, outcome.fit(design, response))
            for design in outcome.study.designs for response in outcome.study.responses]  # fmt: skip
    for design, response, fit in fits:
        if fit is None:
            continue
        for factor, effect in zip(design.factors, fit.effects, strict=True):
            for level, interval in zip(factor.levels, effect.levels, strict=True):
                rows.append(_effect_as_json(design, response, "main", factor.name, level.label, interval, effect.share))
        for pair in fit.interactions():
            levels = [
                design.factor(name).levels[at].label
                for name, both in ((pair.a, pair.a_levels), (pair.b, pair.b_levels))
                for at in both
            ]
            corner = "{} → {} | {} → {}".format(*levels)
            rows.append(
                _effect_as_json(design, response, "interaction", f"{pair.a} x {pair.b}", corner, pair.value, pair.share)
            )
    return rows


def study_as_json(outcome: StudyResult) -> JsonRow:
    """The whole study as JSON values."""
    study = outcome.study
    return {
        "schema": {"name": "evalkit-study", "version": 1},
        "title": study.title,
        "command": study.command,
        "backend": study.backend,
        "dataset": study.dataset,
        "runs": make_run_rows(outcome),
        "effects": make_effect_rows(outcome),
        "missing_effects": [
            {"design": design.name, "metric": response.name, "reason": reason}
            for response in study.responses
            for design, reason in outcome.missing_fits(response)
        ],
        "envelopes": [
            {
                **dict(panel.others),
                "limit": choice.limit,
                "metric": choice.response.name,
                **_box_as_json(outcome, choice, panel),
            }
            for choice in study.envelopes
            for panel in compute_panels(outcome, choice)
        ],
    }


def format_csv(rows: list[JsonRow], columns: Sequence[str] = ()) -> str:
    """Rows with the same names as CSV text; ``columns``: the names where there may be no row."""
    out = io.StringIO()
    writer = csv.DictWriter(out, columns or list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


def _box_as_json(outcome: StudyResult, choice: EnvelopeChoice, panel: Panel) -> JsonRow:
    """The ends of a panel's box by factor, None without a box, and the number of lost cells."""
    ends = zip(find_envelope_axes(outcome.study.design(choice.design), choice), panel.box, strict=True)
    reached = {factor.name: factor.numbers[count - 1] if factor.numbers and count else None for factor, count in ends}
    return {**reached, "lost_cells": int((panel.lost > 0).sum())}


def _effect_as_json(
    design: Design, response: Response, kind: str, factor: str, level: str, value: Interval, share: float
) -> JsonRow:
    head = {"design": design.name, "metric": response.name, "scale": response.scale, "kind": kind, "factor": factor}
    return {**head, "level": level, **asdict(value), "share": share}
