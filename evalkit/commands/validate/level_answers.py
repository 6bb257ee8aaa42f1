"""Levels 0 to 2 of an acceptance report: rules, single registrations, and registrations in lockstep over a sequence."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from evalkit.commands.validate.acceptance import AcceptanceLevel, Check, CheckOutcome
from evalkit.commands.validate.comparison_terms import ComparisonTerms, ResultsByPlace, is_equal
from evalkit.commands.validate.difference_causes import name_causes, name_traces
from evalkit.commands.validate.equivalence.lockstep import DISTURBED
from evalkit.commands.validate.equivalence.margins import FLOAT32
from evalkit.commands.validate.known_motion import known_motion_checks, peer_check
from evalkit.commands.validate.rules.rule import RuleResult
from evalkit.execution.sandbox import ENDED
from evalkit.execution.task import Result

STATE_CAUSES = {
    "read-only": "a call writes to its arguments, which later questions share",
    "fresh": "a new object depends on earlier ones: memory outside the object, such as a static variable",
    "deterministic": "a new object answers otherwise: memory outside the object or not initialised, or random numbers",
    "stateless": "an answer depends on earlier questions: memory that a call leaves to the next one",
}
"""Rules whose breach alone may break many others, the plainest first, and what their breach means."""

STAGES = {"s2s": "scan to scan", "s2m": "scan to map"}


def rules_level(
    results: Sequence[RuleResult], subject: str = "back end", waivers: Mapping[str, str] | None = None
) -> AcceptanceLevel:
    """Level 0 from the results of all rules; ``waivers``: reasons by the name of a rule that may be broken.

    Where one exception ends several rules, only the first one is broken by it; the others were not judged. A broken
    rule that may cause the others comes first: one of ``STATE_CAUSES``, else one whose answer shows a mistake.
    """
    waived = {one.rule for one in results if one.outcome == "failed" and one.rule in (waivers or {})}
    broken = [one for one in results if one.outcome == "failed" and one.rule not in waived]
    first_rule, cause = _find_cause(broken)
    results, broken = (sorted(some, key=lambda one: one.rule != first_rule) for some in (results, broken))
    applicable = sum(one.outcome != "not applicable" for one in results)
    causes: dict[str, list[str]] = {}
    for one in broken:
        causes.setdefault(one.observed if one.raised else one.rule, []).append(one.rule)
    names = [first for first, *_ in causes.values()]
    summary = f"{len(causes)} of {applicable} rules broken" + (f": {', '.join(names)}" if names else "")
    if len(names) > 1 and cause:
        summary = f"{len(causes)} of {applicable} rules broken: {first_rule} ({cause})"
        summary += f", and perhaps by the same cause: {', '.join(names[1:])}"
    summary += f", {len(waived)} waived" if waived else ""
    kept = Counter(one.observed for one in results if one.outcome == "not judged")
    summary += "".join(f"; {count} not judged: {reason}" for reason, count in kept.items())
    unjudged = {rule: first for first, *others in causes.values() for rule in others}
    for first, *others in causes.values():
        summary += f"; not judged, as the exception of {first} ends them: {', '.join(others)}" if others else ""
    checks = [Check("all rules", "", "failed" if broken else "passed", "always", summary)]
    for one in results:
        name = f"rule {one.rule}"
        if one.rule in unjudged:
            observed = f"an exception ends it, as in rule {unjudged[one.rule]}"
            checks.append(Check(name, "", "not judged", "always", observed, detail=one.sentence))
        elif one.outcome == "failed":
            checks.append(Check(name, "", one.outcome, "always", f"{one.sentence} Observed: {one.observed}"))
        else:
            checks.append(Check(name, "", one.outcome, "never", one.observed, detail=one.sentence))
    question = f"Does the {subject} follow the rules of every {subject}: units, frames, state, resources, ranges?"
    return waive(AcceptanceLevel(0, "rules", question, tuple(checks)), waivers or {})


def _find_cause(broken: Sequence[RuleResult]) -> tuple[str, str]:
    """Return the rule whose breach may be the cause of others, and what it means; ("", "") if none is recognised.

    It is the first of ``STATE_CAUSES`` that an answer breaks, no exception and no end of a process; else the first rule
    with a cause.
    """
    answered = {one.rule for one in broken if not one.raised and not one.also_breaks}
    states = ((name, STATE_CAUSES[name]) for name in STATE_CAUSES if name in answered)
    return next(states, next(((one.rule, one.cause) for one in broken if one.cause), ("", "")))


def waive(level: AcceptanceLevel, waivers: Mapping[str, str]) -> AcceptanceLevel:
    """The level with the failed checks waived whose name, or its last word, is excepted; the detail is the reason."""

    def apply_waiver(check: Check) -> Check:
        reason = waivers.get(check.name) or waivers.get(check.name.split(" ", 1)[-1].rpartition(": ")[2])
        return (
            replace(check, outcome="waived", detail=f"waived: {reason}")
            if reason and check.outcome == "failed"
            else check
        )

    return replace(level, checks=tuple(map(apply_waiver, level.checks)))


def registrations_level(
    results: ResultsByPlace,
    peers: Mapping[str, ResultsByPlace],
    terms: ComparisonTerms,
    drawn: ResultsByPlace | None = None,
) -> AcceptanceLevel:
    """Level 1; ``peers``: the answers of other methods by name; ``drawn``: the comparison of drawn questions."""
    checks = _repetition_checks({**results, **(drawn or {})})  # a state explains every other difference
    checks += [_equality(place, result, terms, "pair") for place, result in results.items()]
    for place, result in (drawn or {}).items():
        checks += _drawn_checks(place, result, terms)
    checks = name_traces(name_causes(checks, drawn or {}, terms), drawn or {}, terms)
    checks += _field_checks({**results, **(drawn or {})}, terms)
    completed = {place: result for place, result in results.items() if ENDED not in result}
    if completed:
        checks += known_motion_checks(completed, terms)
        checks += [peer_check(name, completed, answers, terms) for name, answers in peers.items()]
    standalone = all(result["alone"] for result in completed.values())
    question = (
        f"Does one registration give the answer of {terms.reference}, and does it find a known motion?"
        if standalone
        else f"Given two scans at a time, does it give the answer of {terms.reference}?"
    )
    results_of_level = {"results": completed, "peers": dict(peers)}
    return waive(AcceptanceLevel(1, "registrations", question, tuple(checks), results_of_level), terms.waivers)


def lockstep_level(results: ResultsByPlace, terms: ComparisonTerms) -> AcceptanceLevel:
    """Level 2."""
    checks = [_equality(place, result, terms, "scan") for place, result in results.items()]
    checks += _field_checks(results, terms)
    question = f"Given the same questions as {terms.reference}, scan by scan: where does it first differ?"
    completed = {place: result for place, result in results.items() if ENDED not in result}
    return waive(AcceptanceLevel(2, "lockstep", question, tuple(checks), {"results": completed}), terms.waivers)


def mapper_check(place: str, result: Result, terms: ComparisonTerms) -> Check:
    """The comparison of two mappers, cell by cell after every scan."""
    name = f"mapper {terms.backend} draws the map of {terms.reference}"
    if ENDED in result:
        return unfinished_check(name, place, result, terms)
    comparison = result["cells"]
    margin = f"{comparison['margin']['log_odds']:.2g} log-odds per cell: a grid is float32"
    first = format_divergence(comparison, terms, "scan")
    observed = f"{comparison['n']} scans, cell by cell after each" + (f"; first {first}" if first else ", all equal")
    outcome: CheckOutcome = "passed" if comparison["equivalent"] else "failed"
    return Check(name, place, outcome, "always", observed, margin, data=comparison)


def unfinished_check(name: str, place: str, result: Result, terms: ComparisonTerms) -> Check:
    """The check of a process that ended before it had an answer."""
    observed = f"{terms.backend} (or {terms.reference}) did not finish: {result[ENDED]}"
    return Check(name, place, "failed", "always", observed)


def format_divergence(comparison: Mapping[str, Any], terms: ComparisonTerms, unit: str) -> str:
    """The first divergence of a comparison in words, with both labels; "" if there is none."""
    first = comparison["first"]
    if not first:
        return ""
    of_sides = r"^[AB](?= raises)" if "raises" in first["what"] else r"\b[AB]\b"  # not in a third party's exception
    what = re.sub(of_sides, lambda one: terms.reference if one.group() == "A" else terms.backend, first["what"])
    stage = f" ({format_stage(first['stage'])})" if first["stage"] != unit else ""
    iteration = f", iteration {first['iteration']}" if first["iteration"] is not None else ""
    return f"{unit} {first['scan']}{stage}{iteration}, {first['quantity']}: {first['kind']}: {what}"


def format_stage(stage: str) -> str:
    """A stage in words."""
    name = stage.removesuffix(DISTURBED)
    return STAGES.get(name, name) + (", disturbed guess" if name != stage else "")


def _equality(place: str, result: Result, terms: ComparisonTerms, unit: str) -> Check:
    """The check that the answers equal those of the reference; ``unit``: what is counted, "pair" or "scan"."""
    name = f"equal to {terms.reference}"
    if ENDED in result:
        return unfinished_check(name, place, result, terms)
    comparison = result[terms.margin]
    limits = comparison["margin"]
    margin = f"{limits['metres']:.2g} m, {limits['radians']:.2g} rad ({limits['origin']})"
    first = format_divergence(comparison, terms, unit)
    classes = ", ".join(f"{kind} {count}" for kind, count in comparison["classes"].items())
    size = f"{comparison['questions']} questions of {comparison['n']} {unit}s, compared by {comparison['level']}"
    worst = [abs(one["worst"]) for one in comparison["intervals"] if one["unit"] == "m" and one["worst"] is not None]
    if is_equal(comparison, terms.margin):
        diverged = f"; diverged by rounding: {classes}, first {first}" if first else ""
        single = "within single-precision rounding: " if terms.margin == FLOAT32 else ""
        observed = f"{single}largest difference {max(worst, default=math.inf):.2g} m"
        if comparison.get("excepted"):
            count = f"{comparison['excepted']} of {comparison['questions']} answers"
            observed += f"; {count} lie beyond the margin, where rounding decides the answer"
        return Check(name, place, "passed", "equal", observed, margin, size + diverged, comparison)
    unanswered = f"; {comparison['unanswered']} without an answer" if comparison["unanswered"] else ""
    observed = first or "every answer lies within the margin, but their mean does not"
    detail = f"all divergences: {classes or 'none'}{unanswered}; {size}"
    return Check(name, place, "failed", "equal", observed, margin, detail, comparison)


def _drawn_checks(place: str, result: Result, terms: ComparisonTerms) -> list[Check]:
    """The drawn questions by family."""
    if ENDED in result:
        return [unfinished_check(f"equal to {terms.reference}: drawn questions", place, result, terms)]
    comparison, checks = result[terms.margin], []
    limits = comparison["margin"]
    margin = f"at most {limits['metres']:.2g} m, {limits['radians']:.2g} rad: rounding at the scale of each question"
    for family, one in comparison["families"].items():
        name, asked = f"equal to {terms.reference}: {family}", f"{one['asked']} questions"
        if one["wrong"]:
            first = format_divergence(one, terms, family)
            observed = f"{one['wrong']} of {asked} differ; first {one['what']}: {first.partition(', ')[2]}"
            checks.append(Check(name, place, "failed", "equal", observed, margin, data=one))
        elif one["asked"]:
            checks.append(Check(name, place, "passed", "equal", _format_equal(one, terms), margin, data=one))
    return sorted(checks, key=lambda one: "has no effect" not in one.observed)  # the plainest cause first


def _format_equal(family: Mapping[str, Any], terms: ComparisonTerms) -> str:
    """That all answers of a family of drawn questions are equal, and within what."""
    equal = "within single-precision rounding" if terms.margin == FLOAT32 else "equal"
    text = f"{family['asked']} questions, all answers are {equal}"
    if family["allowed_m"]:
        text += f": at most {family['largest_m']:.2g} m apart where {family['allowed_m']:.2g} m are allowed"
    if family["excepted"]:
        text += f"; {family['excepted']} beyond that, where rounding decides the answer"
    return text


def _field_checks(results: ResultsByPlace, terms: ComparisonTerms) -> list[Check]:
    """One check for every field that differs where the pose does not, or one for all."""
    counts: dict[str, list[str]] = {}
    equal = excused = 0
    for place, result in results.items():
        if ENDED in result or "fields" not in result[terms.margin]:
            continue
        comparison = result[terms.margin]
        equal += comparison.get("equal_fields", 0)
        excused += comparison.get("excused_fields", 0)
        for where, one in {place: comparison, **comparison.get("families", {})}.items():
            for name, count in one["fields"].items():
                if name != "pose":
                    counts.setdefault(name, []).append(f"{where}: {count} of {_describe_first_field(one, name)}")
    checks = [
        Check(f"field {name}", "", "failed", "equal", f"{name} differs from {terms.reference} where the pose is equal"
              f"{_excuse_field(name, terms)}: {'; '.join(places)}")
        for name, places in counts.items()
    ]  # fmt: skip
    if checks or not equal + excused:
        return checks
    names = "converged, iterations, inliers, error, and every entry of the trace"
    observed = f"{names} agree, where they are reported, in {equal} questions with an equal pose"
    if excused:
        observed += f"; in {excused} more one of them differs, where rounding decides it"
    return [Check("fields", "", "passed", "equal", observed)]


def _describe_first_field(comparison: Mapping[str, Any], name: str) -> str:
    """The number of answers that were compared, and the first one in which a field differs, with both values."""
    if "examples" in comparison:
        return f"{comparison['compared']} answers, first {comparison['examples'][name]}"
    first = comparison["first_fields"][name]
    place = f"scan {first['scan']} ({format_stage(first['stage'])})"
    return f"{comparison['questions']} answers, first {place}: {first['what']}"


def _excuse_field(name: str, terms: ComparisonTerms) -> str:
    """That single precision may be the cause of a field that differs, "" under another margin."""
    if terms.margin != FLOAT32:
        return ""
    return (
        " within single-precision rounding, which may decide this field too "
        f"(if so, --except '{name}=single precision')"
    )


def _repetition_checks(results: ResultsByPlace) -> list[Check]:
    """Whether every answer came again to the bit at the end, in the opposite order."""
    counts = {place: result["unrepeated"] for place, result in results.items() if "unrepeated" in result}
    wrong = ", ".join(f"{place}: {count}" for place, count in counts.items() if count)
    if not counts:
        return []
    observed = f"asked again at the end, answers differ: {wrong}" if wrong else "all answers came again to the bit"
    return [Check("repeats its answers", "", "failed" if wrong else "passed", "always", observed)]
