"""The result of a tuning, for its page and its JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from evalkit.commands.tune.held_out import HeldOutVerdict, judge_held_out
from evalkit.commands.tune.plan import Tuning
from evalkit.commands.tune.search_loop import MethodSearch
from evalkit.report.analysis.analysis import Analysis, analyse
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.scores import STATUS_LABELS

FAILED = ("failed", "crashed", "timed out", "out of memory")


@dataclass(frozen=True, eq=False)
class TuningResult:
    """A tuning, its searches, and the comparison on held-out sequences.

    ``report``: the command that makes the full report of that comparison.
    """

    tuning: Tuning
    searches: Sequence[MethodSearch]
    comparison: Comparison
    ran_on: Mapping[str, str]
    report: str

    @property
    def searched(self) -> tuple[MethodSearch, ...]:
        """The searches of back ends that have something to search."""
        return tuple(one for one in self.searches if one.tunable.space.factors)

    @cached_property
    def analysis(self) -> Analysis:
        """The analysis of the held-out runs."""
        return analyse(self.comparison)

    @cached_property
    def held_out_verdicts(self) -> Mapping[str, HeldOutVerdict]:
        """The verdicts on tuned back ends by label."""
        return {one.label: one for one in judge_held_out(self.analysis, self.searches)}

    @cached_property
    def failed(self) -> tuple[str, ...]:
        """The labels of methods that completed no run, in the search or on held-out sequences."""
        never = [one.tunable.label for one in self.searches if one.failed]
        statuses: dict[str, list[str]] = {}
        for record in self.comparison.records:
            statuses.setdefault(record.method, []).append(STATUS_LABELS[record.result.status])
        never += [label for label, own in statuses.items() if all(each in FAILED for each in own)]
        return tuple(dict.fromkeys(never))

    def verdict(self, one: MethodSearch) -> str:
        """The verdict on a back end in one phrase."""
        if one.failed:
            return "failed: no run of any point was completed"
        return self.held_out_verdicts[one.tunable.label].verdict if one.tuned else one.why

    def sentence(self, one: MethodSearch) -> str:
        """The verdict on a back end with its numbers."""
        held = self.held_out_verdicts.get(one.tunable.label)
        paired = held.paired if held is not None else None
        if one.failed or paired is None or paired.ratio is None:
            return f"{one.tunable.label}: {self.verdict(one)}"
        numbers = (
            f"error {paired.ratio:.2f} times the default's in the median of {paired.runs} runs, p = {paired.p:.2g}"
        )
        return f"{one.tunable.label}: {self.verdict(one)} ({numbers})"
