"""Plan a validation of the metrics and summarize its results as JSON and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from evalkit.commands.metric_validation import fault_injection, map_rebuilding, rank_agreement
from evalkit.commands.metric_validation.fault_injection import FAULTS, NO_FAULT, Detection
from evalkit.commands.metric_validation.map_rebuilding import CLEAN
from evalkit.commands.metric_validation.perturbation import PERTURBATIONS
from evalkit.commands.metric_validation.rank_agreement import MapScores
from evalkit.execution.task import AnyTask, Result
from evalkit.metrics.validated import SCHEMA, RankAgreement
from evalkit.stats.intervals import Interval

SCANS = 150
MAX_DETECTIONS = 5
"""Number of metrics listed for each fault."""

PILOT = {
    "map_entropy": 0.94,
    "wall_thickness_m": 0.93,
    "split_distance_m": 0.93,
    "cleared_percent": 0.90,
    "mme_nat": 0.84,
    "enclosed_areas": 0.64,
    "corners": 0.56,
    "occupied_percent": -0.33,
}
"""Correlations of an earlier measurement with other code: one synthetic office, 64 trajectories, all perturbations."""


@dataclass(frozen=True)
class MetricValidationPlan:
    """What to measure: data sets by name, number of sizes of every perturbation, seed, mapper, scans per map.

    ``fault_world``: the data set for the injected faults.
    """

    worlds: tuple[str, ...]
    mapper: str
    fault_world: str
    sizes: int = 5
    seed: int = 0
    scans: int = SCANS


def make_tasks(plan: MetricValidationPlan) -> list[AnyTask]:
    """Return a task for every world and perturbation, and for every injected fault."""
    perturbed = [
        map_rebuilding.make_perturbation_task(
            world, name, choose_sizes(name, plan.sizes), plan.seed, plan.mapper, plan.scans
        )
        for world in plan.worlds
        for name in (CLEAN, *PERTURBATIONS)
    ]
    return [*perturbed, *make_fault_tasks(plan)]


def make_fault_tasks(plan: MetricValidationPlan) -> list[AnyTask]:
    """Return a task for every injected fault, and for the run without a fault."""
    arguments = (plan.fault_world, plan.seed, plan.mapper, plan.scans)
    return [fault_injection.make_fault_task(fault, *arguments) for fault in (NO_FAULT, *FAULTS)]


def choose_sizes(perturbation: str, count: int) -> tuple[float, ...]:
    """Return at most ``count`` sizes of a perturbation, including the smallest and the largest."""
    if perturbation == CLEAN:
        return ()
    sizes = PERTURBATIONS[perturbation].sizes
    indices = np.unique(np.linspace(0, len(sizes) - 1, min(count, len(sizes))).round().astype(int))
    return tuple(sizes[i] for i in indices)


def collect_maps(plan: MetricValidationPlan, results: Mapping[str, Result]) -> list[MapScores]:
    """Return the scores of all maps, world by world."""
    return [
        row
        for world in plan.worlds
        for name in (CLEAN, *PERTURBATIONS)
        for row in rank_agreement.read_map_scores(world, name, results[f"{world} {name}"])
    ]


def detect_faults(results: Mapping[str, Result]) -> dict[str, tuple[Detection, ...]]:
    """Return for each fault the metrics that got worse, the worst first."""
    without = results[f"fault {NO_FAULT}"]["scores"]
    return {fault: fault_injection.compare_scores(without, results[f"fault {fault}"]["scores"]) for fault in FAULTS}


def summarize(
    plan: MetricValidationPlan, results: Mapping[str, Result], provenance: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the results as JSON. ``provenance``: command, date and versions.

    ``sample`` is one of the maps with all its scores, for a test of reproducibility.
    """
    maps = collect_maps(plan, results)
    agreement = rank_agreement.compute_agreement(maps, np.random.default_rng(plan.seed))
    perturbations = {
        name: {"what": one.what, "unit": one.unit, "sizes": choose_sizes(name, plan.sizes)}
        for name, one in PERTURBATIONS.items()
    }
    return {
        "schema": SCHEMA,
        **provenance,
        **asdict(plan),
        "reduced_drive": map_rebuilding.REDUCED_DRIVE,
        "map_count": len(maps),
        "perturbations": perturbations,
        "agreement": [_agreement_as_json(one) for one in agreement],
        "faults": [fault_as_json(name, detections) for name, detections in detect_faults(results).items()],
        "sample": asdict(maps[-1]),
    }


def format_csv(maps: Sequence[MapScores]) -> str:
    """Return the scores of all maps as CSV, one line per map."""
    names = [metric.name for metric in rank_agreement.reference_free_metrics()]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["world", "perturbation", "size", rank_agreement.ERROR, *names])
    for row in maps:
        writer.writerow([row.world, row.perturbation, row.size, row.error_m, *(row.scores[name] for name in names)])
    return out.getvalue()


def fault_as_json(name: str, detections: Sequence[Detection]) -> dict[str, Any]:
    """Return a fault, the number of metrics that detect it, and the metrics with the largest factors, as JSON."""
    detecting = [one for one in detections if one.factor >= fault_injection.MIN_FACTOR]
    strongest = [
        {"metric": one.metric.name, "without": one.without, "with": one.with_fault, "factor": one.factor}
        for one in detecting[:MAX_DETECTIONS]
    ]
    return {"fault": name, "what": FAULTS[name].what, "metric_count": len(detecting), "strongest": strongest}


def _agreement_as_json(one: RankAgreement) -> dict[str, Any]:
    return {
        "metric": one.metric,
        "overall": interval_as_json(one.overall),
        "by_perturbation": {name: interval_as_json(interval) for name, interval in one.by_perturbation.items()},
        "by_world": {name: interval_as_json(interval) for name, interval in one.by_world.items()},
    }


def interval_as_json(interval: Interval | None) -> dict[str, float] | None:
    """Return an interval as JSON, rounded to four decimals."""
    return None if interval is None else {name: round(value, 4) for name, value in asdict(interval).items()}
