"""The report for programs: results.json, schema version 1.

The layout is fixed by results.schema.json beside this module, a copy of which goes with every report. Within a version
keys are only ever added. Numbers are in the unit that ``metrics`` names, times in ISO 8601; a score whose ``value`` is
null carries the ``reason``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib.resources import files
from typing import Any

from evalkit.metrics.table import Metric
from evalkit.report.analysis.cells import interval
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.pairwise import pairs
from evalkit.report.analysis.standings import standing
from evalkit.report.analysis.verdict import Verdict
from evalkit.results.run_record import RunRecord
from evalkit.results.store import digest

NAME, VERSION = "evalkit-results", 1


def results(comparison: Comparison, overview: Sequence[str], verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """The content of results.json: plain dictionaries, lists, numbers and texts only."""
    return {
        "schema": {"name": NAME, "version": VERSION},
        "title": comparison.title,
        "description": comparison.description,
        "command": comparison.command,
        "started": comparison.started.isoformat(),
        "finished": comparison.finished.isoformat(),
        "environment": dict(comparison.environment),
        "mapper": comparison.mapper,
        "fairness": list(comparison.fairness),
        "metrics": [_metric(metric) for metric in comparison.metrics],
        "methods": {label: asdict(card) for label, card in comparison.methods.items()},
        "sequences": {label: asdict(card) for label, card in comparison.sequences.items()},
        "overview": list(overview),
        "verdicts": [asdict(verdict) for verdict in verdicts],
        "trials": [_trial(record) for record in comparison.records],
        "intervals": [row for label in comparison.sequence_labels for row in _intervals(comparison, label)],
        "differences": [row for label in comparison.sequence_labels for row in _differences(comparison, label)],
    }


def schema() -> str:
    """The JSON Schema (draft 2020-12) of results.json."""
    return files("evalkit.report").joinpath("results.schema.json").read_text(encoding="utf-8")


def _intervals(comparison: Comparison, sequence: str) -> Iterator[dict[str, Any]]:
    """The median over a method's runs with its 95 % interval, for every metric that has one."""
    for metric in comparison.metrics:
        for cell in standing(comparison, sequence, metric).cells:
            found = interval(cell)
            if found is not None:
                names = {"sequence": sequence, "method": cell.method, "metric": metric.name}
                yield names | asdict(found)


def _differences(comparison: Comparison, sequence: str) -> Iterator[dict[str, Any]]:
    """By how much everybody is worse than the leader and the paper's method in the metric that decides."""
    found = pairs(comparison, sequence)
    for who, held in found.rows if found else ():
        for reference, one in zip(found.references if found else (), held, strict=True):
            if found is not None and one is not None and one.apart is not None:
                names = {"sequence": sequence, "method": who, "reference": reference, "metric": found.metric.name}
                drawn = {"drawn": one.apart.by, "detectable": one.apart.detectable, "said": one.said}
                yield names | asdict(one.apart.interval) | drawn


def _metric(metric: Metric) -> dict[str, Any]:
    names = ("name", "label", "unit", "better", "group", "definition", "source", "limitations", "digits", "headline")
    return {name: getattr(metric, name) for name in names}


def _trial(record: RunRecord) -> dict[str, Any]:
    run = record.result
    return {
        "key": record.key,
        "method": record.method,
        "backend": record.spec.method.backend,
        "backend_parameters": dict(record.spec.method.parameters),
        "sequence": record.sequence,
        "dataset": record.spec.sequence.dataset,
        "dataset_parameters": dict(record.spec.dataset_parameters),
        "seed": record.seed,
        "command": record.command,
        "alignment": record.scores.alignment,
        "status": run.status,
        "reason": run.reason,
        "scans_answered": len(run.steps),
        "scans_expected": run.expected,
        "answers_sha256": digest(run),
        "warm_up_scans": run.warm_up_scans,
        "peak_memory_bytes": run.peak_memory_bytes,
        "notes": {name: int(count) for name, count in run.notes.items()},
        "scores": {
            name: {"value": score.value, "support": int(score.support), "reason": score.reason}
            for name, score in record.scores.by_metric.items()
        },
    }
