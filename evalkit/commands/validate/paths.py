"""Levels 3 and 4 of a dossier: whole runs, and the maps drawn of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from evalkit.commands.validate.acceptance import Level, Line
from evalkit.commands.validate.answers import Names, ended, words
from evalkit.commands.validate.equivalence.map_cells import Layers
from evalkit.core import se2
from evalkit.core.se2 import Floats
from evalkit.execution.sandbox import ENDED
from evalkit.execution.task import Result
from evalkit.metrics.runtime import period_ns
from evalkit.metrics.trajectory import MAX_GAP_S, can_interpolate, rms
from evalkit.results.run_record import RunRecord
from evalkit.stats.bootstrap import block_length, bootstrap_interval, paired_difference_interval
from evalkit.stats.intervals import Interval

CONFIDENCE = 0.90
"""Of all intervals: two one-sided tests at 5 %."""

MIN_M = 1e-12
"""Paths nearer than this are the same."""

FEWEST = 10
"""Scans whose truth must be known for an interval."""

Trials = Mapping[str, Mapping[str, RunRecord]]
"""Runs by place ("room, seed 0") and by method."""

Margins = Mapping[str, tuple[float, float]]
"""What one scan may differ by at a place: metres, radians."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of one run: stamps (N,), distance to the truth (N,), and of the motion over about a second (N,); nan."""

    stamps_ns: Floats
    ate: Floats
    rpe: Floats


def paths(records: Trials, margins: Margins, rounded: Mapping[str, Result], names: Names) -> Level:
    """Level 3; ``rounded``: the twin's paths over copies of a sequence that rounding has changed, for float32."""
    lines: list[Line | None] = [*_whole({place: runs[names.mine] for place, runs in records.items()})]
    both = {place: runs for place, runs in records.items() if _answered(runs, names.mine, names.twin)}
    lines += [_same_path(place, runs, margins.get(place), names) for place, runs in both.items()]
    lines += [
        _as_rounded(place, both[place], result, margins.get(place), names)
        for place, result in rounded.items()
        if place in both
    ]
    for sequence in dict.fromkeys(map(_sequence, both)):
        here = [runs for place, runs in both.items() if _sequence(place) == sequence]
        lines += [_as_good(sequence, here, names, what) for what in TITLES]
        lines += [_against(sequence, here, names, other) for other in names.against]
    question = f"Does a whole run end where {names.twin}'s does, and is it as near to the truth?"
    return Level(3, "trajectories", question, tuple(line for line in lines if line), {"trials": records})


def maps(
    records: Trials, margins: Margins, drawn: Mapping[str, Result], mappers: tuple[str, str], names: Names
) -> Level:
    """Level 4; ``drawn``: comparisons of its own mapper with the twin's, by place."""
    both = {
        place: runs
        for place, runs in records.items()
        if _answered(runs, names.mine, names.twin) and runs[names.mine].scores.grid is not None
        and runs[names.twin].scores.grid is not None
    }  # fmt: skip
    lines: list[Line | None] = [_same_map(place, runs, margins.get(place), names) for place, runs in both.items()]
    lines += [_f1(sequence, both, names) for sequence in dict.fromkeys(map(_sequence, both))]
    lines += [_drawn(place, result, mappers, names) for place, result in drawn.items()]
    if not mappers[0]:
        lines.append(Line("its own mapper", "", "not applicable", "", "it comes with none; name one with --mapper"))
    question = f"Is the map drawn of its path {names.twin}'s map, cell by cell, and as true?"
    return Level(4, "maps", question, tuple(line for line in lines if line), {"trials": records})


def errors(record: RunRecord) -> Errors:
    """Errors of a run against the truth, nan where the truth is not known."""
    run, truth = record.result, record.truth.trajectory
    stamps = run.steps["stamp_ns"]
    nothing = np.full(len(stamps), np.nan)
    if truth is None or record.scores.errors_m is None or len(stamps) < 3:
        return Errors(stamps, nothing, nothing)
    rpe, gap = nothing.copy(), max(1, round(1e9 / max(period_ns(run), 1.0)))
    known = np.flatnonzero(can_interpolate(truth.stamps_ns, stamps, MAX_GAP_S))
    first = np.intersect1d(known, known - gap)
    true = se2.between(truth.at(stamps[first]), truth.at(stamps[first + gap]))
    poses = run.estimate.poses
    apart = se2.between(true, se2.between(poses[first], poses[first + gap]))
    rpe[first] = np.hypot(apart[:, 0], apart[:, 1])
    return Errors(stamps, np.asarray(record.scores.errors_m), rpe)


