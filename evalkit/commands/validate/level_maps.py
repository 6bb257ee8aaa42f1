"""Level 4 of an acceptance report: the maps drawn along the paths of whole runs."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from evalkit.commands.validate.acceptance import AcceptanceLevel, Check
from evalkit.commands.validate.comparison_terms import ComparisonTerms
from evalkit.commands.validate.equivalence.map_cells import GridPair
from evalkit.commands.validate.equivalence.margins import FLOAT32
from evalkit.commands.validate.known_motion import judge_gap
from evalkit.commands.validate.level_answers import mapper_check, waive
from evalkit.commands.validate.run_paths import (
    CONFIDENCE,
    Records,
    ScanMargin,
    ScanMargins,
    have_answers,
    path_bound,
    sequence_of,
)
from evalkit.execution.task import Result
from evalkit.results.run_record import RunRecord
from evalkit.stats.runs import mean_interval

CELL_MARGIN = 1e-5
"""Log-odds by which two cells may differ and still count as equal."""


def maps_level(
    records: Records,
    margins: ScanMargins,
    mapped: Mapping[str, Result],
    mappers: tuple[str, str],
    terms: ComparisonTerms,
) -> AcceptanceLevel:
    """Level 4; ``mapped``: comparisons of the back end's mapper with the reference's, by place."""
    both = {
        place: runs
        for place, runs in records.items()
        if have_answers(runs, terms.backend, terms.reference) and runs[terms.backend].scores.grid is not None
        and runs[terms.reference].scores.grid is not None
    }  # fmt: skip
    checks: list[Check | None] = [_same_map(place, runs, margins.get(place), terms) for place, runs in both.items()]
    checks += [_no_worse_walls(sequence, both, terms) for sequence in dict.fromkeys(map(sequence_of, both))]
    mapper_terms = ComparisonTerms(*mappers, terms.margin, terms.noise_share)
    checks += [mapper_check(place, result, mapper_terms) for place, result in mapped.items()]
    if not mappers[0]:
        observed = "the back end brings no mapper; name one with --mapper"
        checks.append(Check("mapper of the back end", "", "not applicable", "never", observed))
    question = f"Is the map along its path the map of {terms.reference}, cell by cell, and as accurate?"
    known = tuple(one for one in checks if one)
    return waive(AcceptanceLevel(4, "maps", question, known, {"records": records}), terms.waivers)


def _same_map(
    place: str, runs: Mapping[str, RunRecord], margin: ScanMargin | None, terms: ComparisonTerms
) -> Check | None:
    grid, reference = runs[terms.backend].scores.grid, runs[terms.reference].scores.grid
    if grid is None or reference is None:
        return None
    pair = GridPair.of(reference, grid)
    observed_cells = int(np.count_nonzero(pair.observed_a | pair.observed_b))
    differing = int(np.count_nonzero(pair.differing(CELL_MARGIN)))
    walls = int(np.count_nonzero(pair.differing(CELL_MARGIN) & ((pair.a > 0.0) != (pair.b > 0.0))))
    observed = f"{walls} of {observed_cells} cells are a wall in one map only; {differing} have different values"
    name = f"the map of {terms.reference}, drawn by the same mapper"
    if margin is None or terms.margin == FLOAT32:
        return Check(name, place, "informative", "never", observed)
    run = runs[terms.reference].result
    bound, _ = path_bound(margin, len(run.steps), run.estimate.path_m)
    allowed = math.ceil(observed_cells * bound / reference.resolution_m)
    reason = (
        f"{allowed} cells: a path {bound:.2g} m off moves that share of {reference.resolution_m:g} m cells across an "
        "edge"
    )
    return Check(name, place, "passed" if differing <= allowed else "failed", "equal", observed, reason)


def _no_worse_walls(sequence: str, both: Records, terms: ComparisonTerms) -> Check | None:
    """The check that the walls are as accurate as the reference's, relative to its variation over seeds."""
    labels = (terms.backend, terms.reference)
    scores = [
        [runs[label].scores.by_metric["map_f1"].value for label in labels]
        for place, runs in both.items()
        if sequence_of(place) == sequence and all("map_f1" in runs[label].scores.by_metric for label in labels)
    ]
    known = np.array([pair for pair in scores if None not in pair], dtype=np.float64)
    if not len(known):
        return None
    observed = f"F1 at 10 cm {known[:, 0].mean():.3f}, {terms.reference} {known[:, 1].mean():.3f}"
    name = f"walls as accurate as in the map of {terms.reference}"
    if len(known) < 2:
        observed += "; one run shows no variation: give more --seeds"
        return Check(name, sequence, "informative", "never", observed)
    margin = terms.noise_share * float(known[:, 1].std(ddof=1))
    losses = known[:, 1] - known[:, 0]
    lost = mean_interval(losses, CONFIDENCE)
    outcome, hint = judge_gap(lost.value, lost.low, lost.high, margin, len(known))
    if (lost.value <= 0.0 and outcome == "not shown") or not losses.any():
        outcome, hint = "passed", "no loss was observed"
    reason = (
        f"{margin:.2g}: {terms.noise_share:g} of the standard deviation of {terms.reference} over {len(known)} seeds"
    )
    return Check(name, sequence, outcome, "as-good", observed, reason, hint)
