"""The result of comparing two implementations: numbers, JSON form, text and verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from evalkit.commands.validate.equivalence.divergence import Divergence
from evalkit.commands.validate.equivalence.lockstep import DISTURBED
from evalkit.commands.validate.equivalence.margins import LEVEL, EquivalenceInterval, Margin
from evalkit.io.json_values import replace_non_finite

Depth = Literal["pairs of every iteration", "poses of every iteration", "answers", "trajectories", "cells"]

ASSUMPTION = (
    f"two one-sided tests at 5 %: the {LEVEL:.0%} interval of the mean lies within the margin. One value per scan; "
    "from 30 scans on by moving blocks of n^(1/3) scans, which assumes that differences farther apart are independent, "
    "else by Student's t, which assumes that all are independent"
)


@dataclass(frozen=True, repr=False)
class Equivalence:
    """The result of comparing implementations A and B; at a prompt it shows its text.

    ``level``: the most detailed quantity that both provide. ``first``: the first divergence, None if there is none.
    ``classes``: number of questions that first diverge, by class (mappers: scans that differ). ``fields``: number of
    questions with an equal pose whose other field differs, by field. ``n``: scans compared.
    ``unanswered``: questions without an answer from B. ``strayed``: disturbed questions whose answers differ by more
    than the margin for another reason than rounding. One of either refutes equivalence. ``intervals`` of disturbed
    questions decide nothing else: far from the answer, a tie in the last bit may change the path.
    """

    a: str
    b: str
    sequence: str
    level: Depth
    n: int
    questions: int
    unanswered: int
    strayed: int
    first: Divergence | None
    classes: Mapping[str, int]
    fields: Mapping[str, int]
    intervals: tuple[EquivalenceInterval, ...]
    margin: Margin

    @property
    def equivalent(self) -> bool:
        """Whether every deciding interval lies within its margin and nothing is unanswered or strayed."""
        deciding = [one for one in self.intervals if DISTURBED not in one.quantity]
        return bool(deciding) and not (self.unanswered or self.strayed) and all(one.inside for one in deciding)

    def as_json(self) -> dict[str, Any]:
        """The result as JSON values; None for what is not finite."""
        content: dict[str, Any] = replace_non_finite(
            {"equivalent": self.equivalent, **asdict(self), "assumption": ASSUMPTION}
        )
        return content

    def __str__(self) -> str:
        verdict = "equivalent" if self.equivalent else "not equivalent"
        lines = [
            f"A = {self.a}, B = {self.b}: {verdict} on {self.sequence}",
            f"compared: {self.level}; {self.questions} questions of {self.n} scans, {self.unanswered} unanswered by B,"
            f" {self.strayed} disturbed ones that differ for another reason than rounding",
            f"first divergence: {self.first or 'none'}",
            f"classes: {_format_counts(self.classes)}",
            f"fields that differ where the pose does not: {_format_counts(self.fields)}",
            f"margin: {self.margin.metres:.3g} m, {self.margin.radians:.3g} rad, {self.margin.log_odds:.3g} log-odds"
            f" ({self.margin.origin})",
            *(_format_interval(one) for one in self.intervals),
            f"test: {ASSUMPTION}",
        ]
        return "\n".join(lines)

    __repr__ = __str__


def _format_counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items()) or "none"


def _format_interval(one: EquivalenceInterval) -> str:
    position = "within" if one.inside else "beyond"
    note = "; decides nothing" if DISTURBED in one.quantity else ""
    return (
        f"  {one.quantity}: {one.mean:.3g} {one.unit}, 90 % [{one.low:.3g}, {one.high:.3g}] {position} "
        f"+-{one.margin:.3g}; worst {one.worst:.3g} at scan {one.worst_scan} (n = {one.n}, {one.method}{note})"
    )
