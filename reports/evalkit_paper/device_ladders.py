"""One method at one rate on increasingly slow devices, all seeds together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from evalkit.commands.realtime.virtual_clock import BreakingRule, find_breaking_factor
from evalkit.core.se2 import Floats
from evalkit.execution.task import Result

RULE = BreakingRule()


@dataclass(frozen=True, eq=False)
class Ladder:
    """Rungs of one method at one rate, for all seeds and factors."""

    label: str
    rate_hz: float
    results: Sequence[Result]
    policy: str = "queue-of-one"

    @cached_property
    def rungs(self) -> list[list[Mapping[str, Any]]]:
        """Rungs (S, K) of this policy; the first of each seed is for a device that takes no time."""
        return [[rung for rung in result["devices"] if rung["policy"] == self.policy] for result in self.results]

    @property
    def factors(self) -> Floats:
        """Device factors (K,), 0 first."""
        return np.array([rung["factor"] for rung in self.rungs[0]])

    def values(self, *path: str) -> Floats:
        """One value of every rung (S, K); nan if missing."""
        return np.array([[_at(rung, path) for rung in own] for own in self.rungs], dtype=np.float64)

    def broken(self) -> list[bool]:
        """Whether each rung is broken: the median over the seeds is, or most seeds are lost."""
        ate = self.values("at_hand", "ate_rmse_m")
        lost = np.array([[bool(rung["lost"]) for rung in own] for own in self.rungs])
        middle = np.median(np.where(np.isfinite(ate) & ~lost, ate, np.inf), axis=0)
        return [RULE.is_broken(value if np.isfinite(value) else None, float(middle[0])) for value in middle.tolist()]

    def breaks_at(self) -> float | None:
        """Smallest factor that is broken."""
        return find_breaking_factor(self.factors.tolist(), self.broken())

    def rung(self, factor: float) -> int:
        """Index of a factor."""
        return int(np.flatnonzero(self.factors == factor)[0])

    @property
    def headroom(self) -> float:
        """Largest factor at which no scan of any seed is late."""
        return min(float(result["headroom"]) for result in self.results)

    @property
    def costs_ms(self) -> Floats:
        """Measured cost (ms) of all scans of all seeds."""
        return np.asarray(np.concatenate([result["costs_ns"] for result in self.results]) * 1e-6)


def _at(rung: Mapping[str, Any], path: Sequence[str]) -> float:
    value: Any = rung
    for name in path:
        value = value[name]
    return float("nan") if value is None else float(value)
