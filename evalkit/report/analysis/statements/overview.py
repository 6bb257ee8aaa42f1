"""The overview of a comparison in a few sentences, from the verdicts over its sequences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence

from evalkit.metrics.runtime import late_share, work_ns
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.ranking import Mark, mark
from evalkit.report.analysis.scores import WITH_TRUTH
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.statements.outcome import NOT_APART, VerdictOutcome
from evalkit.report.analysis.statements.verdict import ALL_TIED, SequenceVerdict, describe_success
from evalkit.report.formatting import join_words
from evalkit.stats.runs import FEW_CONFIDENCE, MIN_RUNS, PAIRED_CONFIDENCE

MAX_LATE_SHARE = 0.01

WITHOUT_RANKING: Mapping[VerdictOutcome, str] = {
    "lost": "no method held the track", "single": "one ranked method", "unranked": "none is ranked",
}  # fmt: skip
"""Why a sequence does not count whose methods are not ranked."""


def compute_overview(
    comparison: Comparison,
    sequences: Sequence[SequenceAnalysis],
    verdicts: Sequence[SequenceVerdict],
    in_title: Collection[str],
) -> tuple[str, ...]:
    """Return sentences on success, wins, the reference method, the baseline, speed, and the statistics used.

    ``in_title``: the sequences that the title counts.
    """
    pairs = list(zip(sequences, verdicts, strict=True))
    counted = [verdict for sequence, verdict in pairs if verdict.counts or _holds_alone(sequence, verdict, in_title)]
    sentences = [
        describe_success(comparison.records),
        _describe_wins(counted),
        *(
            _describe_reference(label, sequences, verdicts)
            for label in comparison.methods_with_role("reference")
            if counted
        ),
        _describe_baseline(comparison, sequences),
        _describe_speed(comparison),
        _describe_not_counted(sequences, verdicts, in_title),
        _describe_statistics(comparison),
    ]
    return tuple(sentence for sentence in sentences if sentence)


def _holds_alone(sequence: SequenceAnalysis, verdict: SequenceVerdict, in_title: Collection[str]) -> bool:
    """Return whether a sequence with ground truth counts for the one method that is ranked there."""
    truth = sequence.deciding is not None and sequence.deciding.metric.group in WITH_TRUTH
    return verdict.outcome == "single" and truth and verdict.sequence in in_title


def _describe_wins(counted: Sequence[SequenceVerdict]) -> str:
    if not counted:
        return "No sequence has both ground truth and repeated runs to compare, so there is no overall winner."
    parts = [f"{method} wins {len(where)} ({', '.join(where)})" for method, where in _group_leads(counted, "winner")]
    every = [verdict.sequence for verdict in counted if verdict.all_tied]
    tied = [
        verdict.sequence
        for verdict in counted
        if verdict.outcome == "tied" and len(verdict.leaders) > 1 and not verdict.all_tied
    ]
    undecided = [verdict.sequence for verdict in counted if verdict.outcome == "tied" and len(verdict.leaders) == 1]
    groups = (
        ("the best methods are tied", tied),
        ("all ranked methods are tied", every),
        ("too few runs show a leader", undecided),
        ("one method alone is ranked", [verdict.sequence for verdict in counted if verdict.outcome == "single"]),
    )
    for words, where in groups:
        if where:
            count = "1 sequence" if len(where) == 1 else f"{len(where)} sequences"
            parts.append(f"{words} on {count} ({', '.join(where)})")
    count = "the one sequence" if len(counted) == 1 else f"the {len(counted)} sequences"
    return f"Over {count} with ground truth and a geometry that determines the pose, {join_words(parts)}."


def _group_leads(verdicts: Sequence[SequenceVerdict], outcome: VerdictOutcome) -> list[tuple[str, list[str]]]:
    """Return the leading methods of that outcome with their sequences, most first."""
    led: dict[str, list[str]] = {}
    for verdict in verdicts:
        if verdict.outcome == outcome:
            led.setdefault(verdict.leaders[0], []).append(verdict.sequence)
    return sorted(led.items(), key=lambda item: -len(item[1]))


def _describe_reference(label: str, sequences: Sequence[SequenceAnalysis], verdicts: Sequence[SequenceVerdict]) -> str:
    marks = {
        verdict.sequence: mark(sequence.deciding, label)
        for sequence, verdict in zip(sequences, verdicts, strict=True)
        if verdict.counts and sequence.deciding is not None
    }
    groups: tuple[tuple[str, Mark], ...] = (
        ("loses", "worse"), ("lost the track on", "lost"), ("is not comparable on", "not comparable"),
        ("has too few runs to tell on", "undecided"),
        ("is tied with the best on", "tied"), ("wins", "best"),
    )  # fmt: skip
    found = [(verb, [where for where, standing in marks.items() if standing == wanted]) for verb, wanted in groups]
    parts = [f"{verb} {len(where)} of {len(marks)} ({', '.join(where)})" for verb, where in found if where]
    return f"The reference method, {label}, {join_words(parts)}."


def _describe_baseline(comparison: Comparison, sequences: Sequence[SequenceAnalysis]) -> str:
    """Return which methods are worse than the baseline; "" if no other method answered."""
    baselines = comparison.methods_with_role("baseline")
    if not any(len(run.result.steps) for run in comparison.records if run.method not in baselines):
        return ""
    if not baselines:
        return "Wheel odometry alone is not among the methods, so there is no baseline."
    behind: dict[str, list[str]] = {}
    compared = False
    for sequence in sequences:
        reference = sequence.deciding.of(baselines[0]) if sequence.deciding else None
        if sequence.deciding is None or reference is None or len(reference.values) < 2:
            continue
        compared = compared or any(
            len(score.values) > 1 for score in sequence.deciding.scores if score is not reference
        )
        for score in sequence.behind[baselines[0]]:
            behind.setdefault(score.method, []).append(sequence.label)
    if behind:
        listed = join_words(f"{method} on {join_words(where)}" for method, where in behind.items())
        return f"Worse than {baselines[0]} alone: {listed}."
    if not compared:
        return f"No method can be compared with {baselines[0]} alone: no sequence has repeated runs of both."
    return f"No method is clearly worse than {baselines[0]} alone on any sequence with repeated runs of both."


def _describe_speed(comparison: Comparison) -> str:
    """Return which methods are slower than the sensor, of those that register and answered; "" without any."""
    baselines = comparison.methods_with_role("baseline")
    timed = [run for run in comparison.records if run.method not in baselines and len(run.result.steps) > 1]
    timed = [run for run in timed if work_ns(run.result).any()]
    if not timed:
        return ""
    late: dict[str, list[str]] = {}
    slow = [run for run in timed if late_share(run.result) > MAX_LATE_SHARE]
    for method, sequence in dict.fromkeys((run.method, run.sequence) for run in slow):
        late.setdefault(method, []).append(sequence)
    if not late:
        return "No run took more CPU time than the scan period on more than 1 % of its scans."
    listed = join_words(f"{method} on {join_words(sequences)}" for method, sequences in late.items())
    return f"Slower than the sensor on more than 1 % of the scans: {listed}."


def _describe_not_counted(
    sequences: Sequence[SequenceAnalysis], verdicts: Sequence[SequenceVerdict], in_title: Collection[str]
) -> str:
    reasons: dict[str, list[str]] = {}
    for sequence, verdict in zip(sequences, verdicts, strict=True):
        if verdict.counts and verdict.sequence not in in_title:
            reasons.setdefault(ALL_TIED if verdict.all_tied else NOT_APART, []).append(sequence.label)
        elif not verdict.counts and not _holds_alone(sequence, verdict, in_title):
            reasons.setdefault(_find_why_not_counted(sequence, verdict), []).append(sequence.label)
    parts = [f"{join_words(labels)} ({why})" for why, labels in reasons.items()]
    return f"Not counted: {join_words(parts)}." if parts else ""


def _find_why_not_counted(sequence: SequenceAnalysis, verdict: SequenceVerdict) -> str:
    if sequence.none_finished:
        return "no run finished"
    if sequence.card.degenerate:
        return "degenerate geometry"
    if sequence.deciding is None:
        return "no value"
    if verdict.outcome in WITHOUT_RANKING:
        return WITHOUT_RANKING[verdict.outcome]
    truth = [] if sequence.deciding.metric.group in WITH_TRUTH else ["no ground truth"]
    return " and ".join([*truth, *([] if sequence.deciding.repeated else ["no repeated runs"])])


def _describe_statistics(comparison: Comparison) -> str:
    runs = Counter((run.method, run.sequence) for run in comparison.records if len(run.result.steps))
    if not runs:
        return ""
    most = max(runs.values())
    if most == 1:
        return (
            "Each sequence was run once. An interval shows how a value varies between stretches of up to 10 s of that "
            "run. It does not say what another run would give, so there is no verdict."
        )
    return (
        f"Numbers are medians over up to {most} runs. From {MIN_RUNS} runs on, a 95 % interval is that of Student's t "
        "over the runs and contains the median over all possible runs; the interval of a single run describes this "
        "run. A method leads only if the interval of the paired difference over runs "
        f"({100 * FEW_CONFIDENCE:.0f} % below six runs and over perturbed runs of a recording, else "
        f"{100 * PAIRED_CONFIDENCE:.0f} %, which keeps verdicts on equal methods at 5 % when measured) excludes zero "
        "and the difference is at least 5 % and, for positions, 2 mm. This must hold against every other method, so "
        "choosing the leader after the fact adds no false leads. A method that is worse than the leader is tested "
        "alone: among many methods one may be so by chance. Tied methods are close, and these runs show no difference, "
        "or one below these limits or the accuracy of the ground truth."
    )
