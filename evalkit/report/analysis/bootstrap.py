"""What a run's numbers might as well have been: drawn from stretches of the run, the same ones for every method."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Literal

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.run_result import Trial
from evalkit.core.se2 import Floats
from evalkit.metrics import drift, relations
from evalkit.metrics.trajectory import match
from evalkit.stats import statistics

Statistic = Literal["mean", "rms", "median", "inverse"]

MIN_VALUES = 20
"""A shorter series has no stretches to draw."""

NEAR = 0.1
"""A series whose statistic is farther than this share from the score is not what the score was made of."""

MAX_FOR_MEDIAN = 250
"""A median is drawn from at most about so many values, evenly thinned: sorting is what costs."""


@dataclass(frozen=True, eq=False)
class Series:
    """What a score was made of: values (N,) in the order of time, and a number (N,) for what each belongs to.

    ``statistic`` makes the score of them; "inverse" is one over the mean, but for a factor. ``period_s``: from one
    value to the next, None where they are not a time series of their own.
    """

    keys: Ints
    values: Floats
    statistic: Statistic
    period_s: float | None


@dataclass(frozen=True, eq=False)
class Drawn:
    """A score's draws (D,), how many stretches the run was cut into, and a stretch's length (s; None: not in time)."""

    values: Floats
    blocks: float
    block_s: float | None


@dataclass(frozen=True, eq=False)
class Resamples:
    """The draws of all trials, made when asked for.

    The same seed draws the same stretches of a sequence for every method, over the values that all who finished
    have, so that ``a.values - b.values`` are draws of a paired difference.
    """

    trials: Sequence[Trial]
    _series: dict[tuple[str, str], Series | None] = field(default_factory=dict)
    _drawn: dict[tuple[str, str], Drawn | None] = field(default_factory=dict)
    _shared: dict[tuple[str, int | None, str], Ints] = field(default_factory=dict)

    def of(self, trial: Trial, metric: str) -> Drawn | None:
        """The draws of a metric of one trial; None where its score is not made of values in a row."""
        if metric not in SERIES:
            return None
        known = (trial.key, metric)
        if known not in self._drawn:
            self._drawn[known] = self._draw(trial, metric)
        return self._drawn[known]

    def _draw(self, trial: Trial, metric: str) -> Drawn | None:
        series, score = self._of_run(trial, metric), trial.scores[metric].value
        if series is None or score is None:
            return None
        shared = np.isin(series.keys, self._keys(trial, metric))
        series = Series(series.keys[shared], series.values[shared], series.statistic, series.period_s)
        rng = np.random.default_rng([zlib.crc32(trial.sequence.encode()), 0 if trial.seed is None else trial.seed])
        return drawn(series, score, rng)

    def _keys(self, trial: Trial, metric: str) -> Ints:
        group = (trial.sequence, trial.seed, metric)
        if group not in self._shared:
            beside = [t for t in self.trials if (t.sequence, t.seed) == group[:2] and t.run.status == "complete"]
            found = [series.keys for t in beside if (series := self._of_run(t, metric)) is not None]
            self._shared[group] = reduce(np.intersect1d, found) if found else np.zeros(0, dtype=np.int64)
        return self._shared[group]

    def _of_run(self, trial: Trial, metric: str) -> Series | None:
        known = (trial.key, metric)
        if known not in self._series:
            self._series[known] = SERIES[metric](trial)
        return self._series[known]


def drawn(series: Series, score: float, rng: np.random.Generator) -> Drawn | None:
    """The draws of a score by moving blocks of its series, or None where it is too short or makes another score.

    What little the score differs from the series (truth interpolated, the unit's factor) is passed on as a factor.
    """
    if len(series.values) < MIN_VALUES:
        return None
    value = statistic(series)
    if value == 0.0 or (series.statistic != "inverse" and abs(score / value - 1.0) > NEAR):
        return None
    values, factor = series.values, score / value
    thin = -(-len(values) // MAX_FOR_MEDIAN) if series.statistic == "median" else 1
    period_s = None if series.period_s is None else thin * series.period_s
    values = values[::thin]
    block = statistics.block_length(len(values), period_s)
    draws = factor * _draws(values, series.statistic, block, rng)
    return Drawn(draws, len(values) / block, None if period_s is None else block * period_s)


def statistic(series: Series) -> float:
    """The one number that a series makes."""
    if series.statistic == "median":
        return float(np.median(series.values))
    if series.statistic == "rms":
        return float(np.sqrt(np.mean(series.values**2)))
    mean = float(np.mean(series.values))
    return mean if series.statistic == "mean" else (1.0 / mean if mean else 0.0)


def _draws(values: Floats, kind: Statistic, block: int, rng: np.random.Generator) -> Floats:
    if kind == "median":
        return np.asarray(np.median(values[statistics.block_rows(len(values), block, rng)], axis=1))
    if kind == "rms":
        return np.sqrt(np.maximum(statistics.block_means(values**2, block, rng), 0.0))
    means = statistics.block_means(values, block, rng)
    return means if kind == "mean" else 1.0 / means


def _errors(trial: Trial) -> Series | None:
    """Distances to the truth, scan by scan, where it is known."""
    if trial.errors_m is None or len(trial.errors_m) != len(trial.run.steps):
        return None
    known = np.isfinite(trial.errors_m)
    return _in_time(trial.run.steps["stamp_ns"][known], trial.errors_m[known], "rms")


def _cost(kind: Statistic) -> Callable[[Trial], Series | None]:
    """Milliseconds of CPU time, scan by scan, where it was measured."""

    def series(trial: Trial) -> Series | None:
        steps = trial.run.steps
        return _in_time(steps["stamp_ns"], steps["cpu_ns"] * 1e-6, kind) if steps["cpu_ns"].any() else None

    return series


def _drift(trial: Trial) -> Series | None:
    """Errors in percent of segments of all lengths, by where they start; in a row, but not evenly in time."""
    matched = match(trial.run.estimate, trial.truth.trajectory)
    if isinstance(matched, str):
        return None
    progress = drift.travelled_m(matched)
    starts = [drift.segments(progress, length, drift.START_EVERY_M)[0] for length in drift.LENGTHS_M]
    rows = drift.segment_errors(matched, drift.LENGTHS_M)
    if len(rows) == 0:
        return None
    first = np.concatenate(starts)
    length = np.repeat(np.arange(len(starts)), [len(one) for one in starts])
    order = np.lexsort((length, first))
    span_s = float(matched.stamps_ns[first.max()] - matched.stamps_ns[first.min()]) * 1e-9
    keys = matched.stamps_ns[first] * len(starts) + length
    percent = 100.0 * rows[:, 0] / rows[:, 2]
    return Series(keys[order], percent[order], "mean", max(span_s / len(rows), 1e-3))


def _relations(part: relations.Part) -> Callable[[Trial], Series | None]:
    """Translation errors of measured motions, by the first of their two times."""

    def series(trial: Trial) -> Series | None:
        known = trial.truth.relations
        if known is None or len(known) == 0:
            return None
        motions, answered = relations.estimated_motions(trial.run.estimate, known)
        errors = relations.symmetric_errors(motions, known.first_from_second[answered])[:, 0]
        wanted = relations.in_part(known, part)[answered]
        order = np.argsort(known.first_ns[answered][wanted], kind="stable")
        return Series(np.flatnonzero(answered)[wanted][order], errors[wanted][order], "mean", None)

    return series


def _in_time(stamps_ns: Ints, values: Floats, kind: Statistic) -> Series | None:
    if len(stamps_ns) < MIN_VALUES:
        return None
    return Series(stamps_ns, values, kind, float(np.median(np.diff(stamps_ns))) * 1e-9)


SERIES: Mapping[str, Callable[[Trial], Series | None]] = {
    "ate_rmse_m": _errors,
    "drift_percent": _drift,
    **{f"relations_{part}_mean_m": _relations(part) for part in ("all", "short", "long")},
    "cpu_median_ms": _cost("median"),
    "real_time_factor": _cost("inverse"),
}
"""The metrics that are made of values in a row, and where these are found."""
