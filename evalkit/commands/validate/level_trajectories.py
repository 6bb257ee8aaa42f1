"""Level 3 of an acceptance report: the trajectories of whole runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from evalkit.commands.validate.acceptance import AcceptanceLevel, Check
from evalkit.commands.validate.comparison_terms import ComparisonTerms
from evalkit.commands.validate.equivalence.margins import FLOAT32
from evalkit.commands.validate.known_motion import judge_gap
from evalkit.commands.validate.level_answers import unfinished_check, waive
from evalkit.commands.validate.run_paths import (
    CONFIDENCE,
    Records,
    ScanMargin,
    ScanMargins,
    have_answers,
    path_bound,
    path_distances,
    pooled_errors,
    sequence_of,
)
from evalkit.core.se2 import Floats
from evalkit.execution.sandbox import ENDED
from evalkit.execution.task import Result
from evalkit.metrics.trajectory import rms
from evalkit.results.run_record import RunRecord
from evalkit.stats.bootstrap import bootstrap_interval, paired_difference_interval
from evalkit.stats.intervals import Interval, student_quantile
from evalkit.stats.runs import mean_interval

MIN_M = 1e-12
"""Paths closer than this count as identical."""

MIN_SCANS = 10
"""Fewest scans with a known truth from which an interval is computed."""

TITLES = {"ate": "error of the path (ATE RMSE)", "rpe": "error of the motion over one second (RPE RMSE)"}


def trajectories_level(
    records: Records, margins: ScanMargins, perturbed: Mapping[str, Result], terms: ComparisonTerms
) -> AcceptanceLevel:
    """Level 3; ``perturbed``: the reference's paths over copies of a sequence perturbed by rounding, for float32."""
    checks: list[Check | None] = [*_complete_runs({place: runs[terms.backend] for place, runs in records.items()})]
    both = {place: runs for place, runs in records.items() if have_answers(runs, terms.backend, terms.reference)}
    for place, runs in both.items():
        checks.append(_same_path("path", place, runs, margins.get(place), terms))
        checks += _same_corrections(place, runs, margins.get(place), terms)
    checks += [
        _within_rounding(place, both[place], result, margins.get(place), terms)
        for place, result in perturbed.items()
        if place in both
    ]
    for sequence in dict.fromkeys(map(sequence_of, both)):
        runs_here = [runs for place, runs in both.items() if sequence_of(place) == sequence]
        checks += [_no_larger_error(sequence, runs_here, terms, quantity) for quantity in TITLES]
        checks += [_error_beside_peer(sequence, runs_here, terms, peer) for peer in terms.peers]
    question = f"Does a whole run follow the path of {terms.reference}, and is it as close to the truth?"
    known = tuple(one for one in checks if one)
    return waive(AcceptanceLevel(3, "trajectories", question, known, {"records": records}), terms.waivers)


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
    place: str, runs: Mapping[str, RunRecord], margin: ScanMargin | None, terms: ComparisonTerms
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
    margin: ScanMargin | None,
    terms: ComparisonTerms,
) -> Check | None:
    """The check that the path is the reference's; informative in single precision, where a tie may change a path."""
    if margin is None:
        return None
    seconds, apart = path_distances(runs[terms.backend], runs[terms.reference])
    bound, reason = path_bound(margin, len(apart), runs[terms.reference].result.estimate.path_m)
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


def _within_rounding(
    place: str,
    runs: Mapping[str, RunRecord],
    result: Result,
    margin: ScanMargin | None,
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


def _no_larger_error(
    sequence: str, runs: Sequence[Mapping[str, RunRecord]], terms: ComparisonTerms, quantity: str
) -> Check:
    """The check that the error exceeds the reference's by at most a share of the reference's own uncertainty."""
    errors, reference, block = pooled_errors(runs, terms.backend, terms.reference, quantity)
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
    if outcome == "failed" and quantity == "ate" and not _is_shown_by_runs(runs, terms, margin):
        outcome = "not shown"
        hint = f"the loss of the {len(runs)} runs exceeds the margin; whether others lose, too, more --seeds would show"
    if np.array_equal(errors, reference):
        outcome, hint = "passed", "the errors are equal to the bit"
    name = f"{TITLES[quantity]} no larger than that of {terms.reference}"
    return Check(name, sequence, outcome, "as-good", observed, reason, hint)


def _is_shown_by_runs(runs: Sequence[Mapping[str, RunRecord]], terms: ComparisonTerms, margin: float) -> bool:
    """Whether the mean loss of a run (m) exceeds a margin (m), by Student's t: the scans of one run drift together."""
    pairs = [pooled_errors([run], terms.backend, terms.reference, "ate")[:2] for run in runs]
    losses = np.array([rms(own) - rms(other) for own, other in pairs if len(own)])
    return len(losses) > 1 and mean_interval(losses, CONFIDENCE).low > margin


def _error_beside_peer(
    sequence: str, runs: Sequence[Mapping[str, RunRecord]], terms: ComparisonTerms, peer: str
) -> Check | None:
    """The error compared with that of another method; decides nothing."""
    name = f"compared with {peer}"
    shared = [run for run in runs if have_answers(run, terms.backend, peer)]
    if not shared:
        reasons = dict.fromkeys(run[peer].result.reason for run in runs if peer in run and run[peer].result.reason)
        return Check(name, sequence, "not applicable", "never", f"{peer} has no run: {'; '.join(reasons)}")
    errors, others, block = pooled_errors(shared, terms.backend, peer, "ate")
    if len(errors) < MIN_SCANS:
        return None
    gap = paired_difference_interval(errors, others, np.random.default_rng(0), block, rms, CONFIDENCE)
    order = "larger" if gap.low > 0.0 else "smaller" if gap.high < 0.0 else "no significant difference"
    observed = f"ATE RMSE {rms(errors):.4g} m, {peer} {rms(others):.4g} m: {order}; difference {_format_gap(gap)}"
    return Check(name, sequence, "informative", "never", observed)


def _format_gap(gap: Interval) -> str:
    return f"{gap.value:.2g} m (90 % [{gap.low:.2g}, {gap.high:.2g}])"
