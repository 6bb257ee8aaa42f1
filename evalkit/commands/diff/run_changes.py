"""Runs whose status changed, and losses of the track before and after."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from evalkit.commands.diff.changes import ChangeVerdict
from evalkit.commands.diff.compared_runs import ComparedRuns
from evalkit.core.run_result import LostTrack
from evalkit.report.formatting import format_loss_times

MAX_CHANCE = 0.05
"""Track losses of a method before and after: runs that all change in one direction with a smaller probability."""


@dataclass(frozen=True, slots=True)
class StatusChange:
    """A run whose status changed. ``run``: its name among those of the method on the sequence."""

    method: str
    sequence: str
    seed: int | None
    run: str
    old: str
    new: str
    reason: str
    verdict: ChangeVerdict


@dataclass(frozen=True, slots=True)
class LostRun:
    """A run that lost the track. ``run``: its name among those of the method on the sequence."""

    seed: int | None
    run: str
    lost: LostTrack


@dataclass(frozen=True, slots=True)
class TrackChange:
    """The runs of one method over one sequence that lost the track before and after.

    ``runs``: how many completed on both sides. Only for a method that lost the track in any of them.
    """

    method: str
    sequence: str
    old: tuple[LostRun, ...]
    new: tuple[LostRun, ...]
    runs: int
    verdict: ChangeVerdict
    reason: str


def compare_statuses(runs: ComparedRuns) -> Iterator[StatusChange]:
    """Yield the runs whose status changed."""
    for seed, (before, after) in runs.common.items():
        if before.status != after.status:
            verdict: ChangeVerdict = "not comparable"
            if after.status == "complete":
                verdict = "improvement"
            elif before.status == "complete":
                verdict = "regression"
            yield StatusChange(
                runs.method, runs.sequence, seed, runs.name_run(seed), before.status, after.status, after.reason,
                verdict,
            )  # fmt: skip


def compare_tracks(runs: ComparedRuns) -> TrackChange | None:
    """Compare which runs lost the track, among those that completed on both sides; None if none did."""
    pairs = runs.complete
    names = {seed: runs.name_run(seed) for seed in pairs}
    before, after = (
        tuple(LostRun(seed, names[seed], lost) for seed, pair in pairs.items() if (lost := pair[side].lost))
        for side in (0, 1)
    )
    if not before and not after:
        return None
    return TrackChange(runs.method, runs.sequence, before, after, len(pairs), *_judge_tracks(before, after))


def _judge_tracks(old: Sequence[LostRun], new: Sequence[LostRun]) -> tuple[ChangeVerdict, str]:
    """Any loss where all runs held the track is a regression; further losses must be more than chance (sign test)."""
    more = [one for one in new if one.seed not in [other.seed for other in old]]
    fewer = [one for one in old if one.seed not in [other.seed for other in new]]
    if not more and not fewer:
        return "unchanged", "lost in the same runs"
    said = "; ".join(
        f"{what}: {', '.join(f'{one.run} {format_loss_times(one.lost)}' for one in runs)}"
        for what, runs in (("newly lost", more), ("no longer lost", fewer)) if runs
    )  # fmt: skip
    changed = len(more) + len(fewer)
    chance = sum(math.comb(changed, count) for count in range(max(len(more), len(fewer)), changed + 1)) / 2**changed
    if old and new and chance > MAX_CHANCE:
        return "no difference shown", said
    return ("regression" if len(more) > len(fewer) else "improvement"), said
