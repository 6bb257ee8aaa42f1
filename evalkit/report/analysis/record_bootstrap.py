"""Bootstrap draws of the scores of all records of a comparison, with the same blocks for every method."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.results.run_record import RunRecord
from evalkit.stats.bootstrap import BootstrapDraws, Series, bootstrap_score


@dataclass(frozen=True, eq=False)
class RecordBootstrap:
    """Draws of the records' scores, computed on first use and cached.

    ``series``: functions that return the series of a record, by metric. The random generator is seeded by sequence and
    seed, and only values that all completed methods have are drawn, so that ``a.values - b.values`` are draws of a
    paired difference.
    """

    records: Sequence[RunRecord]
    series: Mapping[str, Callable[[RunRecord], Series | None]]
    _series: dict[tuple[str, str], Series | None] = field(default_factory=dict)
    _draws: dict[tuple[str, str], BootstrapDraws | None] = field(default_factory=dict)
    _shared: dict[tuple[str, int | None, str], Ints] = field(default_factory=dict)

    def draws(self, record: RunRecord, metric: str) -> BootstrapDraws | None:
        """Return the draws of a metric of one record; None if the metric has no series."""
        if metric not in self.series:
            return None
        key = (record.key, metric)
        if key not in self._draws:
            self._draws[key] = self._bootstrap(record, metric)
        return self._draws[key]

    def _bootstrap(self, record: RunRecord, metric: str) -> BootstrapDraws | None:
        series, score = self._series_of(record, metric), record.scores.by_metric[metric].value
        if series is None or score is None:
            return None
        shared = np.isin(series.keys, self._shared_keys(record, metric))
        series = Series(series.keys[shared], series.values[shared], series.statistic, series.period_s)
        rng = np.random.default_rng([zlib.crc32(record.sequence.encode()), 0 if record.seed is None else record.seed])
        return bootstrap_score(series, score, rng)

    def _shared_keys(self, record: RunRecord, metric: str) -> Ints:
        group = (record.sequence, record.seed, metric)
        if group not in self._shared:
            completed = [t for t in self.records if (t.sequence, t.seed) == group[:2] and t.result.is_complete]
            keys = [series.keys for t in completed if (series := self._series_of(t, metric)) is not None]
            self._shared[group] = reduce(np.intersect1d, keys) if keys else np.zeros(0, dtype=np.int64)
        return self._shared[group]

    def _series_of(self, record: RunRecord, metric: str) -> Series | None:
        key = (record.key, metric)
        if key not in self._series:
            self._series[key] = self.series[metric](record)
        return self._series[key]
