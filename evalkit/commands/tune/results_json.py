"""The JSON form of a tuning: ``tuned.json``, schema version 1.

Errors are in ``objective.unit``; names of other values end in their unit.

``schema_version``, ``title``, ``command``, ``report`` (the command of the full held-out report), ``environment``;
``objective``: metric, unit, value of a lost run; ``budget``: points per back end (including the default), seed of the
search, search and confirming runs per point, CPU limit of a run; ``training`` and ``held_out``: sequences with seeds;
``backends``, one each: ``label``, ``backend``, ``missing`` (why it could not run), ``space`` (parameter: levels, scale,
continuous), ``not_searched`` (parameter: why), ``spent`` (points, runs, lost_runs, cpu_s), ``points`` (found: default,
spread, step or all; searched parameters, error, lost_runs, reasons, cpu_median_ms, pareto_front), ``best`` (index of
the best point), ``confirmed`` (errors of default and best on fresh seeds, ratio with low and high; null if the default
was the best), ``tuned`` (whether the best point replaces the default), ``why``, ``parameters`` (all chosen ones),
``held_out`` (verdict, overfitted, lost runs of both, runs, ratio, p by Holm, ``detectable_ratio``: the smallest factor
above 1 between both that these runs detect; null if the default is kept).
"""

from __future__ import annotations

from typing import Any

from evalkit.commands.tune.held_out import HeldOutVerdict
from evalkit.commands.tune.objective import ScoredCandidate, mark_pareto_front
from evalkit.commands.tune.plan import TunableMethod
from evalkit.commands.tune.result import TuningResult
from evalkit.commands.tune.search_loop import MethodSearch
from evalkit.commands.tune.space import METHOD, is_continuous
from evalkit.config.experiment import SequenceSpec
from evalkit.io.json_values import replace_non_finite

SCHEMA_VERSION = 1


def tuning_as_json(result: TuningResult) -> dict[str, Any]:
    """The JSON values of a tuning."""
    tuning = result.tuning
    by_label = {one.tunable.label: one for one in result.searches}
    return {
        "schema_version": SCHEMA_VERSION,
        "title": tuning.title,
        "command": tuning.command,
        "report": result.report,
        "environment": dict(result.ran_on),
        "objective": {
            "metric": tuning.objective.name,
            "unit": tuning.objective.metric.unit,
            "lost": tuning.objective.lost,
        },
        "budget": {
            "points": tuning.points,
            "seed": tuning.seed,
            "search_runs": len(tuning.search_runs),
            "confirming_runs": len(tuning.confirm_runs),
            "run_cpu_s": tuning.run_cpu_s,
        },
        "training": [_sequence_as_json(one.sequence) | {"confirm": list(one.confirm)} for one in tuning.training],
        "held_out": [_sequence_as_json(sequence) for sequence in tuning.held_out],
        "backends": [_backend_as_json(result, tunable, by_label.get(tunable.label)) for tunable in tuning.methods],
    }


def _sequence_as_json(sequence: SequenceSpec) -> dict[str, Any]:
    seeds = [seed for seed in sequence.seeds if seed is not None]
    parameters = dict(sequence.parameters)
    return {"label": sequence.label, "dataset": sequence.dataset, "seeds": seeds, "parameters": parameters}


def _backend_as_json(result: TuningResult, tunable: TunableMethod, one: MethodSearch | None) -> dict[str, Any]:
    space = {
        factor.name: {
            "levels": [level.label if level.number is None else level.number for level in factor.levels],
            "scale": factor.scale,
            "continuous": is_continuous(factor),
        }
        for factor in tunable.space.factors
    }
    head = {
        "label": tunable.label,
        "backend": tunable.method.backend,
        "missing": tunable.missing,
        "space": space,
        "not_searched": dict(tunable.excluded),
    }
    return head if one is None else head | _search_as_json(result, one)


def _search_as_json(result: TuningResult, one: MethodSearch) -> dict[str, Any]:
    on = mark_pareto_front(one.tried).tolist()
    pair = (*one.tried, *(one.confirmed or ()))
    runs = sum(len(each.errors) for each in pair)
    held = result.held_out_verdicts.get(one.tunable.label)
    return {
        "spent": {
            "points": len(one.tried),
            "runs": runs,
            "lost_runs": sum(each.losses for each in pair),
            "cpu_s": one.cpu_s,
        },
        "points": [_point_as_json(one, each, chosen) for each, chosen in zip(one.tried, on, strict=True)],
        "best": one.tried.index(one.best),
        "confirmed": _confirmed_as_json(one),
        "tuned": one.tuned,
        "why": one.why,
        "parameters": dict(one.chosen.candidate.values),
        "held_out": None if held is None else _held_out_as_json(held),
    }


def _point_as_json(one: MethodSearch, each: ScoredCandidate, on: bool) -> dict[str, Any]:
    names = [name.removeprefix(METHOD) for factor in one.tunable.space.factors for name in factor.sets]
    return {
        "found": each.candidate.found,
        "parameters": {name: each.candidate.values[name] for name in names},
        "error": each.error,
        "lost_runs": each.losses,
        "reasons": list(dict.fromkeys(filter(None, each.lost))),
        "cpu_median_ms": replace_non_finite(each.cpu_ms),
        "pareto_front": on,
    }


def _confirmed_as_json(one: MethodSearch) -> dict[str, Any] | None:
    if one.confirmed is None or one.ratio is None:
        return None
    default, best = one.confirmed
    ratio = {"value": one.ratio.value, "low": one.ratio.low, "high": one.ratio.high, "runs": one.ratio.support}
    return {"default": default.errors.tolist(), "best": best.errors.tolist(), "ratio": ratio}


def _held_out_as_json(held: HeldOutVerdict) -> dict[str, Any]:
    paired = held.paired
    tested = {} if paired is None else {
        "runs": paired.runs,
        "ratio": paired.ratio,
        "p_holm": paired.p,
        "detectable_ratio": replace_non_finite(paired.detectable),
    }  # fmt: skip
    lost = {"default": held.lost[0], "tuned": held.lost[1]}
    return {"verdict": held.verdict, "overfitted": held.overfitted, "lost_runs": lost} | tested
