"""Levels 3 and 4 of an acceptance report: the trajectories of whole runs, and the maps drawn along them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from evalkit.commands.validate.acceptance import AcceptanceLevel, Check
from evalkit.commands.validate.comparison_terms import ComparisonTerms
from evalkit.commands.validate.equivalence.comparison import FLOAT32
from evalkit.commands.validate.equivalence.map_cells import GridPair
from evalkit.commands.validate.known_motion import judge_gap
from evalkit.commands.validate.level_answers import mapper_check, unfinished_check, waive
from evalkit.core import se2
from evalkit.core.se2 import Floats
from evalkit.execution.sandbox import ENDED
from evalkit.execution.task import Result
from evalkit.metrics.runtime import period_ns
from evalkit.metrics.trajectory import MAX_GAP_S, can_interpolate, rms
from evalkit.results.run_record import RunRecord
from evalkit.stats.bootstrap import block_length, bootstrap_interval, paired_difference_interval
from evalkit.stats.intervals import Interval, student_quantile

CONFIDENCE = 0.90
"""Confidence of all intervals: two one-sided tests at 5 %."""

MIN_M = 1e-12
"""Paths closer than this count as identical."""

MIN_SCANS = 10
"""Fewest scans with a known truth from which an interval is computed."""

CELL_MARGIN = 1e-5
"""Log-odds by which two cells may differ and still count as equal."""

Records = Mapping[str, Mapping[str, RunRecord]]
"""Runs by place ("room, seed 0") and by method."""

ScanMargins = Mapping[str, tuple[float, float]]
"""The margin of one scan by place: metres, radians."""


@dataclass(frozen=True, eq=False)
class RunErrors:
    """Errors of one run: stamps (N,), distance to the truth (N,), error of the motion over about 1 s (N,); nan."""

    stamps_ns: Floats
    ate: Floats
    rpe: Floats


def trajectories_level(
    records: Records, margins: ScanMargins, perturbed: Mapping[str, Result], terms: ComparisonTerms
) -> AcceptanceLevel:
    """Level 3; ``perturbed``: the reference's paths over copies of a sequence perturbed by rounding, for float32."""
    checks: list[Check | None] = [*_complete_runs({place: runs[terms.backend] for place, runs in records.items()})]
    both = {place: runs for place, runs in records.items() if _have_answers(runs, terms.backend, terms.reference)}
    for place, runs in both.items():
        checks.append(_same_path("path", place, runs, margins.get(place), terms))
        checks += _same_corrections(place, runs, margins.get(place), terms)
    checks += [
        _within_rounding(place, both[place], result, margins.get(place), terms)
        for place, result in perturbed.items()
        if place in both
    ]
    for sequence in dict.fromkeys(map(_sequence_of, both)):
        runs_here = [runs for place, runs in both.items() if _sequence_of(place) == sequence]
        checks += [_no_larger_error(sequence, runs_here, terms, quantity) for quantity in TITLES]
        checks += [_error_beside_peer(sequence, runs_here, terms, peer) for peer in terms.peers]
    question = f"Does a whole run follow the path of {terms.reference}, and is it as close to the truth?"
    known = tuple(one for one in checks if one)
    return waive(AcceptanceLevel(3, "trajectories", question, known, {"records": records}), terms.waivers)


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
        if _have_answers(runs, terms.backend, terms.reference) and runs[terms.backend].scores.grid is not None
        and runs[terms.reference].scores.grid is not None
    }  # fmt: skip
    checks: list[Check | None] = [_same_map(place, runs, margins.get(place), terms) for place, runs in both.items()]
    checks += [_no_worse_walls(sequence, both, terms) for sequence in dict.fromkeys(map(_sequence_of, both))]
    mapper_terms = ComparisonTerms(*mappers, terms.margin, terms.noise_share)
    checks += [mapper_check(place, result, mapper_terms) for place, result in mapped.items()]
    if not mappers[0]:
        observed = "the back end brings no mapper; name one with --mapper"
        checks.append(Check("mapper of the back end", "", "not applicable", "never", observed))
    question = f"Is the map along its path the map of {terms.reference}, cell by cell, and as accurate?"
    known = tuple(one for one in checks if one)
    return waive(AcceptanceLevel(4, "maps", question, known, {"records": records}), terms.waivers)


