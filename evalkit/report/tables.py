"""The report's numbers as tables for other programs; the only module that imports pandas."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from evalkit.report.analysis.cells import interval
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.standings import standing


def records(comparison: Comparison) -> pd.DataFrame:
    """One row per record: who, over what, how it ended, and one column per metric (empty where not meaningful)."""
    rows = []
    for record in comparison.records:
        row: dict[str, object] = {
            "key": record.key,
            "method": record.method,
            "sequence": record.sequence,
            "seed": record.seed,
            "status": record.result.status,
            "reason": record.result.reason,
            "scans_answered": len(record.result.steps),
            "scans_expected": record.result.expected,
        }
        for metric in comparison.metrics:
            score = record.scores.by_metric.get(metric.name)
            row[metric.name] = None if score is None else score.value
        rows.append(row | {"command": record.command})
    return pd.DataFrame(rows).astype({"seed": "Int64"}) if rows else pd.DataFrame()


def scores(comparison: Comparison) -> pd.DataFrame:
    """One row per record and metric: value, support, and the reason where there is no value."""
    rows = [
        {
            "key": record.key,
            "method": record.method,
            "sequence": record.sequence,
            "seed": record.seed,
            "status": record.result.status,
            "metric": metric.name,
            "unit": metric.unit,
            "value": score.value,
            "support": score.support,
            "reason": score.reason,
        }
        for record in comparison.records
        for metric in comparison.metrics
        if (score := record.scores.by_metric.get(metric.name)) is not None
    ]
    return pd.DataFrame(rows).astype({"seed": "Int64"}) if rows else pd.DataFrame()


def summary(comparison: Comparison) -> pd.DataFrame:
    """One row per sequence, method and metric: median, lowest, highest and 95 % interval over the complete runs.

    ``place`` is 1 for the best among those who completed every run, empty for the rest; ``level_with_best`` says that
    no difference from it is shown.
    """
    rows = []
    for sequence in comparison.sequence_labels:
        for metric in comparison.metrics:
            found = standing(comparison, sequence, metric)
            places = {cell.method: place for place, cell in enumerate(found.ranked, start=1)}
            rows += [
                {
                    "sequence": sequence,
                    "method": cell.method,
                    "metric": metric.name,
                    "unit": metric.unit,
                    "better": metric.better,
                    "runs_complete": cell.complete,
                    "runs_expected": cell.expected,
                    "runs_scored": len(cell.values),
                    "median": cell.median,
                    "lowest": min(cell.values, default=None),
                    "highest": max(cell.values, default=None),
                    "low_95": bounds.low if (bounds := interval(cell)) else None,
                    "high_95": bounds.high if bounds else None,
                    "place": places.get(cell.method),
                    "level_with_best": cell in found.level,
                    "reason": cell.reason,
                }
                for cell in found.cells
            ]
    return pd.DataFrame(rows).astype({"place": "Int64"}) if rows else pd.DataFrame()


def write_csv(comparison: Comparison, folder: Path) -> tuple[Path, ...]:
    """The files trials.csv, scores.csv and summary.csv in a folder; numbers in full precision."""
    written = []
    for name, table in (("trials", records), ("scores", scores), ("summary", summary)):
        path = folder / f"{name}.csv"
        table(comparison).to_csv(path, index=False)
        written.append(path)
    return tuple(written)
