"""Resample runs of many seeds or perturbations: what intervals hold, and how often verdicts are false or found."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from evalkit.commands.calibration.seed_runs import SeedRuns
from evalkit.metrics.metric import Metric
from evalkit.report.analysis.pairwise import compute_difference, margin, separation
from evalkit.report.analysis.scores import MethodScore, median_over_runs
from evalkit.stats.bootstrap import BootstrapDraws, expanded_percentile_interval
from evalkit.stats.intervals import CONFIDENCE, Interval, student_quantile
from evalkit.stats.runs import MIN_RUNS, runs_interval

RUNS = (1, 2, 3, 5, 8)
SUBSETS = 400
DIFFERENCES = (0.1, 0.2, 0.5)
WORLDS = "simulated worlds"


MIN_COVERAGE, MAX_COVERAGE, MAX_FALSE = 0.90, 0.97, 0.05
"""Limits of the means over methods and metrics, of all worlds together and of each recording alone, from three runs up;
the last for any number of runs."""


@dataclass(frozen=True, slots=True)
class Coverage:
    """Shares of intervals of ``runs`` runs that hold the median over all seeds, and the value of another run.

    ``within``: the bootstrap over blocks of the same runs; ``over``: Student's t over the runs, None for fewer than
    three. ``ratio``: median of the upper bound divided by the lower, of the latter. ``population``: all runs.
    """

    sequence: str
    method: str
    metric: str
    runs: int
    within_median: float | None
    within_another: float | None
    over_median: float | None
    over_another: float | None
    ratio: float | None
    population: int


@dataclass(frozen=True, slots=True)
class Verdicts:
    """Shares of clear verdicts between two methods whose labels are exchanged at random in each seed.

    ``false_within``, ``false_over``: both methods are then equal. ``power_within``, ``power_over``: the errors of one
    are 10, 20 and 50 % larger, and the verdict is that.
    """

    sequence: str
    methods: tuple[str, str]
    metric: str
    runs: int
    false_within: float
    false_over: float
    power_within: tuple[float, ...]
    power_over: tuple[float, ...]


def measure_coverage(found: SeedRuns, runs: int, rng: np.random.Generator, subsets: int = SUBSETS) -> Coverage:
    """Measure the intervals of random subsets of ``runs`` seeds."""
    middle = median(found.values)
    hits: dict[str, list[bool]] = {name: [] for name in ("wm", "wa", "om", "oa")}
    ratios = []
    for _ in range(subsets):
        chosen = rng.choice(len(found.values), runs + 1, replace=False).tolist()
        own, another = chosen[:-1], found.values[chosen[-1]]
        values, draws = [found.values[i] for i in own], [found.draws[i] for i in own]
        within, over = _interval_within(values, draws), runs_interval(values)
        for name, interval in (("w", within), ("o", over)):
            if interval is not None:
                hits[f"{name}m"].append(not interval.excludes(middle))
                hits[f"{name}a"].append(not interval.excludes(another))
        if over is not None and over.low > 0.0:
            ratios.append(over.high / over.low)
    shares = {name: float(np.mean(hit)) if hit else None for name, hit in hits.items()}
    ratio = median(ratios) if ratios else None
    return Coverage(
        found.sequence,
        found.method,
        found.metric,
        runs,
        shares["wm"],
        shares["wa"],
        shares["om"],
        shares["oa"],
        ratio,
        len(found.values),
    )


def measure_verdicts(
    metric: Metric,
    one: SeedRuns,
    other: SeedRuns,
    runs: int,
    rng: np.random.Generator,
    subsets: int = SUBSETS,
    perturbed: bool = False,
) -> Verdicts:
    """Measure verdicts on random subsets of ``runs`` seeds, with labels exchanged at random in each of them.

    ``perturbed``: the runs are perturbations of a recording.
    """
    found: dict[float, list[tuple[bool, bool]]] = {size: [] for size in (0.0, *DIFFERENCES)}
    for _ in range(subsets):
        chosen = rng.choice(min(len(one.values), len(other.values)), runs, replace=False).tolist()
        swapped = rng.random(runs) < 0.5
        first = [_pick(other if swap else one, seed) for seed, swap in zip(chosen, swapped, strict=True)]
        second = [_pick(one if swap else other, seed) for seed, swap in zip(chosen, swapped, strict=True)]
        for size, verdicts in found.items():
            worse = [(value * (1.0 + size), _scale(draws, 1.0 + size)) for value, draws in second]
            scores = _score("b", worse, perturbed), _score("a", first, perturbed)
            verdicts.append(_judge(metric, *scores, either=size == 0.0))
    shares = {size: [float(share) for share in np.mean(verdicts, axis=0)] for size, verdicts in found.items()}
    return Verdicts(
        one.sequence,
        (one.method, other.method),
        one.metric,
        runs,
        shares[0.0][0],
        shares[0.0][1],
        tuple(shares[size][0] for size in DIFFERENCES),
        tuple(shares[size][1] for size in DIFFERENCES),
    )


def find_failures(coverage: Sequence[Coverage], verdicts: Sequence[Verdicts], recordings: Collection[str]) -> list[str]:
    """Return in words which means over worlds, or of a recording, are outside the limits.

    The upper limit rises by what an exact interval holds too often because the runs are drawn from few.
    """
    failures = []
    for name, labels in group_sequences([one.sequence for one in coverage], recordings).items():
        for runs in RUNS:
            found = [one for one in coverage if one.runs == runs and one.sequence in labels]
            held = [one.over_median for one in found if one.over_median is not None]
            excess = max((expected_coverage(runs, one.population) - CONFIDENCE for one in found), default=0.0)
            if held and not MIN_COVERAGE <= (share := float(np.mean(held))) <= MAX_COVERAGE + excess:
                failures.append(f"{name}, {runs} runs: intervals hold the median in {100 * share:.1f} %")
            false = [one.false_over for one in verdicts if one.runs == runs and one.sequence in labels]
            if false and (share := float(np.mean(false))) > MAX_FALSE:
                failures.append(f"{name}, {runs} runs: equal methods get a verdict in {100 * share:.1f} %")
    return failures


def group_sequences(labels: Sequence[str], recordings: Collection[str]) -> dict[str, list[str]]:
    """Return the labels by the name of their group: all simulated worlds together, and each recording alone."""
    groups: dict[str, list[str]] = {}
    for label in dict.fromkeys(labels):
        groups.setdefault(label if label in recordings else WORLDS, []).append(label)
    return groups


def expected_coverage(runs: int, population: int) -> float:
    """Return how often an exact 95 % interval of Student's t holds the mean of all runs that its own are drawn from.

    Below three runs, which have no interval, 0.95. Drawn without replacement, the variance of a mean of ``runs``
    of ``population`` values is smaller by the factor ``1 - runs / population`` (Cochran, Sampling Techniques, 2.2).
    """
    from scipy.special import stdtr  # noqa: PLC0415 - slow to import

    if runs < MIN_RUNS:
        return CONFIDENCE
    freedom, share = runs - 1, 1.0 - runs / population
    critical = student_quantile(freedom, CONFIDENCE)
    return float(2.0 * stdtr(freedom, critical / math.sqrt(share)) - 1.0)


def _interval_within(values: Sequence[float], draws: Sequence[BootstrapDraws | None]) -> Interval | None:
    known = [one for one in draws if one is not None]
    if len(known) < len(values):
        return None
    blocks = sum(one.blocks for one in known)
    resampled = median_over_runs([one.values for one in known])
    return expanded_percentile_interval(median(values), resampled, len(values), blocks)


def _pick(found: SeedRuns, seed: int) -> tuple[float, BootstrapDraws | None]:
    return found.values[seed], found.draws[seed]


def _scale(draws: BootstrapDraws | None, factor: float) -> BootstrapDraws | None:
    return None if draws is None else BootstrapDraws(factor * draws.values, draws.blocks)


def _score(method: str, runs: Sequence[tuple[float, BootstrapDraws | None]], perturbed: bool) -> MethodScore:
    values, draws = tuple(value for value, _ in runs), tuple(draw for _, draw in runs)
    count = len(runs)
    return MethodScore(method, values, (), count, count, 0, "", tuple(range(count)), draws=draws, perturbed=perturbed)


def _judge(metric: Metric, worse: MethodScore, better: MethodScore, either: bool) -> tuple[bool, bool]:
    """Return whether the blocks within the runs, and the runs, show that one is worse (``either``: any of both)."""
    difference = compute_difference(worse, better)
    within = None if difference is None else difference.within
    size = median(worse.values) - median(better.values)
    least = margin(metric, min(median(worse.values), median(better.values)))
    shown = within is not None and within.excludes(0.0) and abs(within.value) >= least
    over = separation(metric, worse, better) == "clear"
    return shown and (either or size > 0.0), over and (either or size > 0.0)
