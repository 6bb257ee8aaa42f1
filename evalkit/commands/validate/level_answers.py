"""Levels 0 to 2 of an acceptance report: rules, single registrations, and registrations in lockstep over a sequence."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from evalkit.commands.validate.acceptance import AcceptanceLevel, Check, Outcome
from evalkit.commands.validate.equivalence.comparison import FLOAT32, ROUNDING
from evalkit.commands.validate.equivalence.lockstep import DISTURBED
from evalkit.commands.validate.equivalence.margins import EquivalenceInterval, interval
from evalkit.commands.validate.rules.rule import RuleResult
from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats
from evalkit.execution.sandbox import ENDED
from evalkit.execution.task import Result

UNNAMED = ("different steps from", "different poses", "not both report their", "another answer", "guess is returned")
"""Phrases of a first difference whose cause is not known from the answers alone."""

STAGES = {"s2s": "scan to scan", "s2m": "scan to map"}

Results = Mapping[str, Result]
"""Results by place: "room, seed 0"."""


@dataclass(frozen=True)
class ComparisonTerms:
    """The labels of the validated back end and its reference, the margin, and the peers.

    ``noise_share``: the share of the noise level by which an answer may be worse and still count as good. ``waivers``:
    reasons by the name of a check that is excepted.
    """

    backend: str
    reference: str
    margin: str
    noise_share: float
    peers: tuple[str, ...] = ()
    waivers: Mapping[str, str] = field(default_factory=dict)


def choose_margin(results: Results, margins: Sequence[str]) -> str:
    """The first margin under which all results are equal.

    Single precision is chosen only if every result shows its rounding and the back end repeats all its answers to the
    bit: a difference in some results, or one that comes and goes, is no rounding. If there is no such margin: the last
    one if every difference is due to rounding, else the first.
    """
    completed = [result for result in results.values() if ENDED not in result]
    if not completed or any(result.get("unrepeated") for result in completed):
        return margins[0]
    for margin in margins:
        contradicted = margin != margins[0] and any(is_equal(result[margins[0]], margins[0]) for result in completed)
        if not contradicted and all(is_equal(result[margin], margin) for result in completed):
            return margin
    if any(is_equal(result[margins[0]], margins[0]) for result in completed):
        return margins[0]
    kinds = [result[margins[0]]["first"]["kind"] for result in completed if result[margins[0]]["first"]]
    return margins[-1] if kinds and all(kind in ROUNDING for kind in kinds) else margins[0]


def is_equal(comparison: Mapping[str, Any], margin: str) -> bool:
    """Whether a comparison shows no difference.

    Under the float32 margin, every answer beyond the margin must have diverged by rounding: at a tie that single
    precision breaks differently. The mean of such answers is not compared; level 3 measures what they lead to.
    """
    if margin != FLOAT32 or comparison["level"] == "trajectories":
        return bool(comparison["equivalent"])
    return not comparison["beyond_rounding"] and not comparison["unanswered"]


def format_margin(results: Results, margin: str) -> str:
    """The margin in words, at the largest value over all results."""
    completed = [result for result in results.values() if ENDED not in result and "families" not in result[margin]]
    if not completed:
        return "within no margin: no question was answered"
    largest = max((result[margin]["margin"] for result in completed), key=lambda one: float(one["metres"]))
    size = f"{largest['metres']:.2g} m and {largest['radians']:.2g} rad"
    return f"within the single-precision rounding margin ({size})" if margin == FLOAT32 else f"within {size}"


def rules_level(
    results: Sequence[RuleResult], subject: str = "back end", waivers: Mapping[str, str] | None = None
) -> AcceptanceLevel:
    """Level 0 from the results of all rules; ``waivers``: reasons by the name of a rule that may be broken."""
    waived = {one.rule for one in results if one.outcome == "failed" and one.rule in (waivers or {})}
    broken = [one for one in results if one.outcome == "failed" and one.rule not in waived]
    applicable = sum(one.outcome != "not applicable" for one in results)
    names = f": {', '.join(one.rule for one in broken)}" if broken else ""
    summary = f"{len(broken)} of {applicable} rules broken{names}" + (f", {len(waived)} waived" if waived else "")
    checks = [Check("all rules", "", "failed" if broken else "passed", "always", summary)]
    for one in results:
        name = f"rule {one.rule}"
        if one.outcome == "failed":
            checks.append(Check(name, "", one.outcome, "always", f"{one.sentence} Observed: {one.observed}"))
        else:
            checks.append(Check(name, "", one.outcome, "never", one.observed, detail=one.sentence))
    question = f"Does the {subject} follow the rules of every {subject}: units, frames, state, resources, ranges?"
    return waive(AcceptanceLevel(0, "rules", question, tuple(checks)), waivers or {})


def waive(level: AcceptanceLevel, waivers: Mapping[str, str]) -> AcceptanceLevel:
    """The level with the failed checks waived whose name, or its last word, is excepted; the detail is the reason."""

    def waived(check: Check) -> Check:
        reason = waivers.get(check.name) or waivers.get(check.name.split(" ", 1)[-1].rpartition(": ")[2])
        return (
            replace(check, outcome="waived", detail=f"waived: {reason}")
            if reason and check.outcome == "failed"
            else check
        )

    return replace(level, checks=tuple(map(waived, level.checks)))


def registrations_level(
    results: Results, peers: Mapping[str, Results], terms: ComparisonTerms, drawn: Results | None = None
) -> AcceptanceLevel:
    """Level 1; ``peers``: the answers of other methods by name; ``drawn``: the comparison of drawn questions."""
    checks = [_equality(place, result, terms, "pair") for place, result in results.items()]
    for place, result in (drawn or {}).items():
        checks += _drawn_checks(place, result, terms)
    checks = _name_by_questions(checks, drawn or {}, terms)
    checks += _field_checks({**results, **(drawn or {})}, terms)
    checks += _repetition_checks({**results, **(drawn or {})})
    completed = {place: result for place, result in results.items() if ENDED not in result}
    if completed:
        checks += _known_motion(completed, terms)
        checks += [_distance_to_peer(name, completed, answers, terms) for name, answers in peers.items()]
    standalone = all(result["alone"] for result in completed.values())
    question = (
        f"Does one registration give the answer of {terms.reference}, and does it find a known motion?"
        if standalone
        else f"Given two scans at a time, does it give the answer of {terms.reference}?"
    )
    results_of_level = {"results": completed, "peers": dict(peers)}
    return waive(AcceptanceLevel(1, "registrations", question, tuple(checks), results_of_level), terms.waivers)


def lockstep_level(results: Results, terms: ComparisonTerms) -> AcceptanceLevel:
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
    outcome: Outcome = "passed" if comparison["equivalent"] else "failed"
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
    what = first["what"]
    if "raises" not in what:  # keep the text of a third party's exception
        what = re.sub(r"\b[AB]\b", lambda one: terms.reference if one.group() == "A" else terms.backend, what)
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
        observed = f"largest difference {max(worst, default=math.inf):.2g} m"
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
            checks.append(Check(name, place, "passed", "equal", f"{asked}, all answers are equal", margin, data=one))
    return sorted(checks, key=lambda one: "has no effect" not in one.observed)  # the plainest cause first


def _name_by_questions(checks: list[Check], drawn: Results, terms: ComparisonTerms) -> list[Check]:
    """The checks, with what the drawn questions say about a first difference that has no name.

    With well separated points every neighbour search and every outlier rule give the same pairs.
    """
    families = [one[terms.margin]["families"] for one in drawn.values() if ENDED not in one]
    if not families or "clear" not in families[0]:
        return checks
    where = next(one[terms.margin]["where"] for one in drawn.values() if ENDED not in one)
    clear, limits = families[0]["clear"], families[0].get("limits", {"wrong": 0})

    def cause(text: str) -> str:
        if where:
            return f"answers differ {where}"
        if clear["wrong"] and " pairs against " in clear["first"]["what"]:
            return "the neighbours differ: even well separated points do not all get a partner"
        if clear["wrong"]:
            return "the step differs: with well separated points the pairs are the same, and the answers are not"
        if limits["wrong"] and " pairs against " in text:
            return "the outlier rule differs: well separated points give equal answers, pairs near the limits do not"
        return "the neighbours differ: well separated points give equal answers, crowded ones do not"

    def named(check: Check) -> Check:
        text = check.observed
        if check.outcome == "failed" and any(phrase in text for phrase in UNNAMED):
            return replace(check, observed=f"{text}; {cause(text)}")
        return check

    return [named(check) for check in checks]


def _field_checks(results: Results, terms: ComparisonTerms) -> list[Check]:
    """One check for every field that differs where the pose does not, or one for all."""
    counts: dict[str, list[str]] = {}
    questions = 0
    for place, result in results.items():
        if ENDED in result or "fields" not in result[terms.margin]:
            continue
        comparison = result[terms.margin]
        questions += comparison["questions"]
        for where, one in {place: comparison, **comparison.get("families", {})}.items():
            for name, count in one["fields"].items():
                if name != "pose":
                    example = f", first {one['examples'][name]}" if "examples" in one else ""
                    counts.setdefault(name, []).append(f"{where}: {count}{example}")
    checks = [
        Check(f"field {name}", "", "failed", "equal", f"{name} differs from {terms.reference} where the pose is equal: "
              f"{'; '.join(places)}")
        for name, places in counts.items()
    ]  # fmt: skip
    if checks or not questions:
        return checks
    names = "converged, iterations, inliers, error, and every entry of the trace"
    return [Check("fields", "", "passed", "equal", f"{names} agree in {questions} questions where they are reported")]


def _repetition_checks(results: Results) -> list[Check]:
    """Whether every answer came again to the bit at the end, in the opposite order."""
    counts = {place: result["unrepeated"] for place, result in results.items() if "unrepeated" in result}
    wrong = ", ".join(f"{place}: {count}" for place, count in counts.items() if count)
    if not counts:
        return []
    observed = f"asked again at the end, answers differ: {wrong}" if wrong else "all answers came again to the bit"
    return [Check("repeats its answers", "", "failed" if wrong else "passed", "always", observed)]


def _known_motion(results: Results, terms: ComparisonTerms) -> list[Check]:
    """Whether the back end finds known motions as well as the reference does."""
    known = {place: result for place, result in results.items() if np.isfinite(result["truth"]).any()}
    if not known:
        return []
    own, others = (answer_errors(known, side) for side in ("b", "a"))
    margins = noise_level(known, terms.noise_share)
    on = ", ".join(dict.fromkeys(place.partition(",")[0] for place in known))
    checks = []
    for column, unit, quantity in ((0, "m", "position"), (1, "rad", "heading")):
        answered = np.isfinite(own[:, column]) & np.isfinite(others[:, column])
        gap = _interval(quantity, unit, (own - others)[answered, column], margins[column])
        observed = (
            f"mean error {np.nanmean(own[:, column]):.3g} {unit}, {terms.reference} "
            f"{np.nanmean(others[:, column]):.3g} {unit}; difference {_format_interval(gap)}"
        )
        outcome, hint = judge_gap(gap.mean, gap.low, gap.high, gap.margin, gap.n)
        if not answered.all():
            outcome, hint = "failed", f"{int((~answered).sum())} pairs have no answer"
        name = f"finds a known motion as well as {terms.reference}: {quantity}"
        margin = _format_noise(gap, terms.noise_share)
        checks.append(Check(name, on, outcome, "as-good", observed, margin, hint))
    return checks


def _distance_to_peer(name: str, results: Results, answers: Results, terms: ComparisonTerms) -> Check:
    """The distance of the answers to those of another method."""
    label = f"compared with {name}"
    shared = {place: result for place, result in results.items() if ENDED not in answers.get(place, {ENDED: ""})}
    if not shared:
        why = "; ".join(dict.fromkeys(str(result[ENDED]) for result in answers.values()))
        return Check(label, "", "not applicable", "never", f"{name} did not finish: {why}")
    apart = np.concatenate([se2.between(answers[place]["rows"], result["b"]) for place, result in shared.items()])
    near = np.concatenate([near_guesses(result) for result in shared.values()])
    rows = apart[near & np.isfinite(apart).all(axis=1)]
    if not len(rows):
        return Check(label, "", "not applicable", "never", "no pair was answered by both")
    margins = noise_level(shared, terms.noise_share)
    distance = np.hypot(rows[:, 0], rows[:, 1])
    tests = [_interval(axis, unit, rows[:, column], margins[column // 2])
             for column, (axis, unit) in enumerate((("x", "m"), ("y", "m"), ("theta", "rad")))]  # fmt: skip
    unbiased = all(one.inside for one in tests)
    observed = (
        f"answers lie {np.median(distance):.2g} m apart (median; 95 % within {np.quantile(distance, 0.95):.2g} m), "
        f"{'without a bias' if unbiased else 'with a bias beyond the margin, or too few pairs to exclude one'}"
    )
    x, y, theta = (_format_interval(one) for one in tests)
    on = ", ".join(dict.fromkeys(place.partition(",")[0] for place in shared))
    return Check(
        label, f"{on}, near guesses", "informative", "never", observed, _format_noise(tests[0], terms.noise_share),
        f"means over {len(rows)} pairs: x {x}, y {y}, theta {theta}",
    )  # fmt: skip


def judge_gap(value: float, low: float, high: float, margin: float, count: int) -> tuple[Outcome, str]:
    """Whether a loss is shown to be below a margin, or above it, and else what would show it.

    ``low``, ``high``: the 90 % interval of the loss over ``count`` values; it shrinks with the root of their number.
    """
    if high < margin:
        return "passed", ""
    if low > margin:
        return "failed", "its loss is shown to exceed the margin"
    if value >= margin or not math.isfinite(high):
        return "not shown", "more data would show which: the loss is near the margin, or the values are too few"
    wanted = count * ((high - value) / (margin - value)) ** 2
    return (
        "not shown",
        f"about {math.ceil(wanted):,} values instead of {count:,} would show it: more --seeds, longer --on",
    )


def near_guesses(result: Result) -> Bools:
    """Which questions (N,) started from a guess near the answer, not from a disturbed one."""
    return np.array([not stage.endswith(DISTURBED) for stage in result["stage"]], dtype=np.bool_)


def answer_errors(results: Results, side: str) -> Floats:
    """Errors (N, 2) of all answers to known motions: metres and radians, nan if there is no answer or no truth."""
    apart = np.concatenate([se2.between(result["truth"], result[side]) for result in results.values()])
    return np.stack([np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])], axis=1)


def noise_level(results: Results, share: float) -> tuple[float, float]:
    """A share of the uncertainty of an answer due to the sensor's noise alone: metres, radians.

    N points with mean distance e to their partners determine a position to about e / sqrt(N), and a heading to that
    divided by their root mean square radius.
    """
    metres = np.concatenate([result["residual_m"] / np.sqrt(result["points"]) for result in results.values()])
    radii = np.concatenate([result["radius_m"] for result in results.values()])
    return share * float(np.median(metres)), share * float(np.median(metres / radii))


def _interval(quantity: str, unit: str, values: Floats, margin: float) -> EquivalenceInterval:
    return interval(quantity, unit, values, np.arange(1, len(values) + 1), margin)


def _format_interval(one: EquivalenceInterval) -> str:
    return f"{one.mean:.2g} {one.unit} (90 % [{one.low:.2g}, {one.high:.2g}])"


def _format_noise(one: EquivalenceInterval, share: float) -> str:
    return f"{one.margin:.2g} {one.unit}: {share:g} of the noise level, mean residual / sqrt(points)"
