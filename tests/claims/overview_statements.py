"""The sentences of the overview, each with the check of its names and numbers."""

from __future__ import annotations

import re
from collections.abc import Iterator

from amounts import list_of
from facts import Facts
from statements import BROKEN, IN_OVERVIEW, kind, same

END = r"\.(?= [A-Z]|$)"


def counted(facts: Facts) -> list[str]:
    """Return the sequences that count in the tally."""
    own = [one for one in facts.runs if facts.outcome(one) in ("winner", "tied") or one in _held_alone(facts)]
    return [one for one in own if not facts.by_maps(one) and not facts.by_fit(one)]


def _held_alone(facts: Facts) -> list[str]:
    """Return the sequences that count though one method alone is ranked: another one broke or lost the track there."""
    found = []
    for where in facts.content["answer"]["counted"]:
        if facts.outcome(where) == "single":
            others = [one for one in facts.runs[where] if one not in facts.ranked(where, facts.deciding(where) or "")]
            broken = [one for one in others if any(run["status"] in BROKEN for run in facts.runs[where][one])]
            own = facts.find(where, facts.deciding(where) or "")
            lost = [one for one in others if own[one].lost_s is not None]
            found += [where] if any(not own[one].tuned for one in (*broken, *lost)) else []
    return found


@kind(IN_OVERVIEW, r"No sequence has both ground truth and repeated runs to compare, so there is no overall winner\.")
def nothing_counted(facts: Facts) -> Iterator[str]:
    yield from same("counted", counted(facts), [])


@kind(
    IN_OVERVIEW,
    rf"Over (?:the one sequence|the (?P<count>\d+) sequences) with ground truth and a geometry that determines the "
    rf"pose, (?P<listed>.+?){END}",
)
def wins(facts: Facts, count: str | None, listed: str) -> Iterator[str]:
    own = counted(facts)
    yield from same("sequences", int(count or 1), len(own))
    for method, times, where in re.findall(r"(?:^|, | and )([^,]+?) wins (\d+) \((.+?)\)", listed):
        true = [one for one in own if facts.outcome(one) == "winner" and facts.led(one)[0] == [method]]
        yield from same(f"{method} wins", (where.split(", "), int(times)), (true, len(true)))
    tied = [one for one in own if facts.outcome(one) == "tied"]
    every = [one for one in tied if facts.all_tied(one)]
    alone = [one for one in tied if len(facts.led(one)[1]) == 1]
    groups = {
        "the best methods are tied": [one for one in tied if one not in (*every, *alone)],
        "all ranked methods are tied": every,
        "too few runs show a leader": alone,
        "one method alone is ranked": _held_alone(facts),
    }
    for words, true in groups.items():
        match = re.search(rf"{words} on (\d+) sequences? \((.+?)\)", listed)
        yield from same(words, match[2].split(", ") if match else [], true)
        yield from same(f"number of {words}", int(match[1]) if match else 0, len(true))


@kind(IN_OVERVIEW, rf"The reference method, (?P<method>.+?), (?P<listed>(?:loses|lost|is |has|wins).+?){END}")
def reference_over_all(facts: Facts, method: str, listed: str) -> Iterator[str]:
    verbs = {
        "loses": "worse", "lost the track on": "lost", "is not comparable on": "not comparable",
        "has too few runs to tell on": "undecided", "is tied with the best on": "tied", "wins": "best",
    }  # fmt: skip
    own = [one for one in counted(facts) if one not in _held_alone(facts)]
    for verb, wanted in verbs.items():
        true = [one for one in own if method in facts.runs[one] and facts.standing(one, method) == wanted]
        match = re.search(rf"{verb} (\d+) of (\d+) \((.+?)\)", listed)
        yield from same(f"{method} {verb}", match[3].split(", ") if match else [], true)
        if match:
            yield from same("counts", (int(match[1]), int(match[2])), (len(true), len(own)))


@kind(IN_OVERVIEW, r"Wheel odometry alone is not among the methods, so there is no baseline\.")
def without_baseline(facts: Facts) -> Iterator[str]:
    yield from same("baselines", facts.with_role("baseline"), [])


