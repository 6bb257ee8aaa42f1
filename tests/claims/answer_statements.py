"""The title, the subtitle and the pills of a report, each with the check of its names and numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from statistics import median

from amounts import AMOUNT, NUMBER, check_amount, list_of
from facts import Facts
from statements import BROKEN, LOSS, NOT_EXECUTED, Check, kind, runs_of, same

LIMIT = r" that counts? for (?:it|them)"
COUNTS = (
    rf"(?:(?P<counts>\d+ of \d[\d a-z,]*?)|(?P<bare>\d+)) (?:data sets?|recordings?)(?P<limit>{LIMIT})?"
    r"(?: by the fit to the known map)?"
)
END = r"\.(?= [A-Z]|$)"

IN_ANSWER: list[tuple[str, Check]] = []
IN_PILLS: list[tuple[str, Check]] = []


def standings(facts: Facts) -> dict[str, tuple[int, int]]:
    """Return on how many of the data sets that count each method leads, and on how many it takes part."""
    over = list(facts.content["answer"]["counted"])
    table = {}
    for method in facts.methods:
        part = [one for one in over if takes_part(facts, one, method)]
        table[method] = sum(method in leaders(facts, one) for one in part), len(part)
    return table


def takes_part(facts: Facts, where: str, method: str) -> bool:
    """Whether a run of a method started on a sequence and its settings were not chosen there."""
    started = any(run["status"] not in NOT_EXECUTED for run in facts.runs[where].get(method, ()))
    return started and not facts.find(where, facts.deciding(where) or "")[method].tuned


def leaders(facts: Facts, where: str) -> Sequence[str]:
    """Return the best method of a sequence and those tied with it."""
    if facts.by_maps(where) and len(facts.led(where)[0]) > 1:
        return facts.agreed(where)
    return facts.led(where)[1]


@kind(
    IN_ANSWER,
    rf"Take (?P<names>.+?): (?:each )?(?:the best map|best or tied) on {COUNTS}"
    r"(?:; next best: (?P<next>.+?), (?P<next_led>\d+) of (?P<all>all )?(?P<next_of>\d+)"
    rf"(?P<next_limit>{LIMIT})?|(?P<none>; no other method on any)"
    r"|(?:; (?P<beaten>[^;]+?) leads? as often, but the paired tests find (?:a better method|better methods))?"
    r"(?:; (?P<behind>[^;]+?) leads? as often, but (?:another one leads|others lead) more often where "
    r"(?:both count|they count too))?)\.",
)
def take(facts: Facts, names: str, **said: str | None) -> Iterator[str]:
    table, winners, counted = standings(facts), names.split(" or "), len(facts.content["answer"]["counted"])
    yield from _led(facts, winners, said)
    for what in ("rivals", "undecided"):
        yield from same(what, facts.content["answer"][what], [])
    yield from same("may lead as often", _undecided(facts), [])
    most = max(led for led, _ in table.values())
    as_often = [name for name, (led, _) in table.items() if led == most and name not in winners]
    counts = {what: re.fullmatch(r"(\d+) methods", said[what] or "") for what in ("beaten", "behind")}
    stated = {what: [] if counts[what] else list_of(said[what] or "") if said[what] else [] for what in counts}
    yield from same(
        "as often", sum(int(c[1]) for c in counts.values() if c) + sum(map(len, stated.values())), len(as_often)
    )
    yield from same("named", [one for own in stated.values() for one in own if one not in as_often], [])
    yield from same("not beaten", [name for name in stated["beaten"] if not facts.better(name)], [])
    yield from same("not behind", [name for name in stated["behind"] if not _ahead(facts, name)], [])
    yield from same("behind", [name for name in winners if _ahead(facts, name)], [])
    others = {name: (led, part) for name, (led, part) in table.items() if name not in winners and part}
    most = max((led for led, _ in others.values()), default=0)
    yield from same("no other on any", bool(said["none"]), bool(others) and not most)
    if said["next"]:
        yield from same("next best", (int(said["next_led"] or 0), int(said["next_of"] or 0)), others.get(said["next"]))
        yield from same("next best leads", int(said["next_led"] or 0), most)
        yield from same("next best limited", bool(said["next_limit"]), int(said["next_of"] or 0) < counted)
        yield from same("all", bool(said["all"]), bool(said["limit"]) and not said["next_limit"])
    elif most and not as_often and others:
        first = [name for name, (led, _) in others.items() if led == most]
        yield from same("next best, not beaten", [one for one in first if not set(facts.better(one)) & set(others)], [])


def _led(facts: Facts, winners: list[str], said: Mapping[str, str | None]) -> Iterator[str]:
    """Check on how many data sets the methods of a title lead, of those that count for each."""
    table, counted = standings(facts), len(facts.content["answer"]["counted"])
    yield from same("winners", set(winners), set(facts.content["answer"]["winners"]))
    if said["bare"]:
        true = {table[name] for name in winners if name in table}
        yield from same("leads", {int(said["bare"])}, {led for led, _ in true})
        yield from same("other numbers", len(true) > 1, True)
        return
    stated = [(int(led), int(of)) for led, of in re.findall(r"(\d+) of (\d+)", said["counts"] or "")]
    true = [table[name] for name in winners if name in table]
    yield from same("leads", stated, true if len(set(true)) > 1 else true[:1])
    yield from same("most", {led for led, _ in stated}, {max(led for led, _ in table.values())})
    yield from same("limited", bool(said["limit"]), any(of < counted for _, of in stated))


def _undecided(facts: Facts) -> list[str]:
    """Return the methods that would lead as often as the winners if they were tied where too few runs decide.

    Without those that the signed-rank tests find worse, even without adjustment.
    """
    answer, table = facts.content["answer"], standings(facts)
    shared = [one for one in answer["counted"] if set(leaders(facts, one)) & set(answer["winners"])]
    found = []
    for name, (led, _) in table.items():
        where = [one for one in shared if not facts.by_maps(one) and facts.standing(one, name) == "undecided"]
        most = max(own for own, _ in table.values())
        if where and led + len(where) >= most and name not in answer["winners"]:
            found += [] if set(facts.better(name)) & set(answer["winners"]) else [name]
    return found


@kind(
    IN_ANSWER,
    rf"No method is ahead: (?P<names>[^:]+?) (?:is best or tied on {COUNTS}|leads on (?P<where>.+?)), "
    r"but (?P<rivals>.+?) (?:(?P<tested>has|have) smaller errors in paired tests|"
    r"leads? more often where (?:both count|they count too))\.",
)
def not_recommended(facts: Facts, names: str, rivals: str, where: str | None, **said: str | None) -> Iterator[str]:
    """The paired tests find every method named better; their adjustment may leave out others."""
    winners, true = list_of(names), facts.content["answer"]["rivals"]
    if where:
        yield from same("counted", facts.content["answer"]["counted"], [where])
    else:
        yield from _led(facts, winners, said)
    yield from same("rivals", [f"{len(true)} methods"] if len(true) > 2 else true, list_of(rivals))
    better = {one for winner in winners for one in (facts.better if said["tested"] else partial(_ahead, facts))(winner)}
    yield from same("not better", [one for one in true if one not in better], [])


def _ahead(facts: Facts, winner: str) -> list[str]:
    """Return the methods that lead more often than another one where both count."""
    found = []
    for name in facts.methods:
        both = [
            one for one in facts.content["answer"]["counted"] if all(takes_part(facts, one, m) for m in (winner, name))
        ]
        own, its = (sum(method in leaders(facts, one) for one in both) for method in (winner, name))
        found += [name] if its > own else []
    return found


@kind(
    IN_ANSWER,
    rf"(?P<names>[^:]+?) (?:each )?leads? on (?:{COUNTS}|(?P<where>.+?))(?P<fit> by the fit to the known map)?, "
    r"but (?:is|are) not told apart from (?P<others>.+?) by these runs\.",
)
def not_told_apart(facts: Facts, names: str, others: str, where: str | None, **said: str | None) -> Iterator[str]:
    winners, answer = list_of(names), facts.content["answer"]
    yield from same("rivals", answer["rivals"], [])
    true = answer["undecided"]
    yield from same("not told apart", list_of(others), [f"{len(true)} methods"] if len(true) > 3 else true)
    yield from same("may lead as often", [one for one in _undecided(facts) if one not in true], [])
    if where:
        yield from same("counted", answer["counted"], [where])
        yield from same("winners", set(winners), set(leaders(facts, where)))
        yield from same("by the fit", bool(said["fit"]), facts.by_fit(where))
    else:
        yield from _led(facts, winners, said)


@kind(IN_ANSWER, r"Only (?P<where>.+?) counts? for all methods: (?P<listed>.+?)\.(?= [A-Za-z]|$)")
def all_count_only(facts: Facts, where: str, listed: str) -> Iterator[str]:
    over = facts.content["answer"]["counted"]
    part = {one: {name for name in facts.methods if takes_part(facts, one, name)} for one in over}
    every = set().union(*part.values())
    yield from same("all methods count", list_of(where), [one for one in over if part[one] == every])
    for names, how, place in re.findall(
        r"(?:^|, )(.+?) (?:is|are) (best or tied|best) (?:there|on (.+?)(?=,|$))", listed
    ):
        one = place or where
        true = list(leaders(facts, one))
        yield from same(f"lead on {one}", [f"{len(true)} methods"] if len(true) > 3 else true, list_of(names))
        yield from same(f"best on {one}", how == "best", facts.outcome(one) == "winner")


@kind(IN_ANSWER, r"(?:Its settings|Settings of (?P<name>.+?)) were chosen on (?P<where>[^.]+?)\.(?= [A-Z0-9]|$)")
def chosen_there(facts: Facts, name: str | None, where: str) -> Iterator[str]:
    chosen, _ = _not_counted(facts, name)
    yield from same("settings chosen", list_of(where), chosen)


@kind(IN_ANSWER, r"(?P<name>.+?) did not run on (?P<where>[^.]+?)\.(?= [A-Z0-9]|$)")
def did_not_run(facts: Facts, name: str, where: str) -> Iterator[str]:
    _, absent = _not_counted(facts, None if name == "It" else name)
    yield from same("did not run", list_of(where), absent)


def _not_counted(facts: Facts, name: str | None) -> tuple[list[str], list[str]]:
    """Return the data sets that do not count for a method (None: the winner): settings chosen there, the others."""
    answer = facts.content["answer"]
    method = name or answer["winners"][0]
    without = [one for one in answer["counted"] if not takes_part(facts, one, method)]
    there = [one for one in without if method in facts.runs[one]]
    chosen = [one for one in there if facts.find(one, facts.deciding(one) or "")[method].tuned]
    absent = [one for one in without if one not in chosen]
    return _name_few(chosen), _name_few(absent)


def _name_few(sequences: list[str]) -> list[str]:
    return sequences if len(sequences) <= 3 else [f"{len(sequences)} data sets"]


@kind(IN_ANSWER, r"Where both count: (?P<own>\d+) of (?P<of>\d+) against (?P<its>\d+) of (?P<also>\d+)\.")
def where_both_count(facts: Facts, own: str, of: str, its: str, also: str) -> Iterator[str]:
    answer = facts.content["answer"]
    winner = answer["winners"][0]
    other = next(one["method"] for one in answer["standings"] if one["counted"] and one["method"] != winner)
    both = [one for one in answer["counted"] if all(takes_part(facts, one, name) for name in (winner, other))]
    yield from same("both count", (int(of), int(also)), (len(both), len(both)))
    led = [sum(method in leaders(facts, one) for one in both) for method in (winner, other)]
    yield from same("led", [int(own), int(its)], led)


@kind(
    IN_ANSWER,
    r"Take (?P<names>.+?): (?P<how>tied for the best|best|ahead|the best map) o[nf] (?P<where>.+?)"
    r"(?P<fit> by the fit to the known map)?"
    r"(?:, which has .+?)?\.",
)
def take_one(facts: Facts, names: str, how: str, where: str, fit: str | None) -> Iterator[str]:
    yield from same("by the fit", bool(fit), facts.by_fit(where))
    yield from same("may lead", _undecided(facts), [])
    undecided = len(facts.led(where)[0]) > len(facts.led(where)[1])
    yield from same("ahead", how == "ahead", undecided and len(facts.led(where)[1]) == 1)
    yield from same("counted", facts.content["answer"]["counted"], [where])
    yield from same("winners", set(names.split(" or ")), set(leaders(facts, where)))
    yield from same("by maps", how == "the best map", facts.by_maps(where))
    yield from same("tied", how == "tied for the best", len(names.split(" or ")) > 1 and not facts.by_maps(where))


@kind(
    IN_ANSWER,
    r"No method is ahead: (?:all )?(?P<count>\d+) methods are (?:each )?(?:tied|best or tied) on "
    r"(?:(?P<led>\d+)(?: of (?P<of>\d+))? data sets?|(?P<where>.+?))(?: by the fit to the known map)?\.$",
)
def all_tied(facts: Facts, count: str, led: str | None, of: str | None, where: str | None) -> Iterator[str]:
    own, most = facts.content["answer"]["counted"], max(one for one, _ in standings(facts).values())
    bases = {part for one, part in standings(facts).values() if one == most}
    yield from same("methods", int(count), sum(one == most for one, _ in standings(facts).values()))
    yield from same("leads", int(led or 1), most)
    yield from same("of", int(of or len(own)) if of or where else 0, len(own) if bases == {len(own)} or where else 0)
    yield from same("data set", [where] if where else own, own)
    yield from no_answer(facts)


CAUSES = {
    "tuned": r"settings of (.+?) were chosen on these data",
    "lost": r"(.+?) lost the track",
    "guessed": r"(.+?) registered too few scans",
    "unfinished": r"(.+?) did not complete every run with a value",
    "absent": r"(.+?) did not run",
}
BARE = r"the geometry of (.+?) does not determine the pose"


@kind(
    IN_ANSWER,
    r"(?:Only (?P<only>.+?) is|No method is) ranked: "
    r"(?P<why>(?:settings of |the geometry of |[^:.]+? (?:lost|registered|did not)).+?)\.$",
)
def not_ranked(facts: Facts, why: str, only: str | None) -> Iterator[str]:
    """Each method that is not ranked is named once, by a cause that holds for it somewhere."""
    yield from no_answer(facts)
    bare = [one for one in facts.runs if facts.content["sequences"][one]["degenerate"]]
    metrics = {one: metric for one in facts.runs if one not in bare and (metric := facts.deciding(one)) is not None}
    ranked = {one for where, metric in metrics.items() for one in facts.ranked(where, metric)}
    yield from same("ranked", ranked, {only} if only else set())
    left = {
        (name, cause)
        for where, metric in metrics.items()
        for name, one in facts.find(where, metric).items()
        if name not in ranked
        for cause, holds in (
            ("tuned", one.tuned), ("lost", one.lost_s is not None), ("guessed", one.guessed > 50.0),
            ("unfinished", not one.complete == one.expected == len(one.values)),
            ("absent", all(run["status"] in NOT_EXECUTED for run in facts.runs[where][name])),
        )
        if holds
    }  # fmt: skip
    named = 0
    for clause in why.split("; "):
        if match := re.fullmatch(BARE, clause):
            yield from same("degenerate", list_of(match[1]), bare)
            continue
        cause, match = next((c, m) for c, pattern in CAUSES.items() if (m := re.fullmatch(pattern, clause)))
        if count := re.fullmatch(r"(\d+) methods", match[1]):
            named += int(count[1])
            yield from same(cause, int(count[1]) <= sum(its == cause for _, its in left), True)
            continue
        names = list_of(match[1])
        named += len(names)
        yield from same(cause, [one for one in names if (one, cause) not in left], [])
    yield from same("methods that are not ranked", named, len({name for name, _ in left}))


@kind(
    IN_ANSWER,
    r"(?:No run finished|No method held the track|Only .+? is ranked|No method is (?:ranked|ahead)): .+?\.(?= |$)",
)
def no_answer(facts: Facts) -> Iterator[str]:
    yield from same("winners", facts.content["answer"]["winners"], [])


def _cost(facts: Facts, method: str) -> float:
    counted = facts.content["answer"]["counted"] or facts.runs
    found = [facts.find(where, "cpu_median_ms").get(method) for where in counted]
    return median([one.median for one in found if one is not None and one.values] or [math.inf])


@kind(IN_ANSWER, rf"(?P<ms>{NUMBER} ms) a scan here\.")
def costs(facts: Facts, ms: str) -> Iterator[str]:
    yield from check_amount("cost", ms, _cost(facts, facts.content["answer"]["winners"][0]))


@kind(IN_ANSWER, rf"A scan takes (?P<listed>.+?){END}")
def cost_of_each(facts: Facts, listed: str) -> Iterator[str]:
    for ms, name in re.findall(rf"({NUMBER} ms) with (.+?)(?=, [\d.]+ ms| and [\d.]+ ms|$)", listed):
        yield from check_amount(name, ms, _cost(facts, name))


@kind(IN_ANSWER, rf"(?:Wrong by map fit: )?(?P<best>{AMOUNT}) against (?P<its>{AMOUNT}) of (?P<other>.+?){END}")
def against(facts: Facts, best: str, its: str, other: str) -> Iterator[str]:
    (where,) = facts.content["answer"]["counted"]
    metric = facts.deciding(where) or ""
    found, ranked = facts.find(where, metric), facts.ranked(where, metric)
    yield from same("second", other, ranked[1])
    yield from check_amount("best", best, found[ranked[0]].median)
    yield from check_amount("second", its, found[other].median)


@kind(IN_ANSWER, rf"It loses (?P<words>.+?\)){END}")
def losses(facts: Facts, words: str) -> Iterator[str]:
    winner = facts.content["answer"]["winners"][0]
    true = [
        one for one in facts.content["answer"]["counted"]
        if winner in facts.ranked(one, facts.deciding(one) or "") and winner not in leaders(facts, one)
    ]  # fmt: skip
    named = re.findall(rf"(?:^|only | and |, most of all )([^ ]+) \(({AMOUNT}) against ({AMOUNT})\)", words)
    count = re.match(r"(\d+), most of all", words)
    yield from same("losses", int(count[1]) if count else len(named), len(true))
    for where, own, best in named:
        metric = facts.deciding(where) or ""
        yield from same("lost", where in true and facts.standing(where, winner) == "worse", True)
        yield from check_amount(where, own, facts.find(where, metric)[winner].median)
        yield from check_amount(where, best, facts.find(where, metric)[facts.ranked(where, metric)[0]].median)


@kind(IN_ANSWER, r"(?P<method>.+?) lost the track on (?P<listed>.+?)\.(?= [A-Z]|$)")
def winner_lost(facts: Facts, method: str, listed: str) -> Iterator[str]:
    name = facts.content["answer"]["winners"][0] if method == "It" else method
    true = []
    for where in facts.runs:
        metric = facts.deciding(where)
        if metric is None or facts.content["sequences"][where]["degenerate"] or name not in facts.runs[where]:
            continue
        one = facts.find(where, metric)[name]
        if one.lost_s is not None:
            true.append(f"{where} ({one.lost_runs} of {one.expected} runs)" if one.expected > 1 else where)
    yield from same(f"{name} lost", list_of(listed), true)


@kind(IN_ANSWER, r"It is also the cheapest matcher\.")
@kind(IN_ANSWER, r"Cheapest of them: (?P<name>.+?)\.$")
@kind(
    IN_ANSWER,
    rf"Cheapest matcher: (?P<name>[^.,]+?)(?:, (?P<ms>{NUMBER} ms)|, (?P<cpu>{NUMBER}) times the time)?"
    rf"(?:, (?P<times>{NUMBER}) times the [a-z ]+?)?(?: on (?P<shared>\d+) of (?P<of>\d+))?\.$",
)
def cheapest(
    facts: Facts,
    name: str = "",
    ms: str = "",
    cpu: str | None = None,
    times: str | None = None,
    shared: str | None = None,
    of: str | None = None,
) -> Iterator[str]:
    answer = facts.content["answer"]
    others = [one for one in facts.methods if one not in facts.with_role("baseline")]
    considered = answer["winners"] if len(answer["winners"]) > 1 else others
    timed = {one: facts.relative(answer["counted"], one, answer["compared_with"])[1] for one in considered}
    timed = {one: spent for one, spent in timed.items() if spent is not None}
    yield from same("cheapest", name or answer["winners"][0], min(timed, key=lambda one: timed[one]))
    error, spent, both = facts.relative(answer["counted"], name or answer["winners"][0], answer["winners"][0])
    counted = len(answer["counted"])
    if ms:
        yield from check_amount("cost", ms, _cost(facts, name))
    if cpu:
        yield from check_amount("times the time", cpu, spent or math.inf)
    if times:
        yield from check_amount("times the error", times, error or math.inf)
    if cpu or times:
        yield from same("both count", [int(shared or counted), int(of or counted)], [both, counted])


@kind(IN_PILLS, r"(?P<where>[^:]+): (?P<text>(?:problem|warning): .+)$")
def doubt_pill(facts: Facts, where: str, text: str) -> Iterator[str]:
    yield from same("doubt", text in facts.content["sequences"][where]["warnings"], True)


@kind(IN_PILLS, r"(?:(?P<where>.+): )?in a known map, (?:which all methods use|where (?P<names>.+?) only starts?)$")
def known_map_pill(facts: Facts, names: str | None = None, where: str | None = None) -> Iterator[str]:
    in_map = {run["sequence"] for run in facts.content["runs"] if run["map_start"]}
    yield from same("in a known map", set(list_of(where) if where else facts.content["sequences"]), in_map)
    only = [one for one in facts.methods if facts.content["methods"][one]["map_use"] == "starts there"]
    count = re.fullmatch(r"(\d+) methods", names or "")
    stated = int(count[1]) if count else list_of(names) if names else []
    yield from same("only start in the map", stated, len(only) if count else only)


@kind(IN_PILLS, r"(?P<where>.+?) is degenerate: (?P<how>not counted|no method beats .+)$")
def degenerate_pill(facts: Facts, where: str, how: str) -> Iterator[str]:
    yield from same("outcome", facts.outcome(where), "degenerate")
    if how.startswith("no method beats"):
        metric, base = facts.deciding(where) or "", how.removeprefix("no method beats ")
        found, sign = facts.find(where, metric), 1.0 if facts.metrics[metric]["better"] == "lower" else -1.0
        better = [one for one in found.values() if one.values and sign * one.median < sign * found[base].median]
        yield from same("beats", better, [])


def _lost(facts: Facts) -> dict[str, dict[str, str]]:
    table: dict[str, dict[str, str]] = {}
    for where in facts.runs:
        metric = facts.deciding(where)
        if metric is None or facts.content["sequences"][where]["degenerate"]:
            continue
        for method, one in facts.find(where, metric).items():
            if one.lost_s is not None:
                table.setdefault(method, {})[where] = facts.losses(one)
    return table


@kind(
    IN_PILLS,
    r"(?P<count>\d+) methods (?P<what>lost the track|did not finish)(?: on)?(?: a sequence| outside (?P<other>[^:]+))"
    r"(?:: (?P<listed>.+))?$",
)
@kind(IN_PILLS, r"(?P<method>.+?) (?P<what>lost the track|did not finish)(?: on)? (?P<where>.+)$")
def lost_pill(
    facts: Facts, what: str, count: str = "", other: str = "", listed: str = "", method: str = "", where: str = ""
) -> Iterator[str]:
    table = _lost(facts) if what.startswith("lost") else {}
    for run in facts.content["runs"] if not what.startswith("lost") else ():
        if run["status"] in BROKEN:
            table.setdefault(run["method"], {})[run["sequence"]] = ""
    if count:
        yield from same(what, int(count), len(table))
        flat = [one for one, card in facts.content["sequences"].items() if card["degenerate"]] if "lost" in what else []
        lost_there = [one for one in flat if any(run["lost_at_s"] is not None for run in runs_of(facts, [one]))]
        yield from same("other than", list_of(other) if other else [], lost_there)
    for name in filter(None, (method, *(listed or "").split(", "))):
        yield from same(f"{name} {what}", name in table, True)
    for name, words in re.findall(rf"(?:^|, | and )(\S+) \(({LOSS})\)", where):
        yield from same(f"{method} on {name}", words, table[method].get(name))
    if what.startswith("did") and where and not re.fullmatch(r"\d+ sequences", where):
        yield from same(f"{method} on", set(re.findall(r"(?:^|, | and )(.+?) \(", where)), set(table[method]))
    if match := re.fullmatch(r"(\d+) sequences", where):
        yield from same("sequences", int(match[1]), len(table[method]))


DISTURBANCES = {
    "other_percent": (rf"other programs: (?:up to )?({NUMBER}) % of the core", 5.0),
    "steal_percent": (rf"the hypervisor: (?:up to )?({NUMBER}) % of the core", 2.0),
    "waited_percent": (rf"waiting: (?:up to )?({NUMBER}) % of the time", 5.0),
}
"""How a pill states each cause, and the limit beyond which it is one."""


@kind(
    IN_PILLS,
    r"busy machine: (?P<count>\d+) of (?P<all>\d+) runs disturbed, (?P<by>\d+) by (?P<cause>.+)$",
)
def busy(facts: Facts, count: str, cause: str, **said: str) -> Iterator[str]:
    never = ("not-installed", "data-missing", "interrupted", "skipped")
    executed = [run for run in facts.content["runs"] if run["status"] not in never]
    known = [run["conditions"] for run in executed if run["conditions"] is not None]
    disturbed = [one for one in known if one["disturbed"]]
    yield from same("runs", int(said["all"]), len(known))
    yield from same("disturbed", int(count), len(disturbed))
    taken = {
        name: [
            one[name] or 0.0
            for one in disturbed
            if (one[name] or 0.0) > limit and (name != "waited_percent" or (one["busy_threads"] or 1) == 1)
        ]
        for name, (_, limit) in DISTURBANCES.items()
    }
    named = {name: found for name, (pattern, _) in DISTURBANCES.items() if (found := re.fullmatch(pattern, cause))}
    yield from same("causes", len(named), 1)
    for name, found in named.items():
        yield from same("runs of the cause", int(said["by"]), len(taken[name]))
        yield from same("cause of most runs", len(taken[name]), max(map(len, taken.values())))
        yield from same("up to", "up to" in cause, len(taken[name]) > 1)
        yield from check_amount(name, found[1], max(taken[name], default=0.0))


def _tuned_on(facts: Facts, method: str) -> list[str]:
    """Return the sequences whose data set a method was tuned on; one for a data set that one has the name of."""
    chosen = facts.content["methods"][method]["tuned_on"]
    data = {one: next(iter(own.values()))[0]["dataset"] for one, own in facts.runs.items()}
    return [one for one, name in data.items() if name in chosen and (one == name or name not in data)]


@kind(IN_PILLS, r"only simulated data count(?: for (?P<methods>.+))?$")
def simulated_pill(facts: Facts, methods: str | None) -> Iterator[str]:
    answer = facts.content["answer"]
    recorded = [one for one in answer["counted"] if not facts.content["sequences"][one]["simulated"]]
    yield from same("no recording counts", methods is None, not recorded)
    if methods is not None:
        left_out = {one["method"]: one["left_out"] for one in answer["standings"]}
        without = [one for one in answer["winners"] if not set(recorded) - set(left_out[one])]
        yield from same("no recording counts for", list_of(methods), without)


@kind(IN_PILLS, r"settings of (?P<count>\d+) methods chosen on data shown here: not counted there$")
def many_tuned_pill(facts: Facts, count: str) -> Iterator[str]:
    chosen = [_tuned_on(facts, method) for method in facts.methods if _tuned_on(facts, method)]
    yield from same("tuned", int(count), len(chosen))
    yield from same("more than two groups", len({tuple(one) for one in chosen}) > 2, True)


@kind(IN_PILLS, r"settings of (?P<methods>.+?) chosen on (?P<where>.+?): not counted there$")
def tuned_pill(facts: Facts, methods: str, where: str) -> Iterator[str]:
    true = [one for one in facts.methods if _tuned_on(facts, one) == list_of(where)]
    count = re.fullmatch(r"(\d+) methods", methods)
    yield from same("tuned", int(count[1]) if count else list_of(methods), len(true) if count else true)


@kind(IN_PILLS, r"not counted: (?P<where>.+)$")
def not_counted_pill(facts: Facts, where: str) -> Iterator[str]:
    named = []
    for part in where.split("; "):
        own = list_of(part.removesuffix(" (all tied)").removesuffix(" (not told apart)"))
        named += own
        if part.endswith(" (all tied)"):
            yield from same("all tied", [one for one in own if not facts.all_tied(one)], [])
        known = [one for one in own if one in facts.runs]
        truth = [one for one in known if not facts.by_maps(one) and not facts.by_fit(one)]
        apart = [one for one in truth if facts.outcome(one) == "tied" and not facts.all_tied(one)]
        yield from same("not told apart", own if part.endswith(" (not told apart)") else [], apart)
    for one in named:
        without = one in facts.runs and one not in facts.content["answer"]["counted"]
        yield from same(f"{one} not counted", without, True)


@kind(IN_PILLS, r"missing here: (?P<listed>.+)$")
def missing_pill(facts: Facts, listed: str) -> Iterator[str]:
    for name in list_of(listed):
        runs = [run for run in facts.content["runs"] if name in (run["sequence"], run["method"])]
        absent = bool(runs) and {run["status"] for run in runs} <= {"data-missing", "not-installed"}
        yield from same(name, absent, True)


@kind(IN_PILLS, r"(?:(?P<done>\d+) of )?(?P<all>\d+) runs?$")
def runs_pill(facts: Facts, done: str | None, **said: str) -> Iterator[str]:
    runs = facts.content["runs"]
    yield from same("runs", int(said["all"]), len(runs))
    yield from same("finished", int(done or said["all"]), sum(run["status"] == "complete" for run in runs))
