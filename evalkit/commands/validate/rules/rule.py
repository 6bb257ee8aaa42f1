"""What a rule is, and what is found when a plug-in is asked whether it keeps it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal

from evalkit.core.errors import NotInstalled

Outcome = Literal["passed", "failed", "not applicable"]


class Broken(Exception):
    """A rule that is not kept; its text is what was observed."""


class NotApplicable(Exception):
    """A rule that cannot be asked of this plug-in; its text is the reason."""


@dataclass(frozen=True)
class Rule:
    """A rule: its name, a sentence that states it, and the question.

    ``ask(bench)`` answers what was observed, or raises Broken or NotApplicable with it. Anything else it raises comes
    from the plug-in and breaks the rule.
    """

    name: str
    sentence: str
    ask: Callable[[Any], str]


@dataclass(frozen=True)
class Verdict:
    """What one rule found: ``observed`` is what was seen, or why the rule could not be asked."""

    rule: str
    sentence: str
    outcome: Outcome
    observed: str


@dataclass(frozen=True)
class Conformance:
    """What all rules found about one plug-in, in the order they were asked."""

    label: str
    verdicts: tuple[Verdict, ...]

    @property
    def broken(self) -> tuple[Verdict, ...]:
        """The rules that are not kept."""
        return tuple(verdict for verdict in self.verdicts if verdict.outcome == "failed")


def verdict(rule: Rule, bench: object) -> Verdict:
    """What one rule finds, asked in this process."""
    outcome: Outcome = "passed"
    try:
        observed = rule.ask(bench)
    except NotInstalled:  # not the rule's business: nothing can be asked here
        raise
    except NotApplicable as reason:
        outcome, observed = "not applicable", str(reason)
    except Broken as found:
        outcome, observed = "failed", str(found)
    except Exception as error:  # noqa: BLE001 - whatever a third party's code raises is what was observed
        outcome, observed = "failed", raised(error)
    return Verdict(rule.name, rule.sentence, outcome, observed)


def raised(error: BaseException) -> str:
    """An exception in the words of an observation."""
    return f"raises {type(error).__name__}: {error}"


def table(*rules: Rule) -> dict[str, Rule]:
    """The rules by name, in order."""
    return {rule.name: rule for rule in rules}


def not_asked(rules: Iterable[Rule], reason: str) -> list[Verdict]:
    """Verdicts for rules that there was no sense in asking."""
    return [Verdict(rule.name, rule.sentence, "not applicable", reason) for rule in rules]