def distances(mine: RunRecord, theirs: RunRecord) -> tuple[Floats, Floats]:
    """Seconds (N,) since the first scan both answered, and how far apart (m) both were then, from the same start."""
    stamps, a, b = np.intersect1d(mine.result.steps["stamp_ns"], theirs.result.steps["stamp_ns"], return_indices=True)
    if not len(stamps):
        return np.zeros(0), np.zeros(0)
    apart = mine.result.estimate.poses[a, :2] - theirs.result.estimate.poses[b, :2]
    return (stamps - stamps[0]) * 1e-9, np.asarray(np.linalg.norm(apart, axis=1))


def _sequence(place: str) -> str:
    return place.partition(",")[0]


def _answered(runs: Mapping[str, RunRecord], *labels: str) -> bool:
    return all(label in runs and len(runs[label].result.steps) > 2 for label in labels)


def _whole(runs: Mapping[str, RunRecord]) -> list[Line]:
    """One line for all runs that came to their end, one for each that did not."""
    ended_well = [place for place, record in runs.items() if record.result.is_complete]
    lines = []
    for place, record in runs.items():
        run = record.result
        if place not in ended_well:
            told = f"{run.status}: {run.reason}"
            answered = f"{len(run.steps)} of {run.expected} scans answered"
            lines.append(Line("runs to the end", place, "failed", "always", told, detail=answered))
    if ended_well:
        scans = sum(len(runs[place].result.steps) for place in ended_well)
        told = f"{len(ended_well)} of {len(runs)} runs complete, {scans} scans answered"
        lines.append(Line("runs to the end", "", "passed", "always", told, detail="; ".join(ended_well)))
    return lines


def _same_path(
    place: str, runs: Mapping[str, RunRecord], margin: tuple[float, float] | None, names: Names
) -> Line | None:
    """In double precision nothing but rounding parts two equal methods; in single precision a tie may lead far."""
    if margin is None:
        return None
    seconds, apart = distances(runs[names.mine], runs[names.twin])
    bound, reason = _bound(margin, len(apart), runs[names.twin].result.estimate.path_m)
    worst = int(np.argmax(apart))
    beyond = np.flatnonzero(apart > bound)
    told = f"largest distance {apart[worst]:.2g} m, at {seconds[worst]:.1f} s; at the end {apart[-1]:.2g} m"
    if names.margin == "float32":
        why = "where single precision breaks a tie otherwise the ways part: how far rounding may lead is asked below"
        return Line(f"the path of {names.twin}", place, "told", "", told, reason, why)
    if len(beyond):
        told = f"beyond the margin from scan {beyond[0] + 1} ({seconds[beyond[0]]:.1f} s) on; {told}"
    return Line(f"the path of {names.twin}", place, "failed" if len(beyond) else "passed", "equal", told, reason)


def _bound(margin: tuple[float, float], scans: int, path_m: float) -> tuple[float, str]:
    metres, radians = margin
    bound = scans * (metres + radians * path_m)
    return bound, f"{bound:.2g} m: {scans} scans, each {metres:.2g} m and {radians:.2g} rad over {path_m:.1f} m of path"


