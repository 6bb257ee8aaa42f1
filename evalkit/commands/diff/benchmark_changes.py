"""Compare two sets of benchmarks: Mann-Whitney test, ratio of medians with its interval, and a stated limit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import stats

from evalkit.commands.diff.benchmark import Benchmark, BenchmarkSeries
from evalkit.commands.diff.changes import MARKS, ORDER, ChangeText, ChangeVerdict, describe_missing
from evalkit.core.errors import BadData
from evalkit.stats.bootstrap import DRAWS
from evalkit.stats.intervals import CONFIDENCE, Interval

MAX_P = 0.002
"""Many series are tested at once, so the level is stricter than 5 %: chance alone gives it once in 500."""

COLUMNS = ("benchmark", "series", "old", "new", "ratio", "95 % interval", "p", "verdict")
COUNTED: tuple[ChangeVerdict, ...] = ("no difference shown", "within the limit")
"""Verdicts that are only counted unless everything is listed."""


@dataclass(frozen=True)
class BenchmarkChange:
    """One series before and after: medians, their ratio new / old with its 95 % interval, and the test's p."""

    benchmark: str
    name: str
    unit: str
    old: float
    new: float
    ratio: float
    low: float
    high: float
    p: float
    samples: tuple[int, int]
    verdict: ChangeVerdict


@dataclass(frozen=True)
class BenchmarkDiff:
    """The changes, worst first. ``remarks``: series on one side only, and units that differ. ``limit``: a share.

    ``missing``: how many series of the old side have no counterpart on the new one.
    """

    changes: tuple[BenchmarkChange, ...]
    remarks: tuple[str, ...]
    limit: float
    missing: int

    @property
    def regressions(self) -> int:
        """The number of series that are slower by more than noise and limit."""
        return sum(change.verdict == "regression" for change in self.changes)


def compare_benchmarks(
    old: Mapping[str, Benchmark], new: Mapping[str, Benchmark], limit: float, across_machines: bool = False
) -> BenchmarkDiff:
    """Compare every series that both sides have.

    Raises BadData if a benchmark ran on two different processors and ``across_machines`` is not set.
    """
    changes: list[BenchmarkChange] = []
    remarks = [*_only_in(old, new, "new"), *_only_in(new, old, "old")]
    for name in sorted(old.keys() & new.keys()):
        before, after = old[name], new[name]
        if before.processor != after.processor and not across_machines:
            raise BadData(
                name,
                "",
                f"measured on '{before.processor or 'unknown'}' and on '{after.processor or 'unknown'}'",
                "compare two measurements of one machine, or give --across-machines",
            )
        before_by_name, after_by_name = ({one.name: one for one in side.series} for side in (before, after))
        remarks += [f"{name}: '{one}' on one side only" for one in sorted(before_by_name.keys() ^ after_by_name.keys())]
        for what, series in before_by_name.items():
            if what not in after_by_name:
                continue
            if series.unit != after_by_name[what].unit:
                remarks.append(f"{name}: '{what}' in {series.unit} and in {after_by_name[what].unit}")
            else:
                changes.append(_compare_series(name, series, after_by_name[what], limit))
    changes.sort(key=lambda one: (ORDER.index(one.verdict), -abs(math.log(max(one.ratio, 1e-12)))))
    missing = sum(len(one.series) for one in old.values()) - len(changes)
    return BenchmarkDiff(tuple(changes), tuple(remarks), limit, missing)


def describe_benchmark_diff(diff: BenchmarkDiff, everything: bool = False) -> ChangeText:
    """Return the comparison as text. ``everything``: list also what did not change."""
    verdicts = [one.verdict for one in diff.changes]
    head = "No regression" if not diff.regressions else f"{diff.regressions} of {len(verdicts)} series became worse"
    few = f"; {verdicts.count('too few samples')} have too few samples" if "too few samples" in verdicts else ""
    conclusion = (
        f"{describe_missing(diff.missing, 'series', 'the old measurement', 'the new one')}"
        f"{head} beyond {100 * diff.limit:g} % and the noise (Mann-Whitney, p < {MAX_P}); "
        f"{verdicts.count('improvement')} improved, {sum(map(verdicts.count, COUNTED))} of {len(verdicts)} series show "
        f"no difference or are within the limit{few}."
    )
    rows = tuple(
        (
            one.benchmark, one.name, f"{one.old:.4g} {one.unit}", f"{one.new:.4g} {one.unit}", f"{one.ratio:.3f}",
            f"{one.low:.3f} to {one.high:.3f}", f"{one.p:.2g}", f"{MARKS.get(one.verdict, '')}{_describe_verdict(one)}",
        )
        for one in diff.changes
        if everything or one.verdict not in COUNTED
    )  # fmt: skip
    content = {**asdict(diff), "regressions": diff.regressions}
    return ChangeText(COLUMNS, rows, diff.remarks, conclusion, diff.regressions, diff.missing, content)


def can_show_difference(old: int, new: int) -> bool:
    """Return whether complete separation of so many samples would be less probable than ``MAX_P``."""
    return math.comb(old + new, old) > 2.0 / MAX_P


def _compare_series(benchmark: str, old: BenchmarkSeries, new: BenchmarkSeries, limit: float) -> BenchmarkChange:
    ratio = _compute_ratio(old, new)
    p = float(stats.mannwhitneyu(old.samples, new.samples, alternative="two-sided").pvalue)
    verdict: ChangeVerdict
    if not can_show_difference(len(old.samples), len(new.samples)):
        verdict = "too few samples"
    elif p >= MAX_P:
        verdict = "no difference shown"
    elif 1.0 / (1.0 + limit) <= ratio.value <= 1.0 + limit:
        verdict = "within the limit"
    else:
        verdict = "regression" if ratio.value > 1.0 else "improvement"
    return BenchmarkChange(
        benchmark, old.name, old.unit, old.median, new.median, ratio.value, ratio.low, ratio.high, p,
        (len(old.samples), len(new.samples)), verdict,
    )  # fmt: skip


def _compute_ratio(old: BenchmarkSeries, new: BenchmarkSeries) -> Interval:
    """Return median(new) / median(old) with its percentile bootstrap interval; both sides are resampled."""
    rng = np.random.default_rng(0)
    draws = [np.median(rng.choice(np.asarray(side.samples), (DRAWS, len(side.samples))), axis=1) for side in (new, old)]
    low, high = np.quantile(_divide(draws[0], draws[1]), [0.5 - CONFIDENCE / 2.0, 0.5 + CONFIDENCE / 2.0])
    value = float(_divide(np.array(new.median), np.array(old.median)))
    return Interval(value, min(float(low), value), max(float(high), value), min(len(old.samples), len(new.samples)))


def _divide(new: np.ndarray[Any, Any], old: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return new / old; 1 where both are zero."""
    return np.where((old == 0.0) & (new == 0.0), 1.0, new / np.maximum(old, np.finfo(float).tiny))


def _describe_verdict(one: BenchmarkChange) -> str:
    few = one.verdict == "too few samples"
    return f"{one.verdict} ({one.samples[0]} and {one.samples[1]})" if few else one.verdict


def _only_in(own: Mapping[str, Benchmark], other: Mapping[str, Benchmark], side: str) -> list[str]:
    return [f"{name}: not in the {side} measurement" for name in sorted(own.keys() - other.keys())]
