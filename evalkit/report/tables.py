"""The analysis as CSV tables; the only module that imports pandas."""

from __future__ import annotations

import pandas as pd

from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.ranking import mark

FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""Beginnings of a cell that spreadsheets compute."""


def build_runs_table(analysis: Analysis) -> pd.DataFrame:
    """Return one row per run: names, status, and one column per metric (empty if not meaningful)."""
    rows = []
    for run in analysis.comparison.records:
        row: dict[str, object] = {
            "key": run.key,
            "method": run.method,
            "sequence": run.sequence,
            "seed": run.seed,
            "status": run.result.status,
            "reason": run.result.reason,
            "scans_answered": len(run.result.steps),
            "scans_expected": run.result.expected,
        }
        for metric in analysis.comparison.metrics:
            score = run.scores.by_metric.get(metric.name)
            row[metric.name] = None if score is None else score.value
        rows.append(row | {"command": run.command})
    return pd.DataFrame(rows).astype({"seed": "Int64"}) if rows else pd.DataFrame()


def build_scores_table(analysis: Analysis) -> pd.DataFrame:
    """Return one row per run and metric: value, support, and the reason if there is no value."""
    rows = [
        {
            "key": run.key,
            "method": run.method,
            "sequence": run.sequence,
            "seed": run.seed,
            "status": run.result.status,
            "metric": metric.name,
            "unit": metric.unit,
            "value": score.value,
            "support": score.support,
            "reason": score.reason,
        }
        for run in analysis.comparison.records
        for metric in analysis.comparison.metrics
        if (score := run.scores.by_metric.get(metric.name)) is not None
    ]
    return pd.DataFrame(rows).astype({"seed": "Int64"}) if rows else pd.DataFrame()


def build_summary_table(analysis: Analysis) -> pd.DataFrame:
    """Return one row per sequence, method and metric: median, lowest, highest and 95 % interval of the complete runs.

    ``rank`` is 1 for the best of the methods that completed every run, empty for others. ``mark``: see
    ``ranking.mark``.
    """
    rows = []
    for sequence in analysis.sequences:
        for ranking in sequence.rankings.values():
            ranks = {score.method: rank for rank, score in enumerate(ranking.ranked, start=1)}
            rows += [
                {
                    "sequence": sequence.label,
                    "method": score.method,
                    "metric": ranking.metric.name,
                    "unit": ranking.metric.unit,
                    "better": ranking.metric.better,
                    "runs_complete": score.complete,
                    "runs_expected": score.expected,
                    "runs_scored": len(score.values),
                    "median": score.median,
                    "lowest": min(score.values, default=None),
                    "highest": max(score.values, default=None),
                    "low_95": score.interval.low if score.interval else None,
                    "high_95": score.interval.high if score.interval else None,
                    "rank": ranks.get(score.method),
                    "mark": mark(ranking, score.method),
                    "reason": score.reason,
                }
                for score in ranking.scores
            ]
    return pd.DataFrame(rows).astype({"rank": "Int64"}) if rows else pd.DataFrame()


def format_tables(analysis: Analysis) -> dict[str, str]:
    """Return runs.csv, scores.csv and summary.csv in full precision, by file name."""
    tables = {"runs": build_runs_table, "scores": build_scores_table, "summary": build_summary_table}
    return {f"{name}.csv": _guard(build(analysis)).to_csv(index=False) for name, build in tables.items()}


def _guard(table: pd.DataFrame) -> pd.DataFrame:
    """Mark texts that a spreadsheet would take for a formula by an apostrophe: a reason quotes foreign programs."""
    for name in table.select_dtypes(["object", "string"]):
        table[name] = [
            f"'{cell}" if isinstance(cell, str) and cell.startswith(FORMULA) else cell for cell in table[name]
        ]
    return table