def _as_rounded(
    place: str, runs: Mapping[str, RunRecord], result: Result, margin: tuple[float, float] | None, names: Names
) -> Line:
    """Whether the path lies no farther from the twin's than rounding may lead."""
    name = f"as near to {names.twin}'s path as rounding allows"
    if ENDED in result:
        return ended(name, place, result, names)
    _, apart = distances(runs[names.mine], runs[names.twin])
    own = runs[names.twin].result.estimate
    _, i, j = np.intersect1d(own.stamps_ns, result["stamps_ns"], return_indices=True)
    moved = [rms(np.linalg.norm(path[j, :2] - own.poses[i, :2], axis=1)) for path in result["paths"]]
    known = np.array([one for one in moved if np.isfinite(one)])
    drifted = math.sqrt(len(i)) * (margin[0] + margin[1] * own.path_m) if margin else 0.0
    parted = _one_more(known) if len(known) > 1 else 0.0
    told = f"{rms(apart):.2g} m apart (RMS over the run)"
    copies = (
        f"{names.twin} itself, over {len(known)} copies whose ranges were changed by as much as rounding may: "
        f"{', '.join(f'{one:.2g}' for one in known)} m from its own path"
    )
    reason = (
        f"{max(drifted, parted):.2g} m: the larger of what the budgets of {len(i)} scans add up to as a random walk, "
        f"{drifted:.2g} m, and of what one more copy would stay below with 95 %, {parted:.2g} m"
    )
    return Line(
        name, place, "passed" if rms(apart) <= max(drifted, parted) else "failed", "equal", told, reason, copies
    )


def _one_more(known: Floats) -> float:
    """What one more value would stay below with 95 %: Student's t on logarithms, which spread by two at least."""
    logarithms = np.log(np.maximum(known, MIN_M))
    spread = max(float(logarithms.std(ddof=1)), math.log(2.0))
    reach = stats.t.ppf(0.5 + 0.5 * CONFIDENCE, len(known) - 1) * spread * math.sqrt(1.0 + 1.0 / len(known))
    return math.exp(float(logarithms.mean()) + float(reach))


def _pooled(here: Sequence[Mapping[str, RunRecord]], a: str, b: str, what: str) -> tuple[Floats, Floats, int]:
    """Errors (N,) of two methods at the same scans of all runs, and the scans in a block of ten seconds."""
    mine, theirs, block = [], [], 1
    for runs in here:
        one, other = errors(runs[a]), errors(runs[b])
        _, i, j = np.intersect1d(one.stamps_ns, other.stamps_ns, return_indices=True)
        pair = np.stack([getattr(one, what)[i], getattr(other, what)[j]])
        known = np.isfinite(pair).all(axis=0)
        mine.append(pair[0, known])
        theirs.append(pair[1, known])
        block = max(block, block_length(max(len(i), 1), period_ns(runs[a].result) * 1e-9))
    return np.concatenate(mine), np.concatenate(theirs), block


TITLES = {"ate": "error of the path (ATE RMSE)", "rpe": "error of a second's motion (RPE RMSE)"}


def _as_good(sequence: str, here: Sequence[Mapping[str, RunRecord]], names: Names, what: str) -> Line:
    """Whether the error is no worse than the twin's, by more than a share of what the twin's own leaves open."""
    mine, theirs, block = _pooled(here, names.mine, names.twin, what)
    if len(mine) < FEWEST:
        return Line(TITLES[what], sequence, "not applicable", "", "no true path to hold both against")
    rng = np.random.default_rng(0)
    own = bootstrap_interval(theirs, rms, rng, block, confidence=CONFIDENCE)
    gap = paired_difference_interval(mine, theirs, rng, block, rms, CONFIDENCE)
    margin = names.share * 0.5 * (own.high - own.low)
    same = bool(np.array_equal(mine, theirs))
    told = f"{rms(mine):.4g} m against {rms(theirs):.4g} m; difference {_told(gap)}"
    reason = (
        f"{margin:.2g} m: {names.share:g} of half the 90 % interval of {names.twin}'s own error, [{own.low:.3g}, "
        f"{own.high:.3g}] m by blocks of {block} scans"
    )
    good = same or gap.high < margin
    name = f"{TITLES[what]} no larger than {names.twin}'s"
    return Line(name, sequence, "passed" if good else "failed", "as-good", told, reason)


