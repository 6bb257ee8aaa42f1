"""Name the cause of a first difference, as far as the drawn questions exclude all others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from evalkit.commands.validate.acceptance import Check
from evalkit.commands.validate.comparison_terms import ComparisonTerms, ResultsByPlace
from evalkit.execution.sandbox import ENDED

UNNAMED = ("different steps from", "different poses", "not both report their", "another answer", "guess is returned")
"""Phrases of a first difference whose cause is not known from the answers alone."""

TRACE_ALONE = "the pose is equal, but not trace"
"""Of a first difference that says where it shows, not what it is."""

CROWDED = ("edges", "points", "sizes")
"""Families of drawn questions of points that have several others near, at the scale of a room."""


def name_causes(checks: list[Check], drawn: ResultsByPlace, terms: ComparisonTerms) -> list[Check]:
    """The checks, with what the drawn questions say about a first difference that has no name.

    With well separated points every neighbour search and every outlier rule give the same pairs. Pairs that differ in
    the first iteration from the identity exclude the start, the motion of the points and the step. Where the questions
    leave several causes, only what they show is said.
    """
    families = [one[terms.margin]["families"] for one in drawn.values() if ENDED not in one]
    if not families:
        return checks
    where = next(one[terms.margin]["where"] for one in drawn.values() if ENDED not in one)
    if "clear" not in families[0]:  # odometries
        return [replace(one, observed=f"{one.observed}; {where}") if where and one.outcome == "failed"
                and where not in one.observed and one.deciding == "equal" else one for one in checks]  # fmt: skip
    start = next(one[terms.margin]["start"] for one in drawn.values() if ENDED not in one)

    def name_cause(check: Check) -> Check:
        text = check.observed
        if check.outcome == "failed" and any(phrase in text for phrase in UNNAMED):
            cause = _describe_cause(text, families[0], start, where)
            return replace(check, observed=f"{text}; {cause}" if cause else text)
        return check

    return [name_cause(check) for check in checks]


def _describe_cause(text: str, families: Mapping[str, Mapping[str, Any]], start: str, where: str) -> str:
    """The cause of a first difference in words, or what the questions show where they leave several; "" if nothing."""
    clear, limits = families["clear"], families.get("limits", {"wrong": 0})
    mispaired = any(one["mispaired"] for one in families.values())
    if start or where:
        return f"another start: {start}" if start else f"answers differ {where}"
    if clear["wrong"]:
        return _describe_clear(text, clear, mispaired)
    if limits["wrong"]:
        counted = "not both report their pairs" in text  # in an iteration before which the poses are equal
        which = "the outlier rule or the search of neighbours differs: " if counted else ""
        return f"{which}well separated points give equal answers, pairs near the limits do not"
    if any(families[name]["wrong"] for name in CROWDED if name in families):
        which = "the neighbours differ: " if mispaired else ""
        return f"{which}well separated points give equal answers, crowded ones do not"
    wrong = {name: one["what"] for name, one in families.items() if one["wrong"]}
    family, what = next(iter(wrong.items()), ("", ""))
    return f"of the drawn questions only {family} differ, first {what}" if len(wrong) == 1 and what not in text else ""


def _describe_clear(text: str, clear: Mapping[str, Any], mispaired: bool) -> str:
    """The same where even well separated points give other answers; ``mispaired``: other pairs from the identity."""
    if clear["recounted"]:
        which = "the points that are used or their neighbours differ: " if mispaired else ""
        return f"{which}even well separated points give another number of pairs"
    if clear["unanswered"] or clear["first"]["quantity"] not in ("pose", "answer") or ", pairs: " in text:
        return ""  # pairs that differ before a step are not explained by it
    which = "the step, or the motion of the points, differs: " if clear["counted"] else ""
    return f"{which}well separated points give as many pairs, but other answers"


def name_traces(checks: list[Check], drawn: ResultsByPlace, terms: ComparisonTerms) -> list[Check]:
    """The checks, where the trace alone differs with the step that the drawn questions name."""
    families = [
        one for result in drawn.values() if ENDED not in result for one in result[terms.margin]["families"].values()
    ]
    firsts = [one["first"] for one in families if one["wrong"] and one["first"]]
    steps = [one for one in firsts if one["quantity"] == "pose"]
    cause = "".join(f"; {one['kind']}: {one['what']}" for one in steps[:1])
    return [
        replace(one, observed=one.observed + cause) if one.outcome == "failed" and TRACE_ALONE in one.observed else one
        for one in checks
    ]
