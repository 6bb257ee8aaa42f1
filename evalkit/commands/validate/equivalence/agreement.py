"""What a comparison of two implementations found, and the verdict: numbers for machines, lines for readers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from evalkit.commands.validate.equivalence.divergence import Divergence
from evalkit.commands.validate.equivalence.lockstep import DISTURBED
from evalkit.commands.validate.equivalence.margins import LEVEL, Interval, Margin

Level = Literal["pairs of every iteration", "poses of every iteration", "answers", "trajectories", "cells"]

ASSUMPTION = (
    f"two one-sided tests at 5 %: the {LEVEL:.0%} interval of the mean lies within the margin. One value a scan; "
    "by moving blocks of n^(1/3) scans from 30 on, which takes farther differences for independent, else by Student's "
    "t, which takes all for independent"
)


@dataclass(frozen=True)
class Equivalence:
    """What a comparison found.

    ``level``: how deep both could be seen. ``first``: the first divergence of all, None where there is none.
    ``classes``: how many questions first diverge by which class (mappers: scans that differ). ``n``: scans compared.
    ``unanswered``: questions B had no answer to. ``strayed``: disturbed questions whose answers are farther apart than
    the margin for another reason than rounding. One of either is enough not to be equivalent. ``intervals`` of
    disturbed questions decide nothing else: on a long way to the goal a tie in the last bit may lead far.
    """

    a: str
    b: str
    sequence: str
    level: Level
    n: int
    questions: int
    unanswered: int
    strayed: int
    first: Divergence | None
    classes: Mapping[str, int]
    intervals: tuple[Interval, ...]
    margin: Margin

    @property
    def equivalent(self) -> bool:
        """Whether every deciding interval lies within its margin, nothing is unanswered and nothing strayed."""
        deciding = [one for one in self.intervals if DISTURBED not in one.quantity]
        return bool(deciding) and not (self.unanswered or self.strayed) and all(one.inside for one in deciding)

    def as_json(self) -> dict[str, Any]:
        """All of it in numbers, texts, lists and dictionaries; None for what is not finite."""
        content = {"equivalent": self.equivalent, **asdict(self), "assumption": ASSUMPTION}
        made: dict[str, Any] = _plain(content)
        return made

    def __str__(self) -> str:
        verdict = "equivalent" if self.equivalent else "not equivalent"
        lines = [
            f"A = {self.a}, B = {self.b}: {verdict} on {self.sequence}",
            f"compared: {self.level}; {self.questions} questions of {self.n} scans, {self.unanswered} unanswered by B,"
            f" {self.strayed} disturbed ones apart for another reason than rounding",
            f"first divergence: {self.first or 'none'}",
            f"classes: {', '.join(f'{kind} {count}' for kind, count in self.classes.items()) or 'none'}",
            f"margin: {self.margin.metres:.3g} m, {self.margin.radians:.3g} rad, {self.margin.log_odds:.3g} log-odds"
            f" ({self.margin.origin})",
            *(_line(one) for one in self.intervals),
            f"test: {ASSUMPTION}",
        ]
        return "\n".join(lines)


def _line(one: Interval) -> str:
    sign = "within" if one.inside else "beyond"
    decides = "; decides nothing" if DISTURBED in one.quantity else ""
    return (
        f"  {one.quantity}: {one.mean:.3g} {one.unit}, 90 % [{one.low:.3g}, {one.high:.3g}] {sign} +-{one.margin:.3g}; "
        f"worst {one.worst:.3g} at scan {one.worst_scan} (n = {one.n}, {one.method}{decides})"
    )


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
