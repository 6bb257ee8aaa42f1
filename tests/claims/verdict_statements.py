"""The sentences of a verdict on the reference method, the baseline and the limits of the evidence."""

from __future__ import annotations

import re
from collections.abc import Iterator

from amounts import AMOUNT, NUMBER, check_amount, check_gap, list_of
from facts import Facts
from statements import IN_VERDICTS, LOSS, kind, same

END = r"\.(?= [A-Z]|$)"


@kind(IN_VERDICTS, rf"Doubt about the data: (?P<text>(?:problem|warning): .+?){END}")
def doubt(facts: Facts, where: str, text: str) -> Iterator[str]:
    yield from same("doubt", text in facts.content["sequences"][where]["warnings"], True)


@kind(IN_VERDICTS, rf"Methods that kept the initial guess: (?P<listed>.+?){END}")
def kept_guess(facts: Facts, where: str, listed: str) -> Iterator[str]:
    found = facts.find(where, "guess_kept_percent")
    for name, percent in re.findall(r"(?:^|, | and )(.+?) on (\d+) % of the scans", listed):
        yield from check_amount(name, percent, found[name].guessed)


@kind(IN_VERDICTS, rf"Not ranked, because of too few registrations: (?P<listed>.+?){END}")
def too_few_registrations(facts: Facts, where: str, listed: str) -> Iterator[str]:
    found = facts.find(where, "guess_kept_percent")
    yield from same("few registrations", list_of(listed), [one for one in found if found[one].guessed > 50.0])


@kind(IN_VERDICTS, rf"Not ranked, because settings were chosen on these data: (?P<listed>.+?){END}")
def settings_chosen(facts: Facts, where: str, listed: str) -> Iterator[str]:
    found = facts.find(where, facts.deciding(where) or "")
    yield from same("tuned", list_of(listed), [one for one in found if found[one].tuned and found[one].values])


@kind(IN_VERDICTS, r"Lost the track and not ranked: (?P<listed>.+?\))\.")
def lost(facts: Facts, where: str, listed: str) -> Iterator[str]:
    found = facts.find(where, facts.deciding(where) or "")
    stated = dict(re.findall(rf"(?:^|\), |\) and )(.+?) ({LOSS}) \(", listed))
    true = {one: facts.losses(found[one]) for one in found if found[one].lost_s is not None}
    reasons = {run["lost_reason"].rstrip(". ") for own in facts.runs[where].values() for run in own}
    named = re.findall(rf" {LOSS} \((.+?)\)(?=, | and |$)", listed)
    yield from same("reasons", [one for one in named if one not in reasons], [])
    yield from same("lost", stated, true)


@kind(IN_VERDICTS, r"(?P<percent>\d+) % of these relations span less than 10 s: they measure local motion, not drift\.")
def short_relations(facts: Facts, where: str, percent: str) -> Iterator[str]:
    name = facts.deciding(where) or ""
    yield from same("all relations decide", "_all_" in name, True)
    runs = [run["scores"] for own in facts.runs[where].values() for run in own if run["status"] == "complete"]
    short, every = (
        sum(one[key]["support"] for one in runs if key in one) for key in (name.replace("_all_", "_short_"), name)
    )
    yield from check_amount("short relations", percent, 100.0 * short / max(every, 1))
    yield from same("most", 2 * short > every, True)


@kind(IN_VERDICTS, rf"The reference method: (?P<clauses>.+?){END}")
def reference(facts: Facts, where: str, clauses: str) -> Iterator[str]:
    metric = facts.deciding(where) or ""
    ranked, found = facts.ranked(where, metric), facts.find(where, metric)
    first = ranked[0]
    forms = {
        r"(?P<m>.+?) is not ranked: .+": "not comparable lost",
        rf"(?P<m>.+?) has ({AMOUNT}), place (?P<place>\d+) of (?P<of>\d+) in this order": "not comparable",
        r"(?P<m>.+?) (?:wins|is ahead)": "best",
        rf"(?P<m>.+?) (?:loses|is behind), with (?P<own>{AMOUNT}) against (?P<best>{AMOUNT}): (?P<gap>.+)": "worse",
        r"(?P<m>.+?) has the best value, but not by a clear difference": "tied",
        r"(?P<m>.+?) is tied with the best, (?P<first>.+)": "tied",
        r"(?P<m>.+?) is not told apart from the best, (?P<first>.+)": "undecided",
    }
    for clause in clauses.split("; "):
        match, wanted = next(((m, w) for p, w in forms.items() if (m := re.fullmatch(p, clause))), (None, ""))
        if match is None:
            yield f"{where}: no known clause: {clause}"
            continue
        said = match.groupdict()
        yield from same(clause, facts.standing(where, said["m"]) in wanted.split(" ", 0)[0], True)
        if said.get("place"):
            place = ranked.index(said["m"]) + 1, len(ranked)
            yield from check_amount(clause, match[2], found[said["m"]].median)
            yield from same("place", (int(said["place"]), int(said["of"])), place)
        if said.get("first"):
            yield from same("first", said["first"], first)
        if said.get("gap"):
            values = found[said["m"]].median, found[first].median
            yield from check_amount(clause, said["own"], values[0])
            yield from check_amount(clause, said["best"], values[1])
            yield from check_gap(clause, facts.metrics[metric], said["gap"], *values)


