"""Bootstrap draws of the scores of all trials of a comparison, with the same blocks for every method."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.run_result import Trial
from evalkit.stats.bootstrap import BootstrapDraws, Series, bootstrap_score


@dataclass(frozen=True, eq=False)
class TrialBootstrap:
    """Draws of the trials' scores, computed on first use and cached.

    ``series``: functions that return the series of a trial, by metric. The random generator is seeded by sequence and
    seed, and only values that all completed methods have are drawn, so that ``a.values - b.values`` are draws of a
    paired difference.
    """

    trials: Sequence[Trial]
    series: Mapping[str, Callable[[Trial], Series | None]]
    _series: dict[tuple[str, str], Series | None] = field(default_factory=dict)
    _draws: dict[tuple[str, str], BootstrapDraws | None] = field(default_factory=dict)
    _shared: dict[tuple[str, int | None, str], Ints] = field(default_factory=dict)

    def draws(self, trial: Trial, metric: str) -> BootstrapDraws | None:
        """Return the draws of a metric of one trial; None if the metric has no series."""
        if metric not in self.series:
            return None
        key = (trial.key, metric)
        if key not in self._draws:
            self._draws[key] = self._bootstrap(trial, metric)
        return self._draws[key]

    def _bootstrap(self, trial: Trial, metric: str) -> BootstrapDraws | None:
        series, score = self._series_of(trial, metric), trial.scores[metric].value
        if series is None or score is None:
            return None
        shared = np.isin(series.keys, self._shared_keys(trial, metric))
        series = Series(series.keys[shared], series.values[shared], series.statistic, series.period_s)
        rng = np.random.default_rng([zlib.crc32(trial.sequence.encode()), 0 if trial.seed is None else trial.seed])
        return bootstrap_score(series, score, rng)

    def _shared_keys(self, trial: Trial, metric: str) -> Ints:
        group = (trial.sequence, trial.seed, metric)
        if group not in self._shared:
            completed = [t for t in self.trials if (t.sequence, t.seed) == group[:2] and t.run.status == "complete"]
            keys = [series.keys for t in completed if (series := self._series_of(t, metric)) is not None]
            self._shared[group] = reduce(np.intersect1d, keys) if keys else np.zeros(0, dtype=np.int64)
        return self._shared[group]

    def _series_of(self, trial: Trial, metric: str) -> Series | None:
        key = (trial.key, metric)
        if key not in self._series:
            self._series[key] = self.series[metric](trial)
        return self._series[key]
