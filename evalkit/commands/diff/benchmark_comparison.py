"""Whether something has become slower: Mann-Whitney's test, the ratio of medians with its interval, a stated limit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from scipy import stats

from evalkit.commands.diff.benchmark import Benchmark, Series
from evalkit.core.errors import BadData
from evalkit.stats.bootstrap import DRAWS
from evalkit.stats.intervals import CONFIDENCE, Interval

Said = Literal["regression", "improvement", "within the limit", "no difference shown", "too few samples"]

LARGEST_P = 0.002
"""Many series are compared in one go: what chance would show once in 500 is no news."""

COLUMNS = ("benchmark", "what", "old", "new", "ratio", "95 % interval", "p", "that is")
MARKS: Mapping[Said, str] = {"regression": "❌ ", "improvement": "✅ "}
ORDER: tuple[Said, ...] = ("regression", "improvement", "no difference shown", "within the limit", "too few samples")


@dataclass(frozen=True)
class Change:
    """One series before and after: medians, their ratio new / old with its 95 % interval, and p of the test."""

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
    said: Said


@dataclass(frozen=True)
class Comparison:
    """``apart``: what one side alone has, and what cannot be compared. ``limit``: a share."""

    changes: tuple[Change, ...]
    apart: tuple[str, ...]
    limit: float

    @property
    def regressions(self) -> int:
        """How many series are slower by more than noise and limit."""
        return sum(change.said == "regression" for change in self.changes)

    def as_json(self) -> dict[str, Any]:
        """The whole as plain values."""
        return {**asdict(self), "regressions": self.regressions}


def compared(
    old: Mapping[str, Benchmark], new: Mapping[str, Benchmark], limit: float, across_machines: bool = False
) -> Comparison:
    """Every series that both have; BadData where they ran on different processors and nobody said it is meant."""
    changes, apart = [], [*_alone(old, new, "new"), *_alone(new, old, "old")]
    for name in sorted(old.keys() & new.keys()):
        before, after = old[name], new[name]
        if before.processor != after.processor and not across_machines:
            raise BadData(
                name,
                "",
                f"measured on '{before.processor or 'unknown'}' and on '{after.processor or 'unknown'}'",
                "compare what one machine measured, or say --across-machines",
            )
        ours, theirs = ({one.name: one for one in side.series} for side in (before, after))
        apart += [f"{name}: '{one}' on one side only" for one in sorted(ours.keys() ^ theirs.keys())]
        for what in (one for one in ours if one in theirs):
            if ours[what].unit != theirs[what].unit:
                apart.append(f"{name}: '{what}' in {ours[what].unit} and in {theirs[what].unit}")
            else:
                changes.append(change(name, ours[what], theirs[what], limit))
    changes.sort(key=lambda one: (ORDER.index(one.said), -abs(math.log(max(one.ratio, 1e-12)))))
    return Comparison(tuple(changes), tuple(apart), limit)


def change(benchmark: str, old: Series, new: Series, limit: float) -> Change:
    """What has become of one series."""
    found = ratio(old, new)
    p = float(stats.mannwhitneyu(old.samples, new.samples, alternative="two-sided").pvalue)
    return Change(
        benchmark, old.name, old.unit, old.median, new.median, found.value, found.low, found.high, p,
        (len(old.samples), len(new.samples)), _said(old, new, found.value, p, limit),
    )  # fmt: skip


def ratio(old: Series, new: Series) -> Interval:
    """median(new) / median(old) with its percentile bootstrap interval; both sides are drawn anew."""
    rng = np.random.default_rng(0)
    drawn = [np.median(rng.choice(np.asarray(side.samples), (DRAWS, len(side.samples))), axis=1) for side in (new, old)]
    low, high = np.quantile(_share(drawn[0], drawn[1]), [0.5 - CONFIDENCE / 2.0, 0.5 + CONFIDENCE / 2.0])
    value = float(_share(np.array(new.median), np.array(old.median)))
    return Interval(value, min(float(low), value), max(float(high), value), min(len(old.samples), len(new.samples)))


def enough(old: int, new: int) -> bool:
    """Whether so many samples could show any difference at all: complete separation is less probable than the limit."""
    return math.comb(old + new, old) > 2.0 / LARGEST_P


def rows(found: Comparison) -> list[tuple[str, ...]]:
    """The table's rows, worst first."""
    return [
        (
            one.benchmark, one.name, f"{one.old:.4g} {one.unit}", f"{one.new:.4g} {one.unit}", f"{one.ratio:.3f}",
            f"{one.low:.3f} to {one.high:.3f}", f"{one.p:.2g}", f"{MARKS.get(one.said, '')}{_told(one)}",
        )
        for one in found.changes
    ]  # fmt: skip


def verdict(found: Comparison) -> str:
    """The whole in a sentence."""
    said = [one.said for one in found.changes]
    head = "No regression" if not found.regressions else f"{found.regressions} of {len(said)} became worse"
    few = f"; {said.count('too few samples')} have too few samples to tell" if "too few samples" in said else ""
    return (
        f"{head} beyond {100 * found.limit:g} % and the noise (Mann-Whitney, p < {LARGEST_P}); "
        f"{said.count('improvement')} improved{few}."
    )


def markdown(found: Comparison) -> str:
    """A comment for a pull request."""
    table = rows(found)
    lines = [f"**{verdict(found)}**", ""]
    if table:
        lines += [_line(COLUMNS), _line(("---",) * len(COLUMNS)), *(_line(row) for row in table), ""]
    return "\n".join([*lines, *(f"- {one}" for one in found.apart)]).rstrip() + "\n"


def _said(old: Series, new: Series, value: float, p: float, limit: float) -> Said:
    if not enough(len(old.samples), len(new.samples)):
        return "too few samples"
    if p >= LARGEST_P:
        return "no difference shown"
    if 1.0 / (1.0 + limit) <= value <= 1.0 + limit:
        return "within the limit"
    return "regression" if value > 1.0 else "improvement"


def _told(one: Change) -> str:
    return f"{one.said} ({one.samples[0]} and {one.samples[1]})" if one.said == "too few samples" else one.said


def _share(new: np.ndarray[Any, Any], old: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """new / old; 1 where both are nothing."""
    return np.where((old == 0.0) & (new == 0.0), 1.0, new / np.maximum(old, np.finfo(float).tiny))


def _alone(own: Mapping[str, Benchmark], other: Mapping[str, Benchmark], side: str) -> list[str]:
    return [f"{name}: not measured in the {side} one" for name in sorted(own.keys() - other.keys())]


def _line(cells: tuple[str, ...]) -> str:
    return f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |"
