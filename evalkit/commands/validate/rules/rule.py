"""The types of a rule and of its result; the rules themselves are listed in ``evalkit.commands.validate.rules``."""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from evalkit.core.errors import (
    BackendEnded,
    BackendFailed,
    BackendLate,
    BackendRefused,
    EvalkitError,
    NotInstalled,
    format_exception,
)
from evalkit.plugins.specs import RunsIn

ProcessRule = Literal["alive", "in-time"]
"""The rules about a process as a whole."""

RuleOutcome = Literal["passed", "failed", "not applicable", "not judged"]
"""Of a rule. "not judged": it applies, but another broken rule kept it from being asked."""


class RuleBroken(Exception):
    """The plug-in breaks a rule; the text is the observation, and behind it a likely ``cause`` if one is recognised."""

    def __init__(self, observation: str, cause: str = "") -> None:
        super().__init__(f"{observation}: {cause}" if cause else observation)
        self.cause = cause


class RuleNotApplicable(Exception):
    """The rule cannot be checked for this plug-in; the text is the reason."""


def require_own_process(runs_in: RunsIn) -> None:
    """Raise RuleNotApplicable for what only shows in evalkit's own process, where a back end computes elsewhere."""
    if runs_in != "evalkit":
        raise RuleNotApplicable("it computes in another process, whose state is not known here")


def require_no_device(runs_in: RunsIn) -> None:
    """Raise RuleNotApplicable for what shows in a process of this machine, where a back end computes on a device."""
    if runs_in == "device":
        raise RuleNotApplicable("it computes on a device, where this is not known")


class RuleNotJudged(RuleNotApplicable):
    """Another broken rule keeps this one from being judged; the text says which one."""


@dataclass(frozen=True)
class Rule:
    """A rule: its name, a sentence that states it, and the function that checks it.

    ``check(fixture)`` returns the observation, or raises RuleBroken or RuleNotApplicable with it. Any other exception
    comes from the plug-in and breaks the rule.
    """

    name: str
    sentence: str
    check: Callable[[Any], str]


@dataclass(frozen=True)
class RuleResult:
    """The result of one rule; ``observed``: the observation, or why the rule could not be checked.

    ``raised``: whether an exception of the plug-in ended the check, so that the rule itself was not judged.
    ``also_breaks``: the rule about processes that the program of the plug-in broke meanwhile. ``cause``: a mistake that
    the answer shows, "" if none is recognised.
    """

    rule: str
    sentence: str
    outcome: RuleOutcome
    observed: str
    raised: bool = False
    also_breaks: ProcessRule | None = None
    cause: str = ""


@dataclass(frozen=True, repr=False)
class RuleReport:
    """The results of all rules for one plug-in, in the order of the checks; at a prompt it shows its text."""

    label: str
    results: tuple[RuleResult, ...]

    @property
    def broken(self) -> tuple[RuleResult, ...]:
        """The results of broken rules."""
        return tuple(result for result in self.results if result.outcome == "failed")

    def __str__(self) -> str:
        count = Counter(result.outcome for result in self.results)
        other, unjudged = count["not applicable"], count["not judged"]
        lines = [f"{self.label}: {count['passed']} rules passed, {other} not applicable, {count['failed']} broken"]
        lines[0] += f", {unjudged} not judged" if unjudged else ""
        for result in self.broken:
            lines += [f"  {result.rule}: {result.sentence}", f"      {result.observed}"]
        return "\n".join(lines)

    __repr__ = __str__


def check_rule(rule: Rule, fixture: object) -> RuleResult:
    """Check one rule in this process; raises NotInstalled if the plug-in turns out not to be installed."""
    outcome: RuleOutcome = "passed"
    raised, also_breaks, cause = False, None, ""
    try:
        observed = rule.check(fixture)
    except NotInstalled:
        raise
    except RuleNotApplicable as reason:
        outcome = "not judged" if isinstance(reason, RuleNotJudged) else "not applicable"
        observed = str(reason)
    except RuleBroken as observation:
        outcome, observed, cause = "failed", str(observation), observation.cause
        also_breaks = _find_process_rule(observation.__cause__)
    except Exception as error:  # noqa: BLE001 - any exception of a third party's code is the observation
        outcome, observed, raised = "failed", _describe_exception(error), True
        also_breaks = _find_process_rule(error)
    return RuleResult(rule.name, rule.sentence, outcome, observed, raised, also_breaks, cause)


def check_rules_once(rules: Mapping[str, Rule], fixture: object) -> tuple[RuleResult, ...]:
    """Check rules in this process; where one exception ends several, it breaks the first, the others are not judged."""
    results: list[RuleResult] = []
    for rule in rules.values():
        result = check_rule(rule, fixture)
        known = any(one.raised and one.observed == result.observed for one in results)
        results.append(replace(result, outcome="not judged") if result.raised and known else result)
    return tuple(results)


def require_accepted(make: Callable[[], object]) -> None:
    """Make a plug-in with its declared parameters; raises RuleBroken where it rejects them."""
    try:
        make()
    except EvalkitError:
        raise
    except TypeError as error:
        raise RuleBroken(f"make() rejects its declared parameters: {error}") from error


def is_refusal(error: Exception) -> bool:
    """Whether an exception is a way to refuse a question.

    Any of Python code is, except one for a number that is not finite; of a program or a library only its own "failed".
    """
    if isinstance(error, BackendFailed):
        return isinstance(error, BackendRefused)
    return not isinstance(error, RuleBroken) and "not finite" not in str(error)


def _describe_exception(error: Exception) -> str:
    """An exception as an observation; with a remedy where one is known, and the place where a cloud was written to."""
    text = "; ".join((format_exception(error), *getattr(error, "__notes__", ())))
    if isinstance(error, ImportError):
        text += "; let `missing` of the spec say so, with the command that installs it"
    if isinstance(error, ValueError) and "read-only" in str(error):
        at = traceback.extract_tb(error.__traceback__)[-1]
        text += f" ({Path(at.filename).name}, line {at.lineno}): the points of a cloud are read-only, work on a copy"
    return text


def _find_process_rule(error: BaseException | None) -> ProcessRule | None:
    if isinstance(error, BackendLate):
        return "in-time"
    return "alive" if isinstance(error, BackendEnded) else None


def rule_table(*checks: Callable[[Any], str]) -> dict[str, Rule]:
    """The rules of functions by name, in order.

    ``check_few_points`` checks the rule "few-points"; its docstring is the sentence that states the rule.
    """
    names = [check.__name__.removeprefix("check_").replace("_", "-") for check in checks]
    return {name: Rule(name, check.__doc__ or name, check) for name, check in zip(names, checks, strict=True)}