@kind(IN_OVERVIEW, rf"Worse than (?P<base>.+?) alone: (?P<listed>.+?){END}")
def behind_baseline(facts: Facts, base: str, listed: str) -> Iterator[str]:
    rest = listed
    for method in facts.methods:
        where = [one for one in facts.runs if method in facts.behind(one, base)]
        several = " and ".join([", ".join(where[:-1]), *where[-1:]]) if len(where) > 1 else "".join(where)
        if where:
            told = f"{method} on {several}"
            yield from same(f"{method} behind {base}", told in rest, True)
            rest = rest.replace(told, "", 1)
    yield from same("named beyond", re.sub(r"[, ]|\band\b", "", rest), "")


@kind(IN_OVERVIEW, r"No method can be compared with (?P<base>.+?) alone: no sequence has repeated runs of both\.")
@kind(IN_OVERVIEW, r"No method is clearly worse than (?P<base>.+?) alone on any sequence with repeated runs of both\.")
def none_behind(facts: Facts, base: str) -> Iterator[str]:
    yield from same("behind the baseline", [one for one in facts.runs if facts.behind(one, base)], [])


@kind(IN_OVERVIEW, r"No run took more CPU time than the scan period on more than 1 % of its scans\.")
@kind(IN_OVERVIEW, rf"Slower than the sensor on more than 1 % of the scans: (?P<listed>.+?){END}")
def speed(facts: Facts, listed: str = "") -> Iterator[str]:
    late: dict[str, list[str]] = {}
    for run in facts.content["runs"]:
        percent = run["scores"].get("late_percent", {}).get("value") or 0.0
        if percent > 1.0 and run["sequence"] not in late.get(run["method"], []):
            late.setdefault(run["method"], []).append(run["sequence"])
    known = any("late_percent" in run["scores"] for run in facts.content["runs"])
    for method, where in late.items() if known else ():
        if method not in facts.with_role("baseline"):
            named = all(re.search(rf"{re.escape(method)} on [^.]*{re.escape(one)}", listed) for one in where)
            yield from same(f"{method} late", named, True)


@kind(IN_OVERVIEW, rf"Not counted: (?P<listed>.+?){END}")
def not_counted(facts: Facts, listed: str) -> Iterator[str]:
    in_title = facts.content["answer"]["counted"]
    tied = re.search(r"(?:^|\), |\) and )([^()]+) \(all tied\)", listed)
    every = [one for one in counted(facts) if facts.all_tied(one) and one not in in_title]
    yield from same("all tied", list_of(tied[1]) if tied else [], every)
    apart = re.search(r"(?:^|\), |\) and )([^()]+) \(not told apart\)", listed)
    undecided = [one for one in counted(facts) if one not in (*in_title, *every)]
    yield from same("not told apart", list_of(apart[1]) if apart else [], undecided)
    own = [one for one in counted(facts) if one not in (*every, *undecided)]
    for one in facts.runs:
        named = re.search(rf"(?:^|[ ,]){re.escape(one)}(?: \(|,| and |$)", listed) is not None
        yield from same(f"{one} not counted", named, one not in own)


@kind(IN_OVERVIEW, r"Each sequence was run once\. .+? up to 10 s of that run\. .+? no verdict\.")
@kind(
    IN_OVERVIEW,
    r"Numbers are medians over up to (?P<most>\d+) runs\. From 3 runs on, a 95 % interval is .+? \((?P<few>\d+) % "
    r"below six runs and over perturbed runs of a recording, else (?P<many>\d+) %, which keeps verdicts on equal "
    r"methods at 5 % when measured\) excludes zero and the difference is at least 5 % and, for positions, 2 mm\. .+? "
    r"chance\. Tied methods are close, .+? ground truth\.",
)
def statistics(facts: Facts, most: str = "1", few: str = "99", many: str = "97") -> Iterator[str]:
    for runs, perturbed, stated in ((5, False, few), (6, True, few), (6, False, many)):
        yield from same("confidence", int(stated), round(100.0 * facts.confidence(runs, perturbed)))
    every = [sum(run["scans_answered"] > 0 for run in runs) for own in facts.runs.values() for runs in own.values()]
    yield from same("runs", int(most), max(every))