@kind(IN_VERDICTS, r"(?P<base>.+?) has no value here, so there is no baseline to beat\.")
def no_baseline(facts: Facts, where: str, base: str) -> Iterator[str]:
    found = facts.find(where, facts.deciding(where) or "")
    yield from same("no value of the baseline", base not in found or not found[base].values, True)


@kind(IN_VERDICTS, rf"Worse map than (?P<base>.+?) alone, in every map metric: (?P<listed>.+?){END}")
@kind(IN_VERDICTS, rf"Worse than (?P<base>.+?) alone \((?P<value>{AMOUNT})\): (?P<listed>.+?){END}")
def worse_than_baseline(facts: Facts, where: str, base: str, listed: str, value: str = "") -> Iterator[str]:
    found = facts.find(where, facts.deciding(where) or "")
    named = re.sub(rf" \({AMOUNT}\)", "", listed)
    yield from same("worse than the baseline", set(list_of(named)), set(facts.behind(where, base)))
    for name, amount in re.findall(rf"(?:^|, | and )(.+?) \(({AMOUNT})\)", listed):
        yield from check_amount(name, amount, found[name].median)
    if value:
        yield from check_amount(base, value, found[base].median)


@kind(
    IN_VERDICTS,
    r"Without ground truth, (?P<label>.+?) decides: how well the scans fit the known map at the poses\. "
    r"Limitations: .+?\.(?= [A-Z]|$)",
)
def fit_decides(facts: Facts, where: str, label: str) -> Iterator[str]:
    yield from same("decided by the fit", facts.by_fit(where), True)
    yield from same("deciding metric", label, facts.metrics[facts.deciding(where) or ""]["label"])


@kind(
    IN_VERDICTS, r"Without ground truth, (?P<label>.+?) compares maps only\. Limitations: .+?\.(?= Over|$| The spread)"
)
def maps_only(facts: Facts, where: str, label: str) -> Iterator[str]:
    yield from same("decided by maps", facts.by_maps(where), True)
    yield from same("label", label, facts.metrics[facts.deciding(where) or ""]["label"])


@kind(IN_VERDICTS, rf"Over \d+ maps with a known error, .+? was {NUMBER} \(95 % interval {NUMBER} to {NUMBER}\)\.")
def validated(facts: Facts, where: str) -> Iterator[str]:
    yield from same("decided by maps", facts.by_maps(where), True)


@kind(
    IN_VERDICTS,
    r"The spread is that of (?P<runs>\d+) (?:excerpts of (?P<scans>[\d,]+) scans of this recording|runs of this "
    r"recording, (?P<unchanged>one as it is and the others|all)) under small perturbations \([^()]+ changed by at most "
    r"1 %\), .+? by more\.",
)
def spread(facts: Facts, where: str, runs: str, scans: str | None, unchanged: str | None) -> Iterator[str]:
    metric = facts.deciding(where) or ""
    found = facts.find(where, metric)
    first = facts.ranked(where, metric)[0]
    yield from same("runs", (int(runs), True), (len(found[first].values), found[first].perturbed))
    own = [run["dataset_parameters"].get("nuisance_scans", 0) for run in facts.runs[where][first]]
    yield from same("excerpts", {int((scans or "0").replace(",", ""))}, set(own))
    yield from same("unchanged", unchanged is not None and "as it is" in unchanged, None in found[first].values)


@kind(
    IN_VERDICTS, rf"(?P<label>[^.:]+?): (?P<one>.+?) \((?P<least>{AMOUNT})\) to (?P<other>.+?) \((?P<most>{AMOUNT})\)\."
)
def cost(facts: Facts, where: str, **said: str) -> Iterator[str]:
    metric = next(name for name, one in facts.metrics.items() if one["label"].lower() == said["label"].lower())
    ranked, found = facts.ranked(where, metric), facts.find(where, metric)
    yield from same("cheapest and dearest", (said["one"], said["other"]), (ranked[0], ranked[-1]))
    yield from check_amount(said["one"], said["least"], found[said["one"]].median)
    yield from check_amount(said["other"], said["most"], found[said["other"]].median)


@kind(
    IN_VERDICTS,
    r"Remark of (?P<name>.+?)(?: in (?P<count>\d+) of (?P<every>\d+) runs, for example)?: "
    r"(?P<text>.+?)\.(?= Remark of |$)",
)
def remark(facts: Facts, where: str, name: str, count: str | None, every: str | None, text: str) -> Iterator[str]:
    own = facts.runs[where][name]
    found = [run["remarks"] for run in own if run["remarks"]]
    yield from same("runs with remarks", (int(count or 1), int(every or 1)), (len(found), len(own)))
    yield from same("remarks", text, "; ".join(one.rstrip(".") for one in found[0]))


@kind(IN_VERDICTS, r"Times were measured on different processors and cannot be compared: .+")
def processors(facts: Facts, where: str) -> Iterator[str]:
    yield from same("more than one method ran", len(facts.runs[where]) > 1, True)