def compute_errors(record: RunRecord) -> RunErrors:
    """Errors of a run against the truth, nan where the truth is not known."""
    run, truth = record.result, record.truth.trajectory
    stamps = run.steps["stamp_ns"]
    unknown = np.full(len(stamps), np.nan)
    if truth is None or record.scores.errors_m is None or len(stamps) < 3:
        return RunErrors(stamps, unknown, unknown)
    rpe, gap = unknown.copy(), max(1, round(1e9 / max(period_ns(run), 1.0)))
    known = np.flatnonzero(can_interpolate(truth.stamps_ns, stamps, MAX_GAP_S))
    first = np.intersect1d(known, known - gap)
    true = se2.between(truth.at(stamps[first]), truth.at(stamps[first + gap]))
    poses = run.estimate.poses
    apart = se2.between(true, se2.between(poses[first], poses[first + gap]))
    rpe[first] = np.hypot(apart[:, 0], apart[:, 1])
    return RunErrors(stamps, np.asarray(record.scores.errors_m), rpe)


def path_distances(one: RunRecord, other: RunRecord) -> tuple[Floats, Floats]:
    """Seconds (N,) since the first scan that both answered, and the distance (m) of the paths from the same start."""
    stamps, a, b = np.intersect1d(one.result.steps["stamp_ns"], other.result.steps["stamp_ns"], return_indices=True)
    if not len(stamps):
        return np.zeros(0), np.zeros(0)
    apart = one.result.estimate.poses[a, :2] - other.result.estimate.poses[b, :2]
    return (stamps - stamps[0]) * 1e-9, np.asarray(np.linalg.norm(apart, axis=1))


def _sequence_of(place: str) -> str:
    return place.partition(",")[0]


def _have_answers(runs: Mapping[str, RunRecord], *labels: str) -> bool:
    return all(label in runs and len(runs[label].result.steps) > 2 for label in labels)


def _complete_runs(runs: Mapping[str, RunRecord]) -> list[Check]:
    """One check for all complete runs, one for each other run."""
    complete = [place for place, record in runs.items() if record.result.is_complete]
    checks = []
    for place, record in runs.items():
        run = record.result
        if place not in complete:
            detail = f"{len(run.steps)} of {run.expected} scans answered"
            observed = f"{run.status}: {run.reason}"
            checks.append(Check("completes its runs", place, "failed", "always", observed, detail=detail))
    if complete:
        scans = sum(len(runs[place].result.steps) for place in complete)
        observed = f"{len(complete)} of {len(runs)} runs complete, {scans} scans answered"
        checks.append(Check("completes its runs", "", "passed", "always", observed, detail="; ".join(complete)))
    return checks


def _same_corrections(
    place: str, runs: Mapping[str, RunRecord], margin: tuple[float, float] | None, terms: ComparisonTerms
) -> list[Check | None]:
    """The checks of the corrected poses and the closures of two SLAMs; none where no method corrects its poses."""
    corrected = {
        label: replace(runs[label], result=result)
        for label in (terms.backend, terms.reference)
        if (result := runs[label].result.with_final_answers) is not None
    }
    if len(corrected) == 1:
        what = f"only {next(iter(corrected))} has corrected poses"
        return [Check(f"the corrected path of {terms.reference}", place, "not applicable", "never", what)]
    if not corrected:
        return []
    return [
        _same_path("corrected path", place, corrected, margin, terms),
        _same_closures(place, corrected, terms),
    ]


def _same_closures(place: str, runs: Mapping[str, RunRecord], terms: ComparisonTerms) -> Check:
    """The check that the candidates for loop closures and what became of them are those of the reference."""
    own, known = (
        {(loop.stamp_ns, loop.other_stamp_ns): loop.accepted for loop in runs[label].result.loop_closures}
        for label in (terms.backend, terms.reference)
    )
    name = f"the loop closures of {terms.reference}"
    observed = f"candidates: {len(known)}, accepted: {sum(known.values())}"
    differing = sorted(pair for pair in own.keys() | known.keys() if own.get(pair) != known.get(pair))
    if differing:
        begin = runs[terms.reference].result.steps["stamp_ns"][0]
        later, earlier = ((stamp - begin) * 1e-9 for stamp in differing[0])
        states = {None: "no candidate", True: "accepted", False: "rejected"}
        ours, theirs = (states[each.get(differing[0])] for each in (own, known))
        first = f"{later:.1f} s with {earlier:.1f} s: {ours}, but {theirs} by {terms.reference}"
        observed = f"{len(differing)} differ; first {first}"
    if terms.margin == FLOAT32:
        return Check(name, place, "informative", "never", observed)
    return Check(name, place, "failed" if differing else "passed", "equal", observed)