def _against(sequence: str, here: Sequence[Mapping[str, RunRecord]], names: Names, other: str) -> Line | None:
    """How the error compares with another method's; decides nothing."""
    shared = [runs for runs in here if _answered(runs, names.mine, other)]
    if not shared:
        ends = dict.fromkeys(runs[other].result.reason for runs in here if other in runs and runs[other].result.reason)
        return Line(f"beside {other}", sequence, "not applicable", "", f"no run of it: {'; '.join(ends)}")
    mine, theirs, block = _pooled(shared, names.mine, other, "ate")
    if len(mine) < FEWEST:
        return None
    gap = paired_difference_interval(mine, theirs, np.random.default_rng(0), block, rms, CONFIDENCE)
    which = "larger" if gap.low > 0.0 else "smaller" if gap.high < 0.0 else "not told apart"
    told = f"ATE RMSE {rms(mine):.4g} m against {rms(theirs):.4g} m: {which}; difference {_told(gap)}"
    return Line(f"beside {other}", sequence, "told", "", told)


def _same_map(
    place: str, runs: Mapping[str, RunRecord], margin: tuple[float, float] | None, names: Names
) -> Line | None:
    mine, theirs = runs[names.mine].scores.grid, runs[names.twin].scores.grid
    if mine is None or theirs is None:
        return None
    layers = Layers.of(theirs, mine)
    seen = int(np.count_nonzero(layers.observed_a | layers.observed_b))
    values = int(np.count_nonzero(layers.differing(1e-5)))
    turned = int(np.count_nonzero(layers.differing(1e-5) & ((layers.a > 0.0) != (layers.b > 0.0))))
    told = f"{turned} of {seen} cells are a wall in one and not in the other; {values} hold another value"
    name = f"the map of {names.twin}, drawn by the same mapper"
    if margin is None or names.margin == "float32":
        return Line(name, place, "told", "", told)
    bound, _ = _bound(margin, len(runs[names.twin].result.steps), runs[names.twin].result.estimate.path_m)
    allowed = math.ceil(seen * bound / theirs.resolution_m)
    reason = (
        f"{allowed} of them: a path {bound:.2g} m off moves that share of {theirs.resolution_m:g} m cells over a border"
    )
    return Line(name, place, "passed" if values <= allowed else "failed", "equal", told, reason)


def _f1(sequence: str, both: Trials, names: Names) -> Line | None:
    """Whether the walls are as true as the twin's: over seeds, against how much the twin's own score varies."""
    scores = [
        [runs[label].scores.by_metric["map_f1"].value for label in (names.mine, names.twin)]
        for place, runs in both.items()
        if _sequence(place) == sequence
        and all("map_f1" in runs[label].scores.by_metric for label in (names.mine, names.twin))
    ]
    known = np.array([pair for pair in scores if None not in pair], dtype=np.float64)
    if not len(known):
        return None
    told = f"F1 at 10 cm {known[:, 0].mean():.3f} against {known[:, 1].mean():.3f}"
    name = f"walls as true as in {names.twin}'s map"
    if len(known) < 2:
        return Line(name, sequence, "told", "", f"{told}; one run cannot tell by how much it varies: more --seeds")
    margin = names.share * float(known[:, 1].std(ddof=1))
    lost = float((known[:, 1] - known[:, 0]).mean())
    reason = f"{margin:.2g}: {names.share:g} of the standard deviation of {names.twin}'s own over {len(known)} seeds"
    return Line(name, sequence, "passed" if lost <= margin else "failed", "as-good", told, reason)


def _drawn(place: str, result: Result, mappers: tuple[str, str], names: Names) -> Line:
    name = f"its mapper {mappers[0]} draws what {mappers[1]} draws"
    if ENDED in result:
        return ended(name, place, result, names)
    found = result["cells"]
    margin = f"{found['margin']['log_odds']:.2g} log-odds a cell: a grid is float32"
    first = words(found, Names(*mappers, names.margin, names.share), "scan")
    told = f"{found['n']} scans, cell by cell after each" + (f"; first {first}" if first else ", no cell differs")
    return Line(name, place, "passed" if found["equivalent"] else "failed", "always", told, margin)


def _told(gap: Interval) -> str:
    return f"{gap.value:.2g} m (90 % [{gap.low:.2g}, {gap.high:.2g}])"
