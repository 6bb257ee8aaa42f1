"""What is known of an implementation, level by level, and the one sentence that sums it up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

SCHEMA = 1
"""Version of the JSON form (``dossier.schema.json``): a new one where a reader of the old would be misled."""

Claim = Literal["equal", "as-good"]
Outcome = Literal["passed", "failed", "told", "not applicable"]
Ground = Literal["always", "equal", "as-good", ""]
"""Which claim a line decides: both, one of them, or none."""


@dataclass(frozen=True)
class Line:
    """One question with its answer: what was found, and the margin it was held against with that margin's reason.

    ``detail``: what else is worth telling. ``told`` and ``not applicable`` are outcomes that can decide nothing.
    """

    name: str
    on: str
    outcome: Outcome
    ground: Ground
    observed: str
    margin: str = ""
    detail: str = ""

    def decides(self, claim: Claim) -> bool:
        """Whether the verdict on a claim hangs on it."""
        return self.ground in ("always", claim)


@dataclass(frozen=True)
class Level:
    """All lines of one level. ``shown``: numbers behind them, for drawings."""

    number: int
    name: str
    question: str
    lines: tuple[Line, ...]
    shown: Mapping[str, Any] = field(default_factory=dict, compare=False)

    def failed(self, claim: Claim) -> list[Line]:
        """The lines that refute a claim."""
        return [line for line in self.lines if line.outcome == "failed" and line.decides(claim)]

    def outcome(self, claim: Claim) -> Outcome:
        """What this level says of a claim."""
        if self.failed(claim):
            return "failed"
        deciding = [line for line in self.lines if line.decides(claim) and line.outcome == "passed"]
        asked = [line for line in self.lines if line.outcome != "not applicable"]
        return "passed" if deciding else "told" if asked else "not applicable"


@dataclass(frozen=True)
class Dossier:
    """An implementation held against its twin. ``within``: the margin of the claim "equal", in words."""

    backend: str
    twin: str
    why_twin: str
    against: tuple[str, ...]
    absent: Mapping[str, str]
    claim: Claim
    margin: str
    within: str
    levels: tuple[Level, ...]
    settings: Mapping[str, Any]
    environment: Mapping[str, str]

    @property
    def passed(self) -> bool:
        """Whether no level refutes the claim, and at least one speaks for it."""
        outcomes = [level.outcome(self.claim) for level in self.levels]
        return "failed" not in outcomes and "passed" in outcomes

    @property
    def verdict(self) -> str:
        """One sentence (or two): whether the claim holds, else where it first fails."""
        if self.passed:
            asked = [level for level in self.levels if level.outcome(self.claim) == "passed"]
            named = ", ".join(f"{level.number} {level.name}" for level in asked)
            if self.claim == "equal":
                return f"{self.backend} is equivalent to {self.twin} {self.within} at every level asked ({named})"
            return f"{self.backend} is as good as {self.twin} at every level asked ({named})"
        failed = [(level, line) for level in self.levels for line in level.failed(self.claim)]
        if not failed:
            return f"nothing can be said of {self.backend}: no level could be asked"
        level, line = failed[0]
        where = f"level {level.number} ({level.name}{f', {line.on}' if line.on else ''})"
        first = f"{self.backend} first fails at {where}: {line.name}: {line.observed}"
        beyond = next(((lv, ln) for lv, ln in failed if lv.number > 0), None) if level.number == 0 else None
        if beyond is None:
            return first
        there = f"level {beyond[0].number} ({beyond[0].name}{f', {beyond[1].on}' if beyond[1].on else ''})"
        return f"{first}. It first differs from {self.twin} at {there}: {beyond[1].observed}"

    def as_json(self) -> dict[str, Any]:
        """All of it but the drawings, in numbers, texts, lists and dictionaries."""
        content = {
            "backend": self.backend, "twin": self.twin, "why_twin": self.why_twin, "against": list(self.against),
            "absent": dict(self.absent), "claim": self.claim, "margin": self.margin, "within": self.within,
            "settings": dict(self.settings), "environment": dict(self.environment),
        }  # fmt: skip
        levels = [
            {
                "number": level.number,
                "name": level.name,
                "question": level.question,
                "outcome": level.outcome(self.claim),
                "lines": [asdict(line) | {"decides": line.decides(self.claim)} for line in level.lines],
            }
            for level in self.levels
        ]
        return {"schema": SCHEMA, "passed": self.passed, "verdict": self.verdict, **content, "levels": levels}
