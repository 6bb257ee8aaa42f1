"""The acceptance report of an implementation: checks grouped into levels, and the verdict on a claim."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal
from xml.etree import ElementTree

SCHEMA = 3
"""Version of the JSON form (``acceptance.schema.json``). Increase it if a reader of the old form would be misled."""

Claim = Literal["equal", "as-good"]
CheckOutcome = Literal["passed", "failed", "not shown", "waived", "not judged", "informative", "not applicable"]
"""Of a check. "not shown": too few data to tell; "waived": failed, but excepted by name with a reason; "not judged":
ended by an exception that another check, which failed, reports.
"""

Deciding = Literal["always", "equal", "as-good", "never"]
"""The claim that a check can refute: every claim, one of them, or none."""

DECIDING: Mapping[Deciding, str] = {
    "always": "decides every claim",
    "equal": 'decides the claim "equal"',
    "as-good": 'decides the claim "as-good"',
    "never": "informs only",
}


@dataclass(frozen=True)
class Check:
    """One measurement or test: what was observed, and the margin it was compared with, with that margin's origin.

    ``on``: sequence and seed, or "" for all. ``detail``: additional explanation. ``data``: the numbers behind the text,
    as JSON values. The outcomes "not judged", "informative" and "not applicable" never decide a claim.
    """

    name: str
    on: str
    outcome: CheckOutcome
    deciding: Deciding
    observed: str
    margin: str = ""
    detail: str = ""
    data: Mapping[str, Any] = field(default_factory=dict)

    def decides(self, claim: Claim) -> bool:
        """Whether the verdict on a claim depends on this check."""
        return self.deciding in ("always", claim)


@dataclass(frozen=True)
class AcceptanceLevel:
    """All checks of one level. ``results``: the arrays and runs behind them, for the charts."""

    number: int
    name: str
    question: str
    checks: tuple[Check, ...]
    results: Mapping[str, Any] = field(default_factory=dict, compare=False)

    def failed(self, claim: Claim) -> list[Check]:
        """The checks that refute a claim."""
        return [check for check in self.checks if check.outcome == "failed" and check.decides(claim)]

    def not_shown(self, claim: Claim) -> list[Check]:
        """The checks whose data are too few to support a claim or to refute it."""
        return [check for check in self.checks if check.outcome == "not shown" and check.decides(claim)]

    def passed(self, claim: Claim) -> list[Check]:
        """The checks that support a claim."""
        return [check for check in self.checks if check.outcome == "passed" and check.decides(claim)]

    def outcome(self, claim: Claim) -> CheckOutcome:
        """The outcome of the level for a claim."""
        if self.failed(claim):
            return "failed"
        if self.not_shown(claim):
            return "not shown"
        if self.passed(claim):
            return "passed"
        applicable = any(check.outcome != "not applicable" for check in self.checks)
        return "informative" if applicable else "not applicable"

    def decisive_checks(self, claim: Claim) -> list[Check]:
        """The checks to show first: those that refute the claim, else those that support it, else all that apply."""
        applicable = [check for check in self.checks if check.outcome != "not applicable"]
        return self.failed(claim) or self.not_shown(claim) or self.passed(claim) or applicable or list(self.checks)


@dataclass(frozen=True)
class AcceptanceReport:
    """The result of validating a back end, a mapper or a data set (``subject``).

    ``reference``: the implementation it was compared with, "" if none was needed; ``why_reference``: how it was chosen.
    ``peers``: other methods, shown for context. ``unavailable``: peers and sequences that are not installed here, and
    why. ``margin``: the margin that was chosen; ``margin_text``: the same in words, with numbers. ``waivers``: reasons
    by the name of a check that is excepted. ``binaries``: SHA-256 and compiler of the files of machine code, by name.
    """

    subject: str
    reference: str
    why_reference: str
    peers: tuple[str, ...]
    unavailable: Mapping[str, str]
    claim: Claim
    margin: str
    margin_text: str
    levels: tuple[AcceptanceLevel, ...]
    settings: Mapping[str, Any]
    environment: Mapping[str, str]
    waivers: Mapping[str, str] = field(default_factory=dict)
    binaries: Mapping[str, str] = field(default_factory=dict)

    @property
    def check_count(self) -> int:
        """How many checks were made."""
        left_out = {"not applicable", "not judged"}
        return sum(check.outcome not in left_out for level in self.levels for check in level.checks)

    @property
    def passed(self) -> bool:
        """Whether no level refutes the claim, and at least one supports it."""
        outcomes = [level.outcome(self.claim) for level in self.levels]
        return not {"failed", "not shown"} & set(outcomes) and "passed" in outcomes

    @property
    def verdict(self) -> str:
        """One sentence (or two): the claim holds, or where it first fails."""
        if self.passed:
            passed = [level for level in self.levels if level.outcome(self.claim) == "passed"]
            levels = ", ".join(level.name for level in passed) + self._waived
            if not self.reference:
                return f"{self.subject} passes every level that was run ({levels})"
            if self.claim == "equal":
                equal = f"{self.subject} is equivalent to {self.reference} {self.margin_text}"
                return f"{equal} at every level that was run ({levels})"
            return f"{self.subject} is as good as {self.reference} at every level that was run ({levels})"
        failed = [(level, check) for level in self.levels for check in level.failed(self.claim)]
        if not failed:
            return self._open_verdict()
        first = f"{self.subject} {self._failure(*failed[0])}"
        refuting = next((one for one in failed if one[1].deciding == self.claim), None)
        if failed[0][1].deciding != "always" or refuting is None:
            return first
        return f"{first}. It {self._failure(*refuting)}"

    @property
    def next_step(self) -> str:
        """What to ask next, or "": of a method that may be another one, and of one that shows single precision."""
        if self.passed and self.claim == "equal" and self.margin == "float32":
            return "meant to compute in double precision? --margin exact says where it first does not"
        failed = [check for level in self.levels for check in level.failed(self.claim)]
        if not failed or any(check.deciding != "equal" for check in failed):
            return ""
        return f"another method than {self.reference}? --claim as-good, without --only, asks whether it is no worse"

    @property
    def _waived(self) -> str:
        names = (one.name for level in self.levels for one in level.checks if one.outcome == "waived")
        return f"; waived: {text}" if (text := ", ".join(dict.fromkeys(names))) else ""

    def _open_verdict(self) -> str:
        for level in self.levels:
            for check in level.not_shown(self.claim):
                at = f"level {level.number} ({level.name}{f', {check.on}' if check.on else ''})"
                claim = f"it is not shown that {self.subject} is as good as {self.reference}, nor that it is worse"
                return f"{claim}; {at}: {check.name}: {check.observed}; margin {check.margin}; {check.detail}"
        return f"no verdict on {self.subject}: no level could be run"

    def _failure(self, level: AcceptanceLevel, check: Check) -> str:
        """A failed check as the rest of a sentence."""
        place = f"level {level.number} ({level.name}{f', {check.on}' if check.on else ''})"
        if check.deciding == "equal":
            return f"first differs from {self.reference} at {place}: {check.observed}"
        decides = f"; margin {check.margin}" if check.deciding == "as-good" else ""
        return f"fails at {place}: {check.name}: {check.observed}{decides}"

    def as_json(self) -> dict[str, Any]:
        """The report without its charts, as JSON values."""
        content = {
            "subject": self.subject, "reference": self.reference, "why_reference": self.why_reference,
            "peers": list(self.peers), "unavailable": dict(self.unavailable), "claim": self.claim,
            "margin": self.margin, "margin_text": self.margin_text, "settings": dict(self.settings),
            "environment": dict(self.environment),
            "waivers": dict(self.waivers), "binaries": dict(self.binaries), "asked": self.check_count,
            "seed": self.settings.get("seed"),
        }  # fmt: skip
        levels = [
            {
                "number": level.number,
                "name": level.name,
                "question": level.question,
                "outcome": level.outcome(self.claim),
                "checks": [asdict(check) | {"decides": check.decides(self.claim)} for check in level.checks],
            }
            for level in self.levels
        ]
        return {"schema": SCHEMA, "passed": self.passed, "verdict": self.verdict, **content, "levels": levels}


def as_junit(report: AcceptanceReport) -> str:
    """The report as JUnit XML: a suite for each level, a case for each check; what the claim needs may fail."""
    root = ElementTree.Element("testsuites", name=_printable(f"evalkit validate {report.subject}"))
    for level in report.levels:
        skipped = [one for one in level.checks if one.outcome in ("not applicable", "waived", "not judged")]
        failed = level.failed(report.claim) + level.not_shown(report.claim)
        suite = ElementTree.SubElement(
            root, "testsuite", name=f"{level.number} {level.name}", tests=str(len(level.checks)),
            failures=str(len(failed)), skipped=str(len(skipped)), errors="0",
        )  # fmt: skip
        for check in level.checks:
            name = f"{check.name} on {check.on}" if check.on else check.name
            case = ElementTree.SubElement(suite, "testcase", name=_printable(name), classname=f"evalkit.{level.name}")
            text = _printable(". ".join(filter(None, (check.observed, check.detail))))
            if check in failed:
                ElementTree.SubElement(case, "failure", message=text, type=check.outcome)
            elif check in skipped:
                ElementTree.SubElement(case, "skipped", message=text)
            else:
                ElementTree.SubElement(case, "system-out").text = text
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _printable(text: str) -> str:
    """The text without characters that XML forbids."""
    return "".join(char for char in text if char.isprintable() or char == "\n")
