"""The kinds of sentences of a report, each with the check of its names and numbers."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from amounts import AMOUNT, check_amount, check_difference, check_gap, check_median, list_of
from facts import MEASURES, Facts

NOT_STARTED = ("not-installed", "data-missing", "skipped")
NOT_EXECUTED = (*NOT_STARTED, "interrupted")
BROKEN = ("failed", "crashed", "timeout", "out-of-memory")
WORDS = {"timeout": "timed out", "skipped": "not run yet"}
UP_TO = rf"(?: \(interval up to (?P<up_to>{AMOUNT})\))?"
SPREAD = r"[^()]*(?:\([^()]*\))?"
"""A median with its interval, unread."""
LOSS = r"(?:in \d+ of \d+, (?:first )?)?at \d+ s(?:, found at \d+ s|, \d+ found again)?"
"""When the track was lost."""
MEDIAN_TEXT = rf"{AMOUNT}(?: \([^()]*\))?"

Check = Callable[..., Iterator[str]]
IN_VERDICTS: list[tuple[str, Check]] = []
IN_OVERVIEW: list[tuple[str, Check]] = []


def kind(table: list[tuple[str, Check]], pattern: str) -> Callable[[Check], Check]:
    """Register the check of the sentences that match a pattern."""

    def register(check: Check) -> Check:
        table.append((pattern, check))
        return check

    return register


def check_sentences(
    facts: Facts, table: Sequence[tuple[str, Check]], text: str, *where: str, seen: set[str] | None = None
) -> Iterator[str]:
    """Check each sentence of a text from its beginning; a sentence of no known kind is a fault."""
    rest = text.replace("\u00a0", " ").replace("\u2212", "-").strip()
    while rest:
        for pattern, check in table:
            if match := re.match(facts.fill(pattern), rest):
                if seen is not None:
                    seen.add(check.__name__)
                yield from (f"{fault} [{match[0]}]" for fault in check(facts, *where, **match.groupdict()))
                rest = rest[match.end() :].strip()
                break
        else:
            yield f"{', '.join(where)}: no known kind of sentence: {rest}"
            return


def same(what: str, stated: object, true: object) -> Iterator[str]:
    """Yield a fault unless both are equal."""
    if stated != true:
        yield f"{what}: stated {stated}, true {true}"


def runs_of(facts: Facts, where: Sequence[str]) -> list[Mapping[str, Any]]:
    """Return the runs of a sequence, or all."""
    return [run for run in facts.content["runs"] if not where or run["sequence"] == where[0]]


@kind(IN_VERDICTS, r"(?P<done>\d+) of (?P<all>\d+) runs? finished\.")
@kind(IN_OVERVIEW, r"(?P<done>\d+) of (?P<all>\d+) runs? finished\.")
def runs_finished(facts: Facts, *where: str, **said: str) -> Iterator[str]:
    runs = runs_of(facts, where)
    yield from same("runs", int(said["all"]), len(runs))
    yield from same("finished", int(said["done"]), sum(run["status"] == "complete" for run in runs))


def _statuses(facts: Facts, where: Sequence[str], listed: str, wanted: Sequence[str]) -> Iterator[str]:
    runs = runs_of(facts, where)
    absent = {run["sequence"] for run in runs} - {r["sequence"] for r in runs if r["status"] != "data-missing"}
    for name in re.findall(r"all runs on (.+?) \(data missing\)", listed):
        yield from same(f"{name} is missing", name in absent, True)
        absent.discard(name)
        runs = [run for run in runs if run["sequence"] != name]
        listed = re.sub(rf"(?:, | and )?all runs on {re.escape(name)} \(data missing\)(?:, | and )?", "", listed)
    true: dict[str, Counter[str]] = {}
    for run in runs:
        if run["status"] in wanted:
            words = WORDS.get(run["status"], run["status"].replace("-", " "))
            true.setdefault(run["method"], Counter())[words] += 1
    every = Counter(run["method"] for run in runs)
    each = list(re.finditer(facts.fill(r"(?P<method>.+?) \((?P<counts>\d+ of \d+ [^()]+)\)"), listed))
    stated = {one["method"]: dict(re.findall(r"(\d+) of \d+ ([^,]+)", one["counts"])) for one in each}
    counted = {method: {str(count): words for words, count in own.items()} for method, own in true.items()}
    yield from same("statuses", stated, counted)
    for one in each:
        for count in re.findall(r"\d+ of (\d+) ", one["counts"]):
            yield from same(f"runs of {one['method']}", int(count), every[one["method"]])


@kind(IN_VERDICTS, r"Did not finish: (?P<listed>.+?)\.(?= [A-Z]|$)")
@kind(IN_OVERVIEW, r"Did not finish: (?P<listed>.+?)\.(?= [A-Z]|$)")
def did_not_finish(facts: Facts, *where: str, listed: str) -> Iterator[str]:
    yield from _statuses(facts, where, listed, BROKEN)


@kind(IN_VERDICTS, r"Could not start: (?P<listed>.+?)\.(?= [A-Z]|$)")
@kind(IN_OVERVIEW, r"Could not start: (?P<listed>.+?)\.(?= [A-Z]|$)")
def could_not_start(facts: Facts, *where: str, listed: str) -> Iterator[str]:
    yield from _statuses(facts, where, listed, NOT_STARTED)


@kind(IN_VERDICTS, r"Left out: (?P<listed>.+?)\.(?= [A-Z]|$)")
@kind(IN_OVERVIEW, r"Left out: (?P<listed>.+?)\.(?= [A-Z]|$)")
def left_out(facts: Facts, *where: str, listed: str) -> Iterator[str]:
    yield from _statuses(facts, where, listed, ("interrupted",))


@kind(IN_VERDICTS, r"The data are damaged: (?P<listed>.+?)\.(?= [A-Z]|$)")
def damaged(facts: Facts, where: str, listed: str) -> Iterator[str]:
    for count, name, percent in re.findall(r"([\d,]+) ([^()]+?) \((\d+) % of the scans\)", listed):
        runs = runs_of(facts, [where])
        share = max(100.0 * run["notes"].get(name, 0) / max(run["scans_expected"], 1) for run in runs)
        yield from check_amount(name, percent, share)
        counts = {run["notes"].get(name, 0) for run in runs}
        yield from same(f"{name}: count", int(count.replace(",", "")) in counts and share > 1.0, True)


@kind(IN_VERDICTS, r"Degenerate geometry: .+\. The order below is not a ranking\.")
def is_degenerate(facts: Facts, where: str) -> Iterator[str]:
    yield from same("degenerate", bool(facts.content["sequences"][where]["degenerate"]), True)


@kind(IN_VERDICTS, r"No headline metric has a value here, so there is no ranking\.")
def no_headline(facts: Facts, where: str) -> Iterator[str]:
    yield from same("deciding metric", None, facts.deciding(where))


def _deciding(facts: Facts, where: str, label: str) -> Iterator[str]:
    metric = facts.deciding(where)
    yield from same("deciding metric", label, facts.metrics[metric]["label"] if metric else None)


@kind(
    IN_VERDICTS,
    rf"(?P<winner>.+?) (?P<verb>wins|is ahead) on (?P<label>.+?): (?P<best>{SPREAD}); the runner-up, (?P<second>.+?), "
    rf"has (?P<its>{SPREAD}), (?P<gap>[^;.]*(?:\.\d[^;.]*)*)(?:; over (?P<runs>\d+) pairs of runs, the difference is "
    r"(?P<apart>[^()]*?(?: \([^()]*\))?))?\.(?= The other|$)",
)
def is_won(facts: Facts, where: str, **said: str) -> Iterator[str]:
    metric = facts.deciding(where) or ""
    ranked, found = facts.ranked(where, metric), facts.find(where, metric)
    yield from same("outcome", "winner", facts.outcome(where))
    yield from same("order", [said["winner"], said["second"]], ranked[:2])
    yield from same("verb", said["verb"], "is ahead" if facts.by_maps(where) or facts.by_fit(where) else "wins")
    yield from _deciding(facts, where, said["label"])
    yield from check_median(facts, where, metric, said["winner"], said["best"])
    yield from check_median(facts, where, metric, said["second"], said["its"])
    values = found[said["second"]].median, found[said["winner"]].median
    yield from check_gap(where, facts.metrics[metric], said["gap"], *values)
    if said["apart"]:
        pair = said["second"], said["winner"]
        yield from check_difference(facts, where, metric, *pair, said["apart"], said["runs"])


@kind(IN_VERDICTS, r"The other map metrics agree\.")
def maps_agree(facts: Facts, where: str) -> Iterator[str]:
    first = facts.ranked(where, facts.deciding(where) or "")[0]
    yield from same("first of the maps agrees or all are tied", bool(facts.agreed(where)), True)
    if facts.outcome(where) == "winner":
        yield from same("the winner is among those that agree", first in facts.agreed(where), True)


@kind(
    IN_VERDICTS,
    rf"On (?P<label>.+?), (?P<one>.+?) \((?P<first>{SPREAD})\) and (?P<other>.+?) \((?P<second>{SPREAD})\) "
    r"(?P<how>are tied|are not told apart by these runs): (?P<why>.+?)\.(?= [A-Z]|$)",
)
def is_tied(facts: Facts, where: str, **said: str) -> Iterator[str]:
    metric = facts.deciding(where) or ""
    tied, near = facts.led(where)
    yield from same("outcome", "tied", facts.outcome(where))
    yield from same("order", [said["one"], said["other"]], tied[:2])
    yield from same("how", said["how"] == "are tied", said["other"] in near)
    yield from _deciding(facts, where, said["label"])
    yield from check_median(facts, where, metric, said["one"], said["first"])
    yield from check_median(facts, where, metric, said["other"], said["second"])
    yield from _check_tie(facts, where, metric, said["one"], said["other"], said["why"])


def _check_tie(facts: Facts, where: str, metric: str, one: str, other: str, why: str) -> Iterator[str]:
    apart, sign = (
        facts.difference(where, metric, other, one),
        -1.0 if facts.metrics[metric]["better"] == "higher" else 1,
    )
    better = facts.find(where, metric)[one].median
    size = abs(apart[0]) if apart else 0.0
    floor = facts.floor(where, metric, one, other)
    exact = rf"they differ by less than the accuracy of the ground truth \(({AMOUNT}) over (\d+) relations\)"
    if match := re.fullmatch(exact, why):
        yield from check_amount("accuracy of the truth", match[1], floor)
        yield from same("relations", int(match[2]), facts.relations(where, metric, one, other))
        yield from same("below the accuracy", size < floor, True)
    elif match := re.fullmatch(rf"they are at most (.+?){UP_TO} apart, which does not matter here", why):
        yield from same("margin", match[1], _name_margin(facts, metric, better))
        yield from _check_up_to(facts, where, metric, one, [other], match["up_to"])
        yield from same("within the margin", size <= facts.margin(metric, better) and size >= floor, True)
    elif why == "they are equal to every printed digit":
        yield from same("equal", size < 10.0 ** -facts.metrics[metric]["digits"], True)
    elif match := re.fullmatch(r"they have (\d+) pairs of perturbed runs, and a verdict takes 6", why):
        few = apart is not None and int(match[1]) == apart[3] < 6 and facts.find(where, metric)[one].perturbed
        yield from same("few perturbed runs", few, True)
    elif match := re.fullmatch(rf"{re.escape(other)} has no second run in common with {re.escape(one)}", why):
        yield from same("common runs", apart, None)
    elif match := re.fullmatch(r"over (\d+) pairs of runs, .+? is worse by (.+?), which may be chance; (.+)", why):
        yield from check_difference(facts, where, metric, other, one, match[2], match[1])
        yield from same("may be chance", apart is not None and not (apart[1] > 0.0 or apart[2] < 0.0), True)
        yield from same("is worse", apart is not None and sign * apart[0] >= 0.0, True)
        doubled = match[3] == "these runs do not even detect a value twice as large"
        detects = doubled or match[3].startswith("these runs can detect a difference of")
        yield from same("too small to settle", detects, size < facts.margin(metric, better))
        if detects:
            yield from same("not even twice", doubled, not facts.detects_double(where, metric, other, one))
        if not detects:
            yield from same(
                "need", bool(re.match(r"(about \d+|more than 200) runs of each would settle", match[3])), True
            )
    elif match := re.fullmatch(r".+? is better by the medians, .+? over (\d+) pairs of runs, by (.+)", why):
        yield from same("pairs contradict the medians", apart is not None and sign * apart[0] < 0.0, True)
        yield from check_difference(facts, where, metric, other, one, match[2], match[1], turned=True)
    else:
        yield f"{where}: no known reason of a tie: {why}"


@kind(IN_VERDICTS, r"Also tied with the first: (?P<listed>.+?)\.(?= [A-Z]|$)")
def also_tied(facts: Facts, where: str, listed: str) -> Iterator[str]:
    tied, small = [one for one in facts.led(where)[1] if one not in facts.led(where)[0][:2]], _find_small(facts, where)
    yield from same("tied", list_of(listed), [one for one in tied if one not in small])


def _check_up_to(
    facts: Facts, where: str, metric: str, first: str, others: Sequence[str], up_to: str | None
) -> Iterator[str]:
    """Check the largest bound of the differences from the first, stated beyond the margin; two pairs have none."""
    apart = [facts.difference(where, metric, one, first) for one in others]
    bound = max((max(abs(one[1]), abs(one[2])) for one in apart if one and one[3] > 2), default=0.0)
    least = facts.margin(metric, facts.find(where, metric)[first].median)
    yield from same("interval", up_to is not None, bound > least)
    if up_to is not None:
        yield from check_amount("interval", up_to, bound)


def _name_margin(facts: Facts, metric: str, better: float) -> str:
    """Return the smallest difference that matters, in words."""
    least = facts.margin(metric, better)
    if least <= 0.05 * abs(better):
        return "5 %"
    if least == 10.0 ** -facts.metrics[metric]["digits"]:
        return f"{least:g} {facts.metrics[metric]['unit']}".strip()
    return "2 mm" if facts.metrics[metric]["unit"] == "m" else "1 percentage point"


def _find_small(facts: Facts, where: str) -> list[str]:
    """Return the methods after the second whose difference from the first is shown, and too small to matter."""
    metric = facts.deciding(where) or ""
    tied, near = facts.led(where)
    apart = {one: facts.difference(where, metric, one, tied[0]) for one in tied[2:] if one in near}
    sign = -1.0 if facts.metrics[metric]["better"] == "higher" else 1.0
    first = facts.find(where, metric)[tied[0]].median
    return [
        one
        for one, found in apart.items()
        if found is not None
        and facts.shows(where, metric, one, found)
        and facts.floor(where, metric, one, tied[0]) <= sign * found[0] < facts.margin(metric, first)
        and sign * (facts.find(where, metric)[one].median - first) > 0.0
    ]


@kind(
    IN_VERDICTS,
    rf"Worse by at most (?P<least>.+?){UP_TO}, which does not matter here: (?P<listed>.+?)\.(?= [A-Z]|$)",
)
def too_small(facts: Facts, where: str, least: str, up_to: str | None, listed: str) -> Iterator[str]:
    metric, first = facts.deciding(where) or "", facts.led(where)[0][0]
    yield from same("margin", least, _name_margin(facts, metric, facts.find(where, metric)[first].median))
    yield from _check_up_to(facts, where, metric, first, list_of(listed), up_to)
    yield from same("too small", list_of(listed), _find_small(facts, where))


@kind(IN_VERDICTS, r"Not clearly worse in any map metric: (?P<listed>.+?)\.(?= [A-Z]|$)")
def best_maps(facts: Facts, where: str, listed: str) -> Iterator[str]:
    yield from same("agreed", list_of(listed), facts.agreed(where))
    (leaders,) = (one["leaders"] for one in facts.content["verdicts"] if one["sequence"] == where)
    yield from same("leaders", list_of(listed), leaders)


@kind(IN_VERDICTS, r"Clearly worse in one of them: (?P<listed>.+?)\.(?= [A-Z]|$)")
def worse_maps(facts: Facts, where: str, listed: str) -> Iterator[str]:
    order = facts.ranked(where, facts.deciding(where) or "")
    last = max(order.index(one) for one in facts.agreed(where) if one in order)
    labels = {facts.metrics[name]["label"]: name for name in MEASURES if name in facts.metrics}
    said = dict(one.removesuffix(")").split(" (", 1) for one in list_of(listed))

    def is_worse(one: str, name: str) -> bool:
        return facts.is_worse(where, name, one, facts.ranked(where, name)[0])

    wanted = [one for one in order[:last] if any(is_worse(one, name) for name in labels.values())]
    yield from same("before the last of the best", list(said), wanted)
    yield from (
        f"{one} is not clearly worse in {label}" for one, label in said.items() if not is_worse(one, labels[label])
    )


@kind(IN_VERDICTS, r"Not told apart from the first: (?P<listed>.+?)\.(?= [A-Z]|$)")
def not_told_apart(facts: Facts, where: str, listed: str) -> Iterator[str]:
    tied, near = facts.led(where)
    yield from same("not told apart", list_of(listed), [one for one in tied[2:] if one not in near])


@kind(
    IN_VERDICTS,
    r"One run each gives an order and no verdict, which takes (?:3 or more|6 or more \(nuisance = 5\))\. "
    r"On (?P<label>.+?): (?P<listed>.+?)\.(?= [A-Z]|$)",
)
def one_run_each(facts: Facts, where: str, label: str, listed: str) -> Iterator[str]:
    metric = facts.deciding(where) or ""
    ranked = facts.ranked(where, metric)[:3]
    yield from same("outcome", "one run", facts.outcome(where))
    yield from _deciding(facts, where, label)
    named = r"(?:, | and |^)(?P<name>.+?) \((?P<value>[^()]*(?:\([^()]*\))?)\)"
    found = re.findall(named, listed)
    yield from same("order", [name for name, _ in found], ranked)
    for name, value in found:
        yield from check_median(facts, where, metric, name, value)


@kind(
    IN_VERDICTS,
    rf"Only (?P<one>.+?) has (?P<value>{MEDIAN_TEXT}) (?P<label>.+?) over every run: there is no "
    r"other ranked method to compare with\.",
)
def only_one(facts: Facts, where: str, one: str, value: str, label: str) -> Iterator[str]:
    yield from same("ranked", facts.ranked(where, facts.deciding(where) or ""), [one])
    yield from _deciding(facts, where, label)
    yield from check_median(facts, where, facts.deciding(where) or "", one, value)


@kind(IN_VERDICTS, r"No method is ranked on (?P<label>.+?), so there is no winner\.")
def none_ranked(facts: Facts, where: str, label: str) -> Iterator[str]:
    yield from _deciding(facts, where, label)
    yield from same("ranked", facts.ranked(where, facts.deciding(where) or ""), [])


@kind(
    IN_VERDICTS,
    rf"On (?P<label>.+?), (?P<one>.+?) has (?P<first>{SPREAD}); the last of the finished methods, (?P<last>.+?), "
    rf"has (?P<value>{SPREAD})\.",
)
def order_only(facts: Facts, where: str, **said: str) -> Iterator[str]:
    metric = facts.deciding(where) or ""
    ranked = facts.ranked(where, metric)
    yield from same("outcome", "degenerate", facts.outcome(where))
    yield from same("ends of the order", (said["one"], said["last"]), (ranked[0], ranked[-1]))
    yield from check_median(facts, where, metric, said["one"], said["first"])
    yield from check_median(facts, where, metric, said["last"], said["value"])


@kind(IN_VERDICTS, r"No method held the track\.")
def none_held(facts: Facts, where: str) -> Iterator[str]:
    yield from same("outcome", "lost", facts.outcome(where))


@kind(IN_VERDICTS, r"Without ground truth there is no leader: (?P<listed>.+?) has no value\.")
def no_leader(facts: Facts, where: str, listed: str) -> Iterator[str]:
    del listed
    yield from same("outcome", "disagreement", facts.outcome(where))


@kind(IN_VERDICTS, r"The map metrics disagree: (?P<listed>.+?)\.(?= [A-Z]|$)")
def maps_disagree(facts: Facts, where: str, listed: str) -> Iterator[str]:
    yield from same("agreed", facts.agreed(where), [])
    for name, words in MEASURES.items():
        found = facts.find(where, name)
        sign = 1.0 if facts.metrics[name]["better"] == "lower" else -1.0
        best = min((one for one in found if found[one].ranks), key=lambda one: sign * found[one].median)
        before = listed.partition(words)[0]
        yield from same(f"best in {name}", max(facts.methods, key=before.rfind), best)
