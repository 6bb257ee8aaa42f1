"""What follows from the runs of a results.json, recomputed with arithmetic of its own."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from scipy import stats

GROUPS = ("relations", "drift", "map against truth", "localisation", "map consistency")
OF_METHODS = "one|other|winner|second|last|base|method|m"
MEASURES = {
    "split_distance_m": "the smallest distance between the halves of the run",
    "mom_cm2": "the least scatter across orthogonal walls",
    "cleared_percent": "the fewest hits in cleared space",
    "s2m_m": "the lowest S2M residual",
}


@dataclass
class Found:
    """One metric of one method over one sequence."""

    values: dict[int | None, float] = field(default_factory=dict)
    complete: int = 0
    expected: int = 0
    lost_s: float | None = None
    lost_runs: int = 0
    recovered_s: list[float] = field(default_factory=list)
    supports: list[int] = field(default_factory=list)
    tuned: bool = False
    perturbed: bool = False
    guessed: float = 0.0

    @property
    def median(self) -> float:
        """The median over the runs."""
        return median(self.values.values())

    @property
    def ranks(self) -> bool:
        """Whether the method is ranked."""
        whole = self.complete == self.expected == len(self.values) and self.guessed <= 50.0
        return bool(self.values) and whole and self.lost_s is None and not self.tuned


class Facts:
    """What follows from the runs of a results.json."""

    def __init__(self, content: Mapping[str, Any]) -> None:
        self.content = content
        self.metrics = {one["name"]: one for one in content["metrics"]}
        self.labels = {one["label"]: one["name"] for one in content["metrics"]}
        self.runs: dict[str, dict[str, list[Mapping[str, Any]]]] = defaultdict(lambda: defaultdict(list))
        for run in content["runs"]:
            self.runs[run["sequence"]][run["method"]].append(run)
        self.methods = [name for name in content["methods"] if any(name in own for own in self.runs.values())]
        self.found_before: dict[tuple[str, str], dict[str, Found]] = {}

    def fill(self, pattern: str) -> str:
        """Return a pattern whose groups of methods and metrics match their names only."""
        methods, labels = (
            "|".join(map(re.escape, sorted(names, key=len, reverse=True)))
            for names in (self.methods, [*self.labels, *(one[:1].upper() + one[1:] for one in self.labels)])
        )
        pattern = re.sub(rf"\(\?P<({OF_METHODS})>\.\+\?\)", lambda group: f"(?P<{group[1]}>{methods})", pattern)
        return re.sub(r"\(\?P<label>[^)]+?\)", lambda group: f"(?P<label>{labels})", pattern)

    def with_role(self, role: str) -> list[str]:
        """Return the methods with a role."""
        return [name for name in self.methods if self.content["methods"][name]["role"] == role]

    def find(self, sequence: str, metric: str) -> dict[str, Found]:
        """Return the scores of all methods."""
        if (sequence, metric) not in self.found_before:
            self.found_before[sequence, metric] = {
                method: self._find(method, runs, metric) for method, runs in self.runs[sequence].items()
            }
        return self.found_before[sequence, metric]

    def _find(self, method: str, runs: Sequence[Mapping[str, Any]], metric: str) -> Found:
        runtime = self.metrics[metric]["group"] == "runtime"
        tuned = runs[0]["dataset"] in self.content["methods"][method]["tuned_on"] and not runtime
        expected = sum(run["status"] != "interrupted" for run in runs)
        found = Found(expected=expected, tuned=tuned, perturbed="nuisance" in runs[-1]["dataset_parameters"])
        guessed = []
        for run in runs:
            if run["status"] != "complete":
                continue
            found.complete += 1
            value = run["scores"].get(metric, {}).get("value")
            kept = run["scores"].get("guess_kept_percent", {}).get("value")
            guessed += [] if kept is None else [kept]
            if value is not None:
                found.values[run["seed"]] = value
                found.supports.append(run["scores"][metric]["support"])
        found.guessed = median(guessed) if guessed else 0.0
        lost = [run["lost_at_s"] for run in runs if run["lost_at_s"] is not None]
        found.lost_runs = len(lost)
        found.recovered_s = [run["recovered_at_s"] for run in runs if run["recovered_at_s"] is not None]
        if lost and not runtime:
            found.lost_s = min(lost)
        return found

    def ranked(self, sequence: str, metric: str) -> list[str]:
        """Return the ranked methods, best first."""
        if not self.metrics[metric]["better"]:
            return []
        sign = 1.0 if self.metrics[metric]["better"] == "lower" else -1.0
        found = self.find(sequence, metric)
        baselines = self.with_role("baseline") if self.metrics[metric]["group"] in ("residuals", "runtime") else []
        own = [method for method, one in found.items() if one.ranks and method not in baselines]
        return sorted(own, key=lambda method: sign * found[method].median)

    def deciding(self, sequence: str) -> str | None:
        """Return the metric that decides a sequence."""
        names = [name for name, one in self.metrics.items() if one["headline"] and one["better"]]
        long = self.find(sequence, "relations_long_mean_m") if "relations_long_mean_m" in self.metrics else {}
        medians = [one.median for one in long.values() if one.values]
        if medians and min(medians) > 1.0:
            names.sort(key=lambda name: "_short_" not in name)
        for group in GROUPS:
            for name in names:
                valued = any(one.values for one in self.find(sequence, name).values())
                if self.metrics[name]["group"] == group and valued:
                    return name
        return None

    def difference(self, sequence: str, metric: str, one: str, other: str) -> tuple[float, float, float, int] | None:
        """Return ``one - other`` over common runs with the bounds of its interval and the number of pairs."""
        first, second = (self.find(sequence, metric)[name].values for name in (one, other))
        seeds = [seed for seed in first if seed in second]
        if len(seeds) < 2:
            return None
        a, b = [first[seed] for seed in seeds], [second[seed] for seed in seeds]
        logs = min(a + b) > 0.0
        apart = [math.log(x / y) if logs else x - y for x, y in zip(a, b, strict=True)]
        count, mean = len(apart), sum(apart) / len(apart)
        error = math.sqrt(sum((x - mean) ** 2 for x in apart) / (count - 1) / count)
        error = 0.0 if error < 1e-11 else error
        perturbed = self.find(sequence, metric)[one].perturbed
        half = stats.t.ppf(0.5 + 0.5 * self.confidence(count, perturbed), count - 1) * error
        scale = median(b)
        low, middle, high = (scale * math.expm1(min(x, 50.0)) if logs else x for x in (mean - half, mean, mean + half))
        return middle, low, high, count

    def detects_double(self, sequence: str, metric: str, one: str, other: str) -> bool:
        """Return whether the common runs detect, in four cases of five, that one value is twice the other."""
        first, second = (self.find(sequence, metric)[name].values for name in (one, other))
        seeds = [seed for seed in first if seed in second]
        apart = [math.log(first[seed] / second[seed]) for seed in seeds]
        error, freedom = stats.sem(apart), len(seeds) - 1
        shift = math.log(2.0) / error if error else math.inf
        alpha = 1.0 - self.confidence(len(seeds), self.find(sequence, metric)[one].perturbed)
        limit = stats.t.ppf(1.0 - 0.5 * alpha, freedom)
        # the other tail is that of the opposite shift: SciPy's nct.cdf is not a number that far out
        return bool(shift > 1e6 or stats.nct.sf(limit, freedom, shift) + stats.nct.sf(limit, freedom, -shift) >= 0.8)

    @staticmethod
    def confidence(pairs: int, perturbed: bool) -> float:
        """Return the confidence of a difference."""
        return 0.99 if perturbed or pairs < 6 else 0.97

    def shows(self, sequence: str, metric: str, method: str, apart: tuple[float, float, float, int]) -> bool:
        """Return whether a difference excludes zero, over enough pairs."""
        enough = apart[3] >= 6 or not self.find(sequence, metric)[method].perturbed
        return enough and (apart[1] > 0.0 or apart[2] < 0.0)

    def margin(self, metric: str, better: float) -> float:
        """Return the smallest difference that matters."""
        one = self.metrics[metric]
        position = one["unit"] == "m" and one["group"] in ("drift", "relations")
        points = 1.0 if one["group"] == "localisation" and one["unit"] == "%" else 0.0
        return max(0.05 * abs(better), 10.0 ** -one["digits"], 0.002 if position else points)

    def floor(self, sequence: str, metric: str, *methods: str) -> float:
        """Return what errors of the ground truth can make of the difference of two methods."""
        card = self.metrics[metric]
        one = {"m": 0.03, "deg": 0.4}.get(card["unit"], 0.0) if card["group"] == "relations" else 0.0
        return max(one / 6.0, 2.0 * one / math.sqrt(self.relations(sequence, metric, *methods))) if one else 0.0

    def relations(self, sequence: str, metric: str, *methods: str) -> int:
        """Return how many relations a run of each method has at least, by the medians."""
        return min(int(median(self.find(sequence, metric)[name].supports)) for name in methods)

    def is_worse(self, sequence: str, metric: str, one: str, other: str) -> bool:
        """Return whether one method is clearly worse than another."""
        found, sign = self.find(sequence, metric), 1.0 if self.metrics[metric]["better"] == "lower" else -1.0
        if one not in found or other not in found or not found[one].values or not found[other].values:
            return False
        apart = self.difference(sequence, metric, one, other)
        medians = found[one].median, found[other].median
        if apart is None or sign * (medians[0] - medians[1]) <= 0.0 or sign * apart[0] <= 0.0:
            return False
        better = min(medians) if sign > 0.0 else max(medians)
        least = max(self.margin(metric, better), self.floor(sequence, metric, one, other))
        return abs(apart[0]) >= least * (1.0 - 1e-9) and self.shows(sequence, metric, one, apart)

    def led(self, sequence: str, metric: str | None = None) -> tuple[list[str], list[str]]:
        """Return the methods from which the first is not clearly apart (itself first), and those of them near to it.

        In the deciding metric, or in another one.
        """
        metric = metric or self.deciding(sequence)
        if metric is None or not (ranked := self.ranked(sequence, metric)):
            return [], []
        found, first = self.find(sequence, metric), ranked[0]
        tied = [first, *(one for one in ranked[1:] if not self.is_worse(sequence, metric, one, first))]

        def near(one: str) -> bool:
            apart = self.difference(sequence, metric, one, first)
            size = abs(found[one].median - found[first].median)
            if apart is None:
                return False
            floor = self.floor(sequence, metric, one, first)
            least = max(self.margin(metric, found[first].median), floor)
            shown = self.shows(sequence, metric, one, apart)
            close = abs(apart[0]) < floor or (shown and abs(apart[0]) < least)
            return close or size <= max(0.25 * abs(found[first].median), self.margin(metric, found[first].median))

        return tied, [one for one in tied if one == first or near(one)]

    def standing(self, where: str, method: str, metric: str | None = None) -> str:
        """Return how a method stands on a sequence, in the deciding metric or in another one."""
        decides = metric in (None, self.deciding(where))
        metric = metric or self.deciding(where) or ""
        found, (tied, near) = self.find(where, metric), self.led(where, metric)
        if method in found and found[method].lost_s is not None:
            return "lost"
        ranked = self.ranked(where, metric)
        repeated = sum(len(found[one].values) > 1 for one in ranked) > 1
        barred = ("degenerate", "disagreement") if decides else ("degenerate",)
        if method not in ranked or not repeated or self.outcome(where) in barred:
            return "not comparable"
        if decides and method in near and self.by_maps(where) and method not in self.agreed(where):
            return "undecided"
        if method in near:
            return "best" if len(tied) == 1 and len(ranked) > 1 else "tied"
        if method in tied:
            return "not comparable" if self.difference(where, metric, ranked[0], method) is None else "undecided"
        return "worse"

    def outcome(self, sequence: str) -> str:
        """Return the outcome of a sequence in the words of results.json."""
        metric = self.deciding(sequence)
        if self.content["sequences"][sequence]["degenerate"]:
            return "degenerate"
        if metric is None:
            return "unranked"
        ranked, found = self.ranked(sequence, metric), self.find(sequence, metric)
        valued = [one for one in found.values() if one.values]
        if valued and all(one.lost_s is not None for one in valued):
            return "lost"
        if len(ranked) < 2:
            return "single" if ranked else "unranked"
        if sum(len(found[one].values) > 1 for one in ranked) < 2:
            return "one run"
        if self.by_maps(sequence) and not self.agreed(sequence):
            return "disagreement"
        return "winner" if len(self.led(sequence)[0]) == 1 else "tied"

    def all_tied(self, sequence: str) -> bool:
        """Return whether a sequence with a verdict tells no method apart, not even by tracks lost in most runs."""
        found = self.find(sequence, self.deciding(sequence) or "")
        often = [name for name, one in found.items() if 2 * one.lost_runs > one.expected]
        if set(often) - set(self.with_role("baseline")):
            return False
        leaders = self.agreed(sequence) if self.by_maps(sequence) else self.led(sequence)[1]
        tied = self.outcome(sequence) == "tied"
        return tied and set(leaders) == set(self.ranked(sequence, self.deciding(sequence) or ""))

    def losses(self, one: Found) -> str:
        """Return when a method lost the track, in the words of a report."""
        if one.lost_s is None:
            return ""
        if one.lost_runs == 1:
            found = "".join(f", found at {seconds:.0f} s" for seconds in one.recovered_s)
            count = f"in 1 of {one.expected}, " if one.expected > 1 else ""
            return f"{count}at {one.lost_s:.0f} s{found}"
        found = f", {len(one.recovered_s)} found again" if one.recovered_s else ""
        return f"in {one.lost_runs} of {one.expected}, first at {one.lost_s:.0f} s{found}"

    def relative(self, over: Sequence[str], one: str, other: str) -> tuple[float | None, float | None, int]:
        """Return error and CPU time of a method divided by another's, over the sequences where both have a value."""
        errors, times = [], []
        for where in over:
            metric = self.deciding(where) or ""
            found, spent = self.find(where, metric), self.find(where, "cpu_median_ms")
            pair = [found.get(name) for name in (one, other)]
            if any(p is None or p.tuned or not p.values or not p.complete == p.expected == len(p.values) for p in pair):
                continue
            sign = 1.0 if self.metrics[metric]["better"] == "lower" else -1.0
            errors.append(sign * math.log(max(pair[0].median, 1e-9) / max(pair[1].median, 1e-9)))
            if spent[one].values and spent[other].values and spent[one].median and spent[other].median:
                times.append(math.log(spent[one].median / spent[other].median))
        means = [math.exp(sum(logs) / len(logs)) if logs else None for logs in (errors, times)]
        return means[0], means[1], len(errors)

    def better(self, method: str) -> list[str]:
        """Return the methods whose signed-rank test against a method finds them better, each over their common runs.

        Without the adjustment for the number of tests, so that there may be more of them than a report names.
        """
        errors: dict[str, dict[tuple[str, int | None], float]] = {name: {} for name in self.methods}
        for where, own in self.runs.items():
            metric = self.deciding(where)
            if metric is None or self.content["sequences"][where]["degenerate"]:
                continue
            if self.metrics[metric]["group"] not in GROUPS[:3] or self.metrics[metric]["better"] != "lower":
                continue
            for name, runs in own.items():
                for run in [] if self.find(where, metric)[name].tuned else runs:
                    value = run["scores"].get(metric, {}).get("value")
                    if run["status"] == "complete" and value is not None:
                        errors[name][where, run["seed"]] = value
        found = []
        for name in self.methods:
            common = [key for key in errors[method] if key in errors[name]]
            apart = [round(math.log(errors[name][key] / errors[method][key]), 9) for key in common]
            if name != method and any(apart) and stats.wilcoxon(apart).pvalue <= 0.05 and median(apart) < -0.048:
                found.append(name)
        return found

    def by_maps(self, sequence: str) -> bool:
        """Return whether maps alone decide."""
        metric = self.deciding(sequence)
        return metric is not None and self.metrics[metric]["group"] == "map consistency"

    def by_fit(self, sequence: str) -> bool:
        """Return whether the fit to a known map decides."""
        metric = self.deciding(sequence)
        return metric is not None and self.metrics[metric]["group"] == "localisation"

    def agreed(self, sequence: str) -> list[str]:
        """Return the methods best or not clearly worse in every map metric."""
        left = list(self.methods)
        for name in MEASURES:
            found = self.find(sequence, name) if name in self.metrics else {}
            sign = 1.0 if name in self.metrics and self.metrics[name]["better"] == "lower" else -1.0
            ranked = sorted((one for one in found if found[one].ranks), key=lambda one: sign * found[one].median)
            if not ranked:
                return []
            left = [one for one in left if one in ranked and not self.is_worse(sequence, name, one, ranked[0])]
        return left

    def behind(self, sequence: str, baseline: str) -> list[str]:
        """Return the methods clearly worse than a baseline; by maps, in every map metric."""
        metric = self.deciding(sequence)
        if metric is None:
            return []
        names = [*MEASURES] if self.by_maps(sequence) else [metric]
        if any(name not in self.metrics for name in names):
            return []
        return [
            one for one in self.runs[sequence]
            if all(self.is_worse(sequence, name, one, baseline) for name in names)
        ]  # fmt: skip
