"""The report in sentences, made from the numbers: who won where, by how much, what failed, and what cannot be told."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

import numpy as np

from evalkit.metrics.table import Metric
from evalkit.report.comparison import Comparison
from evalkit.report.standings import (
    NOT_POSSIBLE,
    STATUS,
    WITH_TRUTH,
    Cell,
    Standing,
    contestant_of,
    deciding,
    noise_floor,
    standing,
    unfinished,
    worse,
)
from evalkit.types import Trial

Outcome = Literal["winner", "level", "unrivalled", "degenerate", "nothing"]


@dataclass(frozen=True, slots=True)
class Verdict:
    """What one sequence says. ``leaders``: the winner, or all that are level. ``counts``: whether it enters the tally
    of wins, which takes truth and a geometry that fixes the pose."""

    sequence: str
    outcome: Outcome
    counts: bool
    leaders: tuple[str, ...]
    sentences: tuple[str, ...]


def verdict(comparison: Comparison, sequence: str) -> Verdict:
    """The verdict over one sequence: success first, then who leads, then the paper's method, the bar and the cost."""
    found = deciding(comparison, sequence)
    degenerate = comparison.sequences[sequence].degenerate
    outcome = _outcome(found, degenerate)
    sentences = [_success(comparison.of_sequence(sequence))]
    if degenerate:
        sentences.append(f"Degenerate by design: {_plain(degenerate)}. The order below is no ranking.")
    if found is None:
        sentences.append("No headline metric has a value here, so nobody can be ranked.")
    else:
        sentences.append(_leaders(found, outcome))
        sentences += [_paper(comparison, found) if not degenerate else "", _bar(comparison, found), *_caveats(found)]
    sentences.append(_cost(comparison, sequence))
    leaders = tuple(cell.contestant for cell in found.level) if found and outcome in ("winner", "level") else ()
    counts = outcome in ("winner", "level") and found is not None and found.metric.group in WITH_TRUTH
    return Verdict(sequence, outcome, counts, leaders, tuple(s for s in sentences if s))


def overview(comparison: Comparison, verdicts: Sequence[Verdict]) -> tuple[str, ...]:
    """The whole comparison in a few sentences: success, wins, the paper's method, the bar, speed, what is unsaid."""
    sentences = [
        _success(comparison.trials),
        _tally(verdicts),
        *(_paper_tally(label, verdicts) for label in contestant_of(comparison, "paper")),
        _bar_tally(comparison),
        _keeping_up(comparison),
        _set_aside(comparison, verdicts),
        _evidence(comparison),
    ]
    return tuple(sentence for sentence in sentences if sentence)


def amount(metric: Metric, value: float) -> str:
    """A value as printed, with its unit, never broken apart: "0.014 m"."""
    return f"{value:.{metric.digits}f}\u00a0{metric.unit}".rstrip()


def spread(metric: Metric, values: Sequence[float]) -> str:
    """The median with lowest and highest of several runs: "0.014 m (0.012 to 0.016)"."""
    middle = amount(metric, median(values))
    if len(values) < 2:
        return middle
    return f"{middle} ({min(values):.{metric.digits}f} to {max(values):.{metric.digits}f})"


def gap(metric: Metric, value: float, best: float) -> str:
    """How far a value is from a better one: "4.8 times as much", "12 % more" or "0.120 less"."""
    if metric.better == "lower" and best > 0.0:
        ratio = value / best
        return f"{ratio:.1f} times as much" if ratio >= 2.0 else f"{100.0 * (ratio - 1.0):.0f} % more"
    direction = "more" if metric.better == "lower" else "less"
    return f"{amount(metric, abs(value - best))} {direction}"


def joined(words: Iterable[str]) -> str:
    """Words as a list in a sentence: "a, b and c"."""
    listed = list(words)
    return listed[0] if len(listed) == 1 else f"{', '.join(listed[:-1])} and {listed[-1]}" if listed else "none"


def _outcome(found: Standing | None, degenerate: str) -> Outcome:
    if degenerate:
        return "degenerate"
    if found is None or not found.ranked:
        return "nothing"
    if len(found.ranked) == 1:
        return "unrivalled"
    return "winner" if found.winner else "level"


def _success(trials: Sequence[Trial]) -> str:
    """How many runs finished; then what could not start here, and what did not finish, by contestant."""
    missing = unfinished(trials)
    absent = [trial for trial in missing if trial.run.status in NOT_POSSIBLE]
    broken = [trial for trial in missing if trial.run.status not in NOT_POSSIBLE]
    expected = Counter(trial.contestant for trial in trials)
    sentences = [f"{len(trials) - len(missing)} of {len(trials)} runs finished."]
    if broken:
        sentences.append(f"Did not finish: {_ends(broken, expected)}.")
    if absent:
        sentences.append(f"Could not start: {_ends(absent, expected)}.")
    return " ".join(sentences)


