"""Levels 0 to 2 of a dossier: rules kept, single registrations, and scan after scan in lockstep."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from evalkit.commands.validate.acceptance import Ground, Level, Line
from evalkit.commands.validate.equivalence.comparison import FLOAT32, ROUNDING
from evalkit.commands.validate.equivalence.lockstep import DISTURBED
from evalkit.commands.validate.equivalence.margins import Interval, interval
from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats
from evalkit.execution.sandbox import ENDED
from evalkit.execution.task import Result

STAGES = {"s2s": "scan to scan", "s2m": "scan to map"}

Found = Mapping[str, Result]
"""Results by the place they were found at: "room, seed 0"."""


@dataclass(frozen=True)
class Names:
    """Who is held against whom, under which margin; ``share``: how much of the noise's own spread may be added to it.

    ``against``: what informs and decides nothing.
    """

    mine: str
    twin: str
    margin: str
    share: float
    against: tuple[str, ...] = ()


def margin_of(found: Found, words: Sequence[str]) -> str:
    """The first margin under which all is equal; else the first under which something else than rounding differs."""
    results = [result for result in found.values() if ENDED not in result]
    for word in words:
        if results and all(equal(result[word], word) for result in results):
            return word
    kinds = [result[words[0]]["first"]["kind"] for result in results if result[words[0]]["first"]]
    return words[-1] if kinds and all(kind in ROUNDING for kind in kinds) else words[0]


def equal(found: Mapping[str, Any], word: str) -> bool:
    """Whether a comparison shows no difference.

    Under float32's margin every answer that lies beyond it must have parted by rounding: at a tie that single precision
    breaks otherwise. The means of those that did are no measure; what they lead to is asked of whole runs.
    """
    if word != FLOAT32 or found["level"] == "trajectories":
        return bool(found["equivalent"])
    return not found["astray"] and not found["unanswered"]


def within(found: Found, word: str) -> str:
    """The margin in words, with the largest difference met where rounding is no excuse."""
    results = [result for result in found.values() if ENDED not in result]
    if not results:
        return "within no margin: nothing was answered"
    margin = max((result[word]["margin"] for result in results), key=lambda one: float(one["metres"]))
    size = f"{margin['metres']:.2g} m and {margin['radians']:.2g} rad"
    return f"within what rounding to single precision may do ({size})" if word == FLOAT32 else f"within {size}"


def rules(result: Result) -> Level:
    """Level 0."""
    verdicts = [dict(zip(("rule", "sentence", "outcome", "observed"), one, strict=True)) for one in result["verdicts"]]
    broken = [one for one in verdicts if one["outcome"] == "failed"]
    named = ", ".join(one["rule"] for one in broken)
    lines = [
        Line(f"rule {one['rule']}", "", "failed", "always", f"{one['sentence']} Seen: {one['observed']}")
        for one in broken
    ]
    asked = sum(one["outcome"] != "not applicable" for one in verdicts)
    told = f"{len(broken)} of {asked} rules broken: {named}" if broken else f"none of {asked} rules broken"
    first = Line("rules kept", "", "failed" if broken else "passed", "always", told)
    question = "Does it keep the rules all others keep: units, frames, directions, no crash, no leak?"
    return Level(0, "conformance", question, (first, *lines), {"verdicts": verdicts})


def pairs(found: Found, others: Mapping[str, Found], names: Names) -> Level:
    """Level 1; ``others``: the answers of the references by name."""
    lines = [_equal(place, result, names, "pair") for place, result in found.items()]
    whole = {place: result for place, result in found.items() if ENDED not in result}
    if whole:
        lines += _known_motion(whole, names)
        lines += [_beside(name, whole, of, names) for name, of in others.items()]
    alone = all(result["alone"] for result in whole.values())
    question = (
        f"Does one registration give what {names.twin}'s gives, and does it find a motion that is known?"
        if alone
        else f"Asked about two scans at a time, does it give what {names.twin} gives?"
    )
    return Level(1, "registration", question, tuple(lines), {"found": whole, "others": dict(others)})


def scans(found: Found, names: Names) -> Level:
    """Level 2."""
    lines = tuple(_equal(place, result, names, "scan") for place, result in found.items())
    question = f"Scan after scan, asked what {names.twin} was asked, where does it first differ?"
    whole = {place: result for place, result in found.items() if ENDED not in result}
    return Level(2, "scan by scan", question, lines, {"found": whole})


def ended(name: str, place: str, result: Result, names: Names) -> Line:
    """The line of a process that ended before it had an answer."""
    return Line(name, place, "failed", "always", f"{names.mine} (or {names.twin}) did not finish: {result[ENDED]}")


def words(found: Mapping[str, Any], names: Names, unit: str) -> str:
    """The first divergence of a comparison in words, with the names of both; "" where there is none."""
    first = found["first"]
    if not first:
        return ""
    what = first["what"]
    if "raises" not in what:  # somebody else's words stay as they are
        what = re.sub(r"\b[AB]\b", lambda one: names.twin if one.group() == "A" else names.mine, what)
    stage = f" ({told_stage(first['stage'])})" if first["stage"] != unit else ""
    at = f", iteration {first['iteration']}" if first["iteration"] is not None else ""
    return f"{unit} {first['scan']}{stage}{at}, {first['quantity']}: {first['kind']}: {what}"


def told_stage(stage: str) -> str:
    """A stage in words."""
    name = stage.removesuffix(DISTURBED)
    return STAGES.get(name, name) + (", guess far off" if name != stage else "")


def _equal(place: str, result: Result, names: Names, unit: str) -> Line:
    name = f"equal to {names.twin}"
    if ENDED in result:
        return ended(name, place, result, names)
    found = result[names.margin]
    margin = f"{found['margin']['metres']:.2g} m, {found['margin']['radians']:.2g} rad ({found['margin']['origin']})"
    first, classes = words(found, names, unit), ", ".join(f"{kind} {n}" for kind, n in found["classes"].items())
    asked = f"asked: {found['questions']} questions of {found['n']} {unit}s, seen as deep as {found['level']}"
    largest = max((abs(one["worst"]) for one in found["intervals"] if one["unit"] == "m" and one["worst"] is not None),
                  default=math.inf)  # fmt: skip
    if equal(found, names.margin):
        parted = f"; parted by rounding: {classes}, first {first}" if first else ""
        return Line(name, place, "passed", "equal", f"largest difference {largest:.2g} m", margin, asked + parted)
    silent = f"; {found['unanswered']} without an answer" if found["unanswered"] else ""
    where = first or "no single answer lies beyond the margin, but their mean does"
    return Line(name, place, "failed", "equal", where, margin, f"in all: {classes or 'none'}{silent}; {asked}")


def _known_motion(found: Found, names: Names) -> list[Line]:
    """Whether known motions are found as well as by the twin."""
    known = {place: result for place, result in found.items() if np.isfinite(result["truth"]).any()}
    if not known:
        return []
    mine, theirs = (errors(known, side) for side in ("b", "a"))
    margins = noise(known, names.share)
    on = ", ".join(dict.fromkeys(place.partition(",")[0] for place in known))
    lines = []
    for column, unit, what in ((0, "m", "position"), (1, "rad", "heading")):
        answered = np.isfinite(mine[:, column]) & np.isfinite(theirs[:, column])
        gap = _interval(what, unit, (mine - theirs)[answered, column], margins[column])
        told = (
            f"mean error {np.nanmean(mine[:, column]):.3g} {unit} against {np.nanmean(theirs[:, column]):.3g} {unit}; "
            f"difference {_told(gap)}"
        )
        good = answered.all() and gap.high < gap.margin
        name = f"finds a known motion as well as {names.twin}: {what}"
        lines.append(Line(name, on, "passed" if good else "failed", "as-good", told, _noise_words(gap, names.share)))
    return lines


def _beside(name: str, found: Found, answers: Found, names: Names) -> Line:
    """How far the answers lie from those of another method."""
    label = f"beside {name}"
    shared = {place: result for place, result in found.items() if ENDED not in answers.get(place, {ENDED: ""})}
    if not shared:
        why = "; ".join(dict.fromkeys(str(result[ENDED]) for result in answers.values()))
        return Line(label, "", "not applicable", "", f"it did not finish: {why}")
    apart = np.concatenate([se2.between(answers[place]["rows"], result["b"]) for place, result in shared.items()])
    calm = np.concatenate([calm_ones(result) for result in shared.values()])
    rows = apart[calm & np.isfinite(apart).all(axis=1)]
    if not len(rows):
        return Line(label, "", "not applicable", "", "no pair that both answered")
    margins = noise(shared, names.share)
    far = np.hypot(rows[:, 0], rows[:, 1])
    tests = [_interval(axis, unit, rows[:, column], margins[column // 2])
             for column, (axis, unit) in enumerate((("x", "m"), ("y", "m"), ("theta", "rad")))]  # fmt: skip
    agree = all(one.inside for one in tests)
    told = (
        f"answers lie {np.median(far):.2g} m apart (median; 95 % within {np.quantile(far, 0.95):.2g} m), "
        f"{'without a bias' if agree else 'with a bias beyond the margin, or too few pairs to exclude one'}"
    )
    means = f"means, of {len(rows)} pairs: x {_told(tests[0])}, y {_told(tests[1])}, theta {_told(tests[2])}"
    on = ", ".join(dict.fromkeys(place.partition(",")[0] for place in shared))
    return Line(label, f"{on}, guess little off", "told", "", told, _noise_words(tests[0], names.share), means)


def calm_ones(result: Result) -> Bools:
    """Which questions (N,) had a guess that was little off."""
    return np.array([not stage.endswith(DISTURBED) for stage in result["stage"]], dtype=np.bool_)


def errors(found: Found, side: str) -> Floats:
    """Errors (N, 2) of all answers to known motions: metres and radians, nan where there is none."""
    apart = np.concatenate([se2.between(result["truth"], result[side]) for result in found.values()])
    return np.stack([np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])], axis=1)


def noise(found: Found, share: float) -> tuple[float, float]:
    """A share of what noise alone leaves of an answer: metres, radians.

    N points whose mean distance to their partners is e fix a position to about e / sqrt(N), and a heading to that
    divided by their root mean square radius.
    """
    metres = np.concatenate([result["residual_m"] / np.sqrt(result["points"]) for result in found.values()])
    radii = np.concatenate([result["radius_m"] for result in found.values()])
    return share * float(np.median(metres)), share * float(np.median(metres / radii))


def _interval(what: str, unit: str, values: Floats, margin: float) -> Interval:
    return interval(what, unit, values, np.arange(1, len(values) + 1), margin)


def _told(one: Interval) -> str:
    return f"{one.mean:.2g} {one.unit} (90 % [{one.low:.2g}, {one.high:.2g}])"


def _noise_words(one: Interval, share: float) -> str:
    return f"{one.margin:.2g} {one.unit}: {share:g} of what noise alone leaves, mean residual / sqrt(points)"


GROUNDS: Mapping[Ground, str] = {
    "always": "decides",
    "equal": "decides whether it is equal",
    "as-good": "decides whether it is as good",
    "": "informs",
}
