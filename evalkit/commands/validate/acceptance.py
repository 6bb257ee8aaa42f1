"""What is known of an implementation, level by level, and the one sentence that sums it up."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

SCHEMA = 1
"""Version of the JSON form (``acceptance.schema.json``): a new one where a reader of the old would be misled."""

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
        first = f"{self.backend} {self._where(*failed[0])}"
        beyond = next((one for one in failed if one[1].ground == self.claim), None)
        if failed[0][1].ground != "always" or beyond is None:
            return first
        return f"{first}. It {self._where(*beyond)}"

    def _where(self, level: Level, line: Line) -> str:
        """A line that refutes the claim, as the rest of a sentence."""
        place = f"level {level.number} ({level.name}{f', {line.on}' if line.on else ''})"
        if line.ground == "equal":
            return f"first differs from {self.twin} at {place}: {line.observed}"
        return f"fails at {place}: {line.name}: {line.observed}"

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