def _ends(trials: Sequence[Trial], expected: Mapping[str, int]) -> str:
    ends: dict[str, Counter[str]] = {}
    for trial in trials:
        ends.setdefault(trial.contestant, Counter())[STATUS[trial.run.status]] += 1
    return joined(
        f"{who} ({', '.join(f'{count} of {expected[who]} {end}' for end, count in counts.items())})"
        for who, counts in ends.items()
    )


def _leaders(found: Standing, outcome: Outcome) -> str:
    metric, ranked = found.metric, found.ranked
    if not ranked:
        return f"Nobody completed every run with a value for {metric.label}, so nobody can win."
    first = f"{ranked[0].contestant} has {spread(metric, ranked[0].values)}"
    if len(ranked) == 1:
        return f"Only {first} {metric.label} over every run: there is nobody to compare it with."
    if outcome == "degenerate":
        return f"On {metric.label}, {first}, {_last(metric, ranked)}."
    if outcome == "winner":
        verb = "wins" if metric.group in WITH_TRUTH else "is ahead"
        return f"{ranked[0].contestant} {verb} on {metric.label}: {_lead(metric, ranked[0], ranked[1])}."
    level = joined(f"{cell.contestant} {spread(metric, cell.values)}" for cell in found.level)
    return f"No clear winner on {metric.label}: {level} {_why_level(found)}."


def _lead(metric: Metric, winner: Cell, runner_up: Cell) -> str:
    best, second = median(winner.values), median(runner_up.values)
    return (
        f"{spread(metric, winner.values)}; the runner-up, {runner_up.contestant}, "
        f"has {spread(metric, runner_up.values)}, {gap(metric, second, best)}"
    )


def _last(metric: Metric, ranked: Sequence[Cell]) -> str:
    return f"and the last of those who finished, {ranked[-1].contestant}, {spread(metric, ranked[-1].values)}"


def _why_level(found: Standing) -> str:
    if found.why_level == "within the noise floor":
        return f"differ by less than the truth can tell ({amount(found.metric, noise_floor(found.metric))})"
    return "overlap over their seeds" if found.why_level == "overlapping seeds" else "are equal as printed"


def _paper(comparison: Comparison, found: Standing) -> str:
    labels = contestant_of(comparison, "paper")
    clauses = [_paper_clause(label, found) for label in labels if found.of(label)]
    return f"The paper's method: {'; '.join(clauses)}." if clauses and found.ranked else ""


def _paper_clause(label: str, found: Standing) -> str:
    cell = found.of(label)
    if cell is None or not cell.rankable:
        count = f"{cell.complete} of {cell.expected}" if cell else "none"
        return f"{label} cannot be ranked ({count} of its runs finished)"
    if found.winner is cell:
        return f"{label} {'wins' if found.metric.group in WITH_TRUTH else 'is ahead'}"
    if cell in found.level:
        return f"{label} is level with the best"
    best, own = median(found.ranked[0].values), median(cell.values)
    verb = "loses" if found.metric.group in WITH_TRUTH else "is behind"
    figures = f"{amount(found.metric, own)} against {amount(found.metric, best)}"
    return f"{label} {verb}, with {figures}: {gap(found.metric, own, best)}"


def _bar(comparison: Comparison, found: Standing) -> str:
    for bar in contestant_of(comparison, "bar"):
        measure = found.of(bar)
        if measure is None or measure.median is None:
            return f"{bar} has no value here, so the others have no bar to pass."
        behind = [cell for cell in found.cells if worse(found.metric, cell, measure)]
        if behind:
            listed = joined(f"{cell.contestant} ({amount(found.metric, median(cell.values))})" for cell in behind)
            return f"Worse than {bar} alone ({amount(found.metric, measure.median)}): {listed}."
    return ""


def _caveats(found: Standing) -> list[str]:
    caveats = []
    if found.metric.group == "map consistency":
        blind = _plain(found.metric.blind_to)
        caveats.append(f"There is no truth here: {found.metric.label} compares maps only, and is blind to {blind}.")
    if found.ranked and all(len(cell.values) == 1 for cell in found.ranked):
        caveats.append("One run each: how much repetitions would differ is not known.")
    return caveats


def _cost(comparison: Comparison, sequence: str) -> str:
    for metric in comparison.metrics:
        if metric.group == "runtime" and metric.headline and metric.better:
            ranked = standing(comparison, sequence, metric).ranked
            if len(ranked) > 1:
                first, last = (f"{c.contestant} ({amount(metric, median(c.values))})" for c in (ranked[0], ranked[-1]))
                return f"{metric.label[0].upper()}{metric.label[1:]}: best {first}, worst {last}."
    return ""


