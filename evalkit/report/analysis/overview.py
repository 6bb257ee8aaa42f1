"""The whole comparison in a few sentences, made from the verdicts over its sequences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from evalkit.metrics.runtime import period_ns
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.map_agreement import behind_bar
from evalkit.report.analysis.standings import deciding, method_of, unfinished
from evalkit.report.analysis.verdict import Verdict, success
from evalkit.report.html.formatting import joined
from evalkit.results.run_record import RunRecord


def overview(comparison: Comparison, verdicts: Sequence[Verdict]) -> tuple[str, ...]:
    """The whole comparison in a few sentences: success, wins, the paper's method, the bar, speed, what is unsaid."""
    sentences = [
        success(comparison.records),
        _tally(verdicts),
        *(_paper_tally(label, verdicts) for label in method_of(comparison, "reference")),
        _bar_tally(comparison),
        _keeping_up(comparison),
        _set_aside(comparison, verdicts),
        _evidence(comparison),
    ]
    return tuple(sentence for sentence in sentences if sentence)


def _tally(verdicts: Sequence[Verdict]) -> str:
    counted = [v for v in verdicts if v.counts]
    if not counted:
        return "No sequence has both a truth and a clear comparison, so there is no overall winner."
    parts = [f"{who} wins {len(where)} ({', '.join(where)})" for who, where in _led(counted, "winner")]
    parts += [f"{who} is ahead in the one run of {', '.join(where)}" for who, where in _led(counted, "ahead")]
    level = [v.sequence for v in counted if v.outcome == "level"]
    if level:
        parts.append(f"no difference is shown between the best on {len(level)} ({', '.join(level)})")
    count = "the one sequence" if len(counted) == 1 else f"the {len(counted)} sequences"
    return f"Over {count} with truth and a geometry that fixes the pose, {joined(parts)}."


def _led(verdicts: Sequence[Verdict], outcome: str) -> list[tuple[str, list[str]]]:
    """Who leads where with that outcome, most first."""
    led: dict[str, list[str]] = {}
    for v in verdicts:
        if v.outcome == outcome:
            led.setdefault(v.leaders[0], []).append(v.sequence)
    return sorted(led.items(), key=lambda item: -len(item[1]))


def _paper_tally(label: str, verdicts: Sequence[Verdict]) -> str:
    counted = [v for v in verdicts if v.counts]
    if not counted:
        return ""
    groups = {
        "loses": [v.sequence for v in counted if label not in v.leaders and v.repeated],
        "is behind in the one run of": [v.sequence for v in counted if label not in v.leaders and not v.repeated],
        "shows no difference from the best on": [
            v.sequence for v in counted if v.outcome == "level" and label in v.leaders
        ],
        "is ahead in the one run of": [v.sequence for v in counted if v.outcome == "ahead" and label in v.leaders],
        "wins": [v.sequence for v in counted if v.outcome == "winner" and label in v.leaders],
    }
    parts = [
        f"{verb} {', '.join(where)}"
        if "one run" in verb
        else f"{verb} {len(where)} of {len(counted)} ({', '.join(where)})"
        for verb, where in groups.items()
        if where
    ]
    return f"The paper's method, {label}, {joined(parts)}."


def _bar_tally(comparison: Comparison) -> str:
    """Who is worse than the bar; "" where nobody else answered, for then nobody was held against it."""
    bars = method_of(comparison, "baseline")
    if not any(len(record.result.steps) for record in comparison.records if record.method not in bars):
        return ""
    if not bars:
        return "Wheel odometry alone is not among the methods, so nobody was held against it."
    behind: dict[str, list[str]] = {}
    held = False
    for sequence in comparison.sequence_labels:
        found = deciding(comparison, sequence)
        measure = found.of(bars[0]) if found else None
        if found is None or measure is None or not measure.values:
            continue
        held = held or any(cell.values for cell in found.cells if cell is not measure)
        for cell in behind_bar(comparison, found, bars[0]):
            behind.setdefault(cell.method, []).append(sequence)
    if behind:
        return f"Worse than {bars[0]} alone: {joined(f'{who} on {joined(where)}' for who, where in behind.items())}."
    if not held:
        return f"Nobody could be held against {bars[0]} alone: no sequence has a value of both."
    return f"Where it could be compared, nobody is clearly worse than {bars[0]} alone."


def _keeping_up(comparison: Comparison) -> str:
    """Who is slower than the sensor, of those who register and answered; "" where nobody did."""
    bars = method_of(comparison, "baseline")
    timed = [t for t in comparison.records if t.method not in bars and len(t.result.steps) > 1]
    timed = [record for record in timed if record.result.steps["wall_ns"].any()]
    if not timed:
        return ""
    where: dict[str, list[str]] = {}
    for who, sequence in dict.fromkeys((t.method, t.sequence) for t in timed if late_share(t) > 0.01):
        where.setdefault(who, []).append(sequence)
    if not where:
        return "Of all runs that answered, none took longer than the scan period on more than 1 % of its scans."
    listed = joined(f"{who} on {joined(places)}" for who, places in where.items())
    return f"Slower than the sensor in more than 1 % of the scans: {listed}."


def late_share(record: RunRecord) -> float:
    """The share of a run's scans whose wall time exceeded the sensor's period; 0 without scans."""
    steps = record.result.steps
    if len(steps) < 2:
        return 0.0
    return float(np.mean(steps["wall_ns"] > period_ns(record.result)))


def _set_aside(comparison: Comparison, verdicts: Sequence[Verdict]) -> str:
    aside = [v.sequence for v in verdicts if not v.counts]
    unrun = [s for s in aside if len(unfinished(comparison.of_sequence(s))) == len(comparison.of_sequence(s))]
    degenerate = [s for s in aside if s not in unrun and comparison.sequences[s].degenerate]
    rest = [s for s in aside if s not in (*unrun, *degenerate)]
    groups = ((degenerate, "degenerate geometry"), (rest, "no truth, or nobody to compare"), (unrun, "no run finished"))
    parts = [f"{joined(labels)} ({why})" for labels, why in groups if labels]
    return f"Not counted as wins or losses: {joined(parts)}." if parts else ""


def _evidence(comparison: Comparison) -> str:
    answered = [record for record in comparison.records if len(record.result.steps)]
    runs = Counter((record.method, record.sequence) for record in answered)
    if not runs:
        return ""
    most = max(runs.values())
    seeds = "Every sequence was run once, so intervals speak of these runs and not of a next one. "
    if most > 1:
        seeds = f"Numbers are medians over up to {most} seeds. "
    return (
        f"{seeds}A 95 % interval says between which bounds the number would lie had the robot met other stretches of "
        "the same kind; it is drawn from stretches of up to 10 s. Somebody leads only where the interval of the "
        "difference on the same scans excludes zero and the difference matters: at least 5 % and, of positions, 2 mm. "
        "It must do so against every other method: picking the leader after the fact then adds no false leads. "
        "That somebody is worse than the leader is said for each alone: of many, one may be so by chance, and a "
        "lead that was picked is rather too large than too small."
    )
