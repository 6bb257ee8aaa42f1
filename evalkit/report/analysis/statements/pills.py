"""Short warnings beside the answer: degenerate data, lost methods, a busy machine, what is missing."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from evalkit.core.run_status import BROKEN, NOT_EXECUTED
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.contests import Contest
from evalkit.report.analysis.scores import STATUS_LABELS
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.statements.outcome import NOT_APART
from evalkit.report.analysis.statements.verdict import ALL_TIED, SequenceVerdict
from evalkit.report.formatting import format_losses, join_words, name_or_count
from evalkit.results.run_record import RunRecord

MAX_NAMED = 4
"""More methods than these are counted, not named."""

MAX_OF_A_KIND = 2
"""Methods with a pill of their own for one kind of failure."""

MAX_GROUPS = 2
"""More groups of methods, by the data sets that their settings were chosen on, are counted in one pill."""

DISTURBANCES: Mapping[str, tuple[str, str]] = {
    "other_percent": ("other programs", "the core"),
    "steal_percent": ("the hypervisor", "the core"),
    "waited_percent": ("waiting", "the time"),
}
"""What disturbs a run, and of what its share is, by the names of ``RunConditions.disturbances``."""


@dataclass(frozen=True, slots=True)
class Pill:
    """A short statement beside the answer; ``tone`` "warn": it limits the answer."""

    text: str
    tone: Literal["", "warn"] = "warn"


def compute_pills(
    comparison: Comparison,
    sequences: Sequence[SequenceAnalysis],
    verdicts: Sequence[SequenceVerdict],
    contests: Sequence[Contest],
    winners: Sequence[str],
) -> tuple[Pill, ...]:
    """Return the pills, the most important first; ``contests``: what the answer counts; ``winners``: whom it names."""
    runs = comparison.records
    counted = {one.sequence for one in contests}
    pills = [
        *(Pill(f"{sequence.label}: {text}") for sequence in sequences for text in sequence.card.warnings),
        *(_describe_degenerate(comparison, sequence) for sequence in sequences if sequence.card.degenerate),
        _describe_simulated(sequences, contests, winners),
        _describe_known_map(comparison, sequences),
        *_group("lost the track on", _find_lost(sequences), _find_lost_by_geometry(sequences)),
        *_group("did not finish", _find_broken(runs)),
        _describe_load(runs),
        *_describe_tuned(comparison, sequences),
        _describe_not_counted(sequences, verdicts, counted),
        _describe_missing(comparison),
        _count_runs(runs),
    ]
    return tuple(pill for pill in pills if pill is not None)


def _describe_simulated(
    sequences: Sequence[SequenceAnalysis], contests: Sequence[Contest], winners: Sequence[str]
) -> Pill | None:
    """Return that no recording is among the sequences that count, or that count for a winner; else None."""
    recorded = {one.label for one in sequences if not one.card.simulated}
    if contests and not any(one.sequence in recorded for one in contests):
        return Pill("only simulated data count")
    without = [one for one in winners if not any(its.sequence in recorded for its in contests if one in its.part)]
    return Pill(f"only simulated data count for {name_or_count(without, MAX_NAMED)}") if without else None


def _describe_known_map(comparison: Comparison, sequences: Sequence[SequenceAnalysis]) -> Pill | None:
    """Return which methods track the robot in a known map, and which only start there; None without such a map."""
    in_map = [one for one in sequences if any(run.result.start is not None for run in one.all_runs)]
    tracked = {run.method for sequence in in_map for run in sequence.all_runs if run.result.start is not None}
    if not tracked:
        return None
    where = "" if len(in_map) == len(sequences) else f"{join_words(one.label for one in in_map)}: "
    present = [method for method in comparison.method_labels if method in tracked]
    only = [method for method in present if comparison.methods[method].map_use == "starts there"]
    if not only:
        return Pill(f"{where}in a known map, which all methods use", "")
    names = name_or_count(only, MAX_NAMED)
    return Pill(f"{where}in a known map, where {names} only start{'s' * (len(only) == 1)}", "")


def find_dataset(sequence: SequenceAnalysis) -> str:
    """Return the name of the data set of a sequence."""
    return sequence.all_runs[0].spec.sequence.dataset


def find_left_out(comparison: Comparison, sequence: SequenceAnalysis) -> tuple[str, ...]:
    """Return the methods whose settings were chosen on the data set of a sequence, whether they ran there or not."""
    dataset = find_dataset(sequence)
    return tuple(method for method in comparison.method_labels if dataset in comparison.methods[method].tuned_on)


def _describe_degenerate(comparison: Comparison, sequence: SequenceAnalysis) -> Pill | None:
    """Return whether any method, ranked or not, is better than the baseline where the geometry fixes no pose."""
    ranking = sequence.deciding
    if ranking is None or not ranking.ranked:
        return None
    sign = ranking.metric.sign
    for baseline in comparison.methods_with_role("baseline"):
        reference = ranking.of(baseline)
        others = [score for score in ranking.scores if score is not reference and (score.values or score.lost)]
        if reference is None or reference not in ranking.ranked or reference.median is None or not others:
            continue
        bound = sign * reference.median
        if all(score.median is None or sign * score.median >= bound for score in others):
            return Pill(f"{sequence.label} is degenerate: no method beats {baseline}")
    return Pill(f"{sequence.label} is degenerate: not counted")


def _find_lost(sequences: Iterable[SequenceAnalysis]) -> dict[str, list[str]]:
    """Return the sequences on which a method lost the track, with the time, where the geometry does not explain it."""
    grouped: dict[str, list[str]] = {}
    for sequence in sequences:
        for score in sequence.deciding.scores if sequence.deciding and not sequence.card.degenerate else ():
            if score.lost is not None:
                grouped.setdefault(score.method, []).append(f"{sequence.label} ({format_losses(score)})")
    return grouped


def _find_lost_by_geometry(sequences: Iterable[SequenceAnalysis]) -> list[str]:
    """Return the sequences on which a method lost the track where the geometry explains it."""
    degenerate = [one for one in sequences if one.card.degenerate]
    return [one.label for one in degenerate if any(run.scores.lost is not None for run in one.all_runs)]


def _find_broken(runs: Iterable[RunRecord]) -> dict[str, list[str]]:
    grouped: dict[str, dict[str, None]] = {}
    for run in runs:
        if run.result.status in BROKEN:
            grouped.setdefault(run.method, {})[f"{run.sequence} ({STATUS_LABELS[run.result.status]})"] = None
    return {method: list(where) for method, where in grouped.items()}


def _group(what: str, found: Mapping[str, Sequence[str]], left_out: Sequence[str] = ()) -> list[Pill]:
    """Return one pill per method; of more than two methods one with their names, of many sequences the number.

    ``left_out``: sequences that ``found`` does not regard.
    """
    if len(found) > MAX_OF_A_KIND:
        names = f": {', '.join(found)}" if len(found) <= MAX_NAMED else ""
        where = f"{what.removesuffix(' on')} outside {join_words(left_out)}" if left_out else f"{what} a sequence"
        return [Pill(f"{len(found)} methods {where}{names}")]
    return [
        Pill(f"{method} {what} {join_words(where) if len(where) < 4 else f'{len(where)} sequences'}")
        for method, where in found.items()
    ]


def _describe_load(runs: Sequence[RunRecord]) -> Pill | None:
    """Return the executed runs during which other programs used the machine, and what disturbed most of them."""
    executed = [run.result for run in runs if run.result.status not in NOT_EXECUTED]
    known = [one.conditions for one in executed if one.conditions is not None]
    found = [own for one in known if (own := one.disturbances)]
    if not found:
        return None
    name = max(DISTURBANCES, key=lambda one: sum(one in own for own in found))
    (what, of), taken = DISTURBANCES[name], [own[name] for own in found if name in own]
    most = f"{'' if len(taken) == 1 else 'up to '}{max(taken):.{int(max(taken) < 9.95)}f} % of {of}"
    counted = f"{len(found)} of {len(known)} runs disturbed, {len(taken)} by {what}"
    return Pill(f"busy machine: {counted}: {most}")


def _describe_tuned(comparison: Comparison, sequences: Sequence[SequenceAnalysis]) -> list[Pill]:
    """Return one pill for each group of methods whose settings were chosen on the same sequences, or one for many.

    Where the name of a data set is that of a sequence, other sequences of it are not named.
    """
    labels = {one.label for one in sequences}
    chosen: dict[str, list[str]] = {}
    for sequence in sequences:
        if sequence.label != find_dataset(sequence) and find_dataset(sequence) in labels:
            continue
        for method in find_left_out(comparison, sequence):
            chosen.setdefault(method, []).append(sequence.label)
    groups: dict[tuple[str, ...], list[str]] = {}
    for method, where in chosen.items():
        groups.setdefault(tuple(where), []).append(method)
    if len(groups) > MAX_GROUPS:
        return [Pill(f"settings of {len(chosen)} methods chosen on data shown here: not counted there")]
    return [
        Pill(f"settings of {name_or_count(methods, MAX_OF_A_KIND)} chosen on {join_words(where)}: not counted there")
        for where, methods in groups.items()
    ]


def _describe_not_counted(
    sequences: Sequence[SequenceAnalysis], verdicts: Sequence[SequenceVerdict], counted: Collection[str]
) -> Pill | None:
    left = [
        verdict
        for sequence, verdict in zip(sequences, verdicts, strict=True)
        if verdict.sequence not in counted and not sequence.card.degenerate and not sequence.none_finished
    ]
    groups = {
        "": [one.sequence for one in left if not one.counts],
        f" ({ALL_TIED})": [one.sequence for one in left if one.counts and one.all_tied],
        f" ({NOT_APART})": [one.sequence for one in left if one.counts and not one.all_tied],
    }
    parts = [f"{join_words(where)}{why}" for why, where in groups.items() if where]
    return Pill(f"not counted: {'; '.join(parts)}", "") if left and counted else None


def _describe_missing(comparison: Comparison) -> Pill | None:
    """Return the data sets and methods that are not on this machine."""
    missing = (*comparison.missing_sequences, *comparison.missing_methods)
    return Pill(f"missing here: {join_words(missing)}", "") if missing else None


def _count_runs(runs: Sequence[RunRecord]) -> Pill:
    finished = sum(run.result.is_complete for run in runs)
    whole = f"{len(runs)} run{'s' if len(runs) != 1 else ''}"
    return Pill(whole if finished == len(runs) else f"{finished} of {whole}", "")