def _tally(verdicts: Sequence[Verdict]) -> str:
    counted = [v for v in verdicts if v.counts]
    if not counted:
        return "No sequence has both a truth and a clear comparison, so there is no overall winner."
    wins: dict[str, list[str]] = {}
    for v in counted:
        if v.outcome == "winner":
            wins.setdefault(v.leaders[0], []).append(v.sequence)
    order = sorted(wins.items(), key=lambda item: -len(item[1]))
    parts = [f"{who} wins {len(where)} ({', '.join(where)})" for who, where in order]
    level = [v.sequence for v in counted if v.outcome == "level"]
    if level:
        parts.append(f"there is no clear winner on {len(level)} ({', '.join(level)})")
    count = "the one sequence" if len(counted) == 1 else f"the {len(counted)} sequences"
    return f"Over {count} with truth and a geometry that fixes the pose, {joined(parts)}."


def _paper_tally(label: str, verdicts: Sequence[Verdict]) -> str:
    counted = [v for v in verdicts if v.counts]
    if not counted:
        return ""
    wins = [v.sequence for v in counted if v.outcome == "winner" and label in v.leaders]
    level = [v.sequence for v in counted if v.outcome == "level" and label in v.leaders]
    losses = [v.sequence for v in counted if label not in v.leaders]
    parts = [
        f"{verb} {len(where)} of {len(counted)} ({', '.join(where)})"
        for verb, where in (("loses", losses), ("is level with the best on", level), ("wins", wins))
        if where
    ]
    return f"The paper's method, {label}, {joined(parts)}."


def _bar_tally(comparison: Comparison) -> str:
    bars = contestant_of(comparison, "bar")
    if not bars:
        return "Wheel odometry alone is not among the contestants, so nobody was held against it."
    behind: dict[str, list[str]] = {}
    for sequence in comparison.sequence_labels:
        found = deciding(comparison, sequence)
        if found is not None:
            for cell in found.cells:
                if worse(found.metric, cell, found.of(bars[0])):
                    behind.setdefault(cell.contestant, []).append(sequence)
    if not behind:
        return f"Where it could be compared, nobody is worse than {bars[0]} alone."
    return f"Worse than {bars[0]} alone: {joined(f'{who} on {joined(where)}' for who, where in behind.items())}."


def _keeping_up(comparison: Comparison) -> str:
    late = []
    for trial in comparison.trials:
        share = late_share(trial)
        if share > 0.01:
            late.append((trial.contestant, trial.sequence))
    if not late:
        return "Everybody keeps up with the sensors: at most 1 % of any run's scans took longer than the scan period."
    where: dict[str, list[str]] = {}
    for who, sequence in dict.fromkeys(late):
        where.setdefault(who, []).append(sequence)
    listed = joined(f"{who} on {joined(places)}" for who, places in where.items())
    return f"Slower than the sensor in more than 1 % of the scans: {listed}."


def late_share(trial: Trial) -> float:
    """The share of a run's scans whose wall time exceeded the median scan period; 0 without scans."""
    steps = trial.run.steps
    if len(steps) < 2:
        return 0.0
    return float(np.mean(steps["wall_ns"] > np.median(np.diff(steps["stamp_ns"]))))


def _set_aside(comparison: Comparison, verdicts: Sequence[Verdict]) -> str:
    aside = [v.sequence for v in verdicts if not v.counts]
    unrun = [s for s in aside if len(unfinished(comparison.of_sequence(s))) == len(comparison.of_sequence(s))]
    degenerate = [s for s in aside if s not in unrun and comparison.sequences[s].degenerate]
    rest = [s for s in aside if s not in (*unrun, *degenerate)]
    groups = ((degenerate, "degenerate geometry"), (rest, "no truth, or nobody to compare"), (unrun, "no run finished"))
    parts = [f"{joined(labels)} ({why})" for labels, why in groups if labels]
    return f"Not counted as wins or losses: {joined(parts)}." if parts else ""


def _evidence(comparison: Comparison) -> str:
    runs = Counter((trial.contestant, trial.sequence) for trial in comparison.trials)
    most = max(runs.values(), default=0)
    if most < 2:
        return "Every sequence was run once: there is no spread, and small differences mean nothing."
    return (
        f"Numbers are medians over up to {most} seeds with the lowest and highest in brackets; overlapping ranges "
        "count as level. This is no significance test."
    )


def _plain(text: str) -> str:
    return text.rstrip(". ")