def _same_path(
    what: str,
    place: str,
    runs: Mapping[str, RunRecord],
    margin: tuple[float, float] | None,
    terms: ComparisonTerms,
) -> Check | None:
    """The check that the path is the reference's; informative in single precision, where a tie may change a path."""
    if margin is None:
        return None
    seconds, apart = path_distances(runs[terms.backend], runs[terms.reference])
    bound, reason = _path_bound(margin, len(apart), runs[terms.reference].result.estimate.path_m)
    worst = int(np.argmax(apart))
    beyond = np.flatnonzero(apart > bound)
    name = f"the {what} of {terms.reference}"
    observed = f"largest distance {apart[worst]:.2g} m, at {seconds[worst]:.1f} s; at the end {apart[-1]:.2g} m"
    if terms.margin == FLOAT32:
        detail = "paths may diverge at a tie that single precision breaks differently; see the check on rounding"
        return Check(name, place, "informative", "never", observed, reason, detail)
    if len(beyond):
        observed = f"beyond the margin from scan {beyond[0] + 1} ({seconds[beyond[0]]:.1f} s) on; {observed}"
    return Check(name, place, "failed" if len(beyond) else "passed", "equal", observed, reason)


def _path_bound(margin: tuple[float, float], scans: int, path_m: float) -> tuple[float, str]:
    metres, radians = margin
    bound = scans * (metres + radians * path_m)
    return bound, f"{bound:.2g} m: {scans} scans, each {metres:.2g} m and {radians:.2g} rad over {path_m:.1f} m of path"


def _within_rounding(
    place: str,
    runs: Mapping[str, RunRecord],
    result: Result,
    margin: tuple[float, float] | None,
    terms: ComparisonTerms,
) -> Check:
    """The check that the path is no farther from the reference's than rounding can cause."""
    name = f"as close to the path of {terms.reference} as rounding allows"
    if ENDED in result:
        return unfinished_check(name, place, result, terms)
    _, apart = path_distances(runs[terms.backend], runs[terms.reference])
    estimate = runs[terms.reference].result.estimate
    _, i, j = np.intersect1d(estimate.stamps_ns, result["stamps_ns"], return_indices=True)
    distances = [rms(np.linalg.norm(path[j, :2] - estimate.poses[i, :2], axis=1)) for path in result["paths"]]
    known = np.array([one for one in distances if np.isfinite(one)])
    random_walk = math.sqrt(len(i)) * (margin[0] + margin[1] * estimate.path_m) if margin else 0.0
    predicted = _prediction_bound(known) if len(known) > 1 else 0.0
    observed = f"{rms(apart):.2g} m apart (RMS over the run)"
    detail = (
        f"{terms.reference} itself, over {len(known)} copies of the sequence with ranges perturbed by rounding: "
        f"{', '.join(f'{one:.2g}' for one in known)} m from its own path"
    )
    bound = max(random_walk, predicted)
    reason = (
        f"{bound:.2g} m: the larger of the rounding of {len(i)} scans summed as a random walk, {random_walk:.2g} m, "
        f"and the 95 % bound for one more perturbed copy, {predicted:.2g} m"
    )
    return Check(name, place, "passed" if rms(apart) <= bound else "failed", "equal", observed, reason, detail)


def _prediction_bound(values: Floats) -> float:
    """The upper 95 % bound of one more value: Student's t on logarithms, with a spread of at least a factor of two."""
    logarithms = np.log(np.maximum(values, MIN_M))
    spread = max(float(logarithms.std(ddof=1)), math.log(2.0))
    quantile = student_quantile(len(values) - 1, CONFIDENCE)
    return math.exp(float(logarithms.mean()) + quantile * spread * math.sqrt(1.0 + 1.0 / len(values)))


