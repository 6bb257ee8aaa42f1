"""The analysis for programs: results.json, schema version 4.

evalkit/results/results.schema.json fixes the layout; every report contains a copy. Within a version, keys are only
added. Numbers are in the unit that ``metrics`` names, times in ISO 8601. A score whose ``value`` is null has a
``reason``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import asdict
from typing import Any

from evalkit.metrics.metric import Metric
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.answer import Answer
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.standings import Standing
from evalkit.results.reader import RESULTS_NAME, RESULTS_VERSION
from evalkit.results.run_record import RunRecord
from evalkit.results.store import hash_answers

METRIC_KEYS = ("name", "label", "unit", "better", "group", "definition", "source", "limitations", "digits", "headline",
               "counterpart")  # fmt: skip


def build_results(analysis: Analysis) -> dict[str, Any]:
    """Return the content of results.json: dictionaries, lists, numbers and texts only."""
    comparison = analysis.comparison
    return {
        "schema": {"name": RESULTS_NAME, "version": RESULTS_VERSION},
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
        "overview": list(analysis.overview),
        "answer": _answer(analysis.answer),
        "verdicts": [asdict(verdict) for verdict in analysis.verdicts],
        "runs": [_run(run, {metric.name for metric in comparison.metrics}) for run in comparison.records],
        "intervals": [entry for sequence in analysis.sequences for entry in _intervals(sequence)],
        "differences": [entry for sequence in analysis.sequences for entry in _differences(sequence)],
    }


def _answer(answer: Answer) -> dict[str, Any]:
    """Return what the title states; ``losses`` with the names of their metrics."""
    return {
        "title": answer.title,
        "subtitle": answer.subtitle,
        "pills": [asdict(pill) for pill in answer.pills],
        "winners": list(answer.winners),
        "rivals": list(answer.rivals),
        "undecided": list(answer.undecided),
        "cheapest": answer.cheapest.method if answer.cheapest else None,
        "losses": [asdict(loss) | {"metric": loss.metric.name} for loss in answer.losses],
        "standings": [_standing(standing) for standing in answer.standings],
        "compared_with": answer.common,
        "counted": [contest.sequence for contest in answer.contests],
    }


def _standing(standing: Standing) -> dict[str, Any]:
    relative = standing.relative
    names = ("method", "led", "counted", "cpu_ms", "left_out")
    against = {"ratio": relative.error, "cpu_ratio": relative.cpu, "shared": relative.shared}
    return {name: getattr(standing, name) for name in names} | against


def _intervals(sequence: SequenceAnalysis) -> Iterator[dict[str, Any]]:
    """Yield the median over a method's runs with its 95 % interval, for every metric that has one."""
    for name, ranking in sequence.rankings.items():
        for score in ranking.scores:
            if score.interval is not None:
                names = {"sequence": sequence.label, "method": score.method, "metric": name}
                yield names | asdict(score.interval) | {"resampled": "runs" if len(score.values) > 1 else "blocks"}


def _differences(sequence: SequenceAnalysis) -> Iterator[dict[str, Any]]:
    """Yield how much worse each method is than the best and than the reference method, in the deciding metric."""
    table = sequence.pairwise
    for method, entries in table.rows if table else ():
        for reference, entry in zip(table.references if table else (), entries, strict=True):
            if table is not None and entry is not None and entry.difference is not None:
                one = entry.difference
                names = {"sequence": sequence.label, "method": method, "reference": reference}
                within = (one.within.low, one.within.high) if one.within else (None, None)
                how = {
                    "resampled": one.resampled, "runs": one.runs, "within_low": within[0], "within_high": within[1],
                    "detectable": one.detectable, "needed": one.needed, "verdict": entry.verdict,
                }  # fmt: skip
                yield names | {"metric": table.metric.name} | asdict(one.interval) | how


def _metric(metric: Metric) -> dict[str, Any]:
    return {name: getattr(metric, name) for name in METRIC_KEYS}


def _run(run: RunRecord, metrics: Collection[str]) -> dict[str, Any]:
    result, final = run.result, run.result.with_final_answers
    return {
        "key": run.key,
        "method": run.method,
        "backend": run.spec.method.backend,
        "backend_parameters": dict(run.spec.method.parameters),
        "sequence": run.sequence,
        "dataset": run.spec.sequence.dataset,
        "dataset_parameters": dict(run.spec.dataset_parameters),
        "seed": run.seed,
        "command": run.command,
        "alignment": run.scores.alignment,
        "conditions": result.conditions.as_dict() if result.conditions else None,
        "lost_at_s": run.scores.lost.at_s if run.scores.lost else None,
        "lost_reason": run.scores.lost.reason if run.scores.lost else "",
        "recovered_at_s": run.scores.lost.recovered_at_s if run.scores.lost else None,
        "map_start": run.result.start.as_dict() if run.result.start else None,
        "status": result.status,
        "reason": result.reason,
        "scans_answered": len(result.steps),
        "scans_expected": result.expected,
        "answers_sha256": hash_answers(result),
        "final_sha256": hash_answers(final) if final else "",
        "final_alignment": run.scores.final.alignment if run.scores.final else "",
        "warm_up_scans": result.warm_up_scans,
        "peak_memory_bytes": result.peak_memory_bytes,
        "notes": {name: int(count) for name, count in result.notes.items()},
        "remarks": list(result.remarks),
        "scores": {
            name: {"value": score.value, "support": int(score.support), "reason": score.reason}
            for name, score in run.scores.by_metric.items()
            if name in metrics
        },
    }