def _pooled_errors(
    runs: Sequence[Mapping[str, RunRecord]], a: str, b: str, quantity: str
) -> tuple[Floats, Floats, int]:
    """Errors (N,) of two methods at the same scans of all runs, and the number of scans in a block of ten seconds."""
    errors_a, errors_b, block = [], [], 1
    for run in runs:
        one, other = compute_errors(run[a]), compute_errors(run[b])
        _, i, j = np.intersect1d(one.stamps_ns, other.stamps_ns, return_indices=True)
        pair = np.stack([getattr(one, quantity)[i], getattr(other, quantity)[j]])
        known = np.isfinite(pair).all(axis=0)
        errors_a.append(pair[0, known])
        errors_b.append(pair[1, known])
        block = max(block, block_length(max(len(i), 1), period_ns(run[a].result) * 1e-9))
    return np.concatenate(errors_a), np.concatenate(errors_b), block


TITLES = {"ate": "error of the path (ATE RMSE)", "rpe": "error of the motion over one second (RPE RMSE)"}


def _no_larger_error(
    sequence: str, runs: Sequence[Mapping[str, RunRecord]], terms: ComparisonTerms, quantity: str
) -> Check:
    """The check that the error exceeds the reference's by at most a share of the reference's own uncertainty."""
    errors, reference, block = _pooled_errors(runs, terms.backend, terms.reference, quantity)
    if len(errors) < MIN_SCANS:
        return Check(TITLES[quantity], sequence, "not applicable", "never", "no true path to compare with")
    rng = np.random.default_rng(0)
    own = bootstrap_interval(reference, rms, rng, block, confidence=CONFIDENCE)
    gap = paired_difference_interval(errors, reference, rng, block, rms, CONFIDENCE)
    margin = terms.noise_share * 0.5 * (own.high - own.low)
    observed = f"{rms(errors):.4g} m, {terms.reference} {rms(reference):.4g} m; difference {_format_gap(gap)}"
    reason = (
        f"{margin:.2g} m: {terms.noise_share:g} of half the 90 % interval of the error of {terms.reference}, "
        f"[{own.low:.3g}, {own.high:.3g}] m by blocks of {block} scans"
    )
    outcome, hint = judge_gap(gap.value, gap.low, gap.high, margin, len(errors))
    if np.array_equal(errors, reference):
        outcome, hint = "passed", "the errors are equal to the bit"
    name = f"{TITLES[quantity]} no larger than that of {terms.reference}"
    return Check(name, sequence, outcome, "as-good", observed, reason, hint)


def _error_beside_peer(
    sequence: str, runs: Sequence[Mapping[str, RunRecord]], terms: ComparisonTerms, peer: str
) -> Check | None:
    """The error compared with that of another method; decides nothing."""
    name = f"compared with {peer}"
    shared = [run for run in runs if _have_answers(run, terms.backend, peer)]
    if not shared:
        reasons = dict.fromkeys(run[peer].result.reason for run in runs if peer in run and run[peer].result.reason)
        return Check(name, sequence, "not applicable", "never", f"{peer} has no run: {'; '.join(reasons)}")
    errors, others, block = _pooled_errors(shared, terms.backend, peer, "ate")
    if len(errors) < MIN_SCANS:
        return None
    gap = paired_difference_interval(errors, others, np.random.default_rng(0), block, rms, CONFIDENCE)
    order = "larger" if gap.low > 0.0 else "smaller" if gap.high < 0.0 else "no significant difference"
    observed = f"ATE RMSE {rms(errors):.4g} m, {peer} {rms(others):.4g} m: {order}; difference {_format_gap(gap)}"
    return Check(name, sequence, "informative", "never", observed)


def _same_map(
    place: str, runs: Mapping[str, RunRecord], margin: tuple[float, float] | None, terms: ComparisonTerms
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
    bound, _ = _path_bound(margin, len(run.steps), run.estimate.path_m)
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
        if _sequence_of(place) == sequence and all("map_f1" in runs[label].scores.by_metric for label in labels)
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
    half = student_quantile(len(known) - 1, CONFIDENCE) * float(losses.std(ddof=1)) / math.sqrt(len(known))
    lost = float(losses.mean())
    outcome, hint = judge_gap(lost, lost - half, lost + half, margin, len(known))
    if (lost <= 0.0 and outcome == "not shown") or not losses.any():
        outcome, hint = "passed", "no loss was observed"
    reason = (
        f"{margin:.2g}: {terms.noise_share:g} of the standard deviation of {terms.reference} over {len(known)} seeds"
    )
    return Check(name, sequence, outcome, "as-good", observed, reason, hint)


def _format_gap(gap: Interval) -> str:
    return f"{gap.value:.2g} m (90 % [{gap.low:.2g}, {gap.high:.2g}])"
