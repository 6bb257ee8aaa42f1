"""The rank agreement of map metrics with the true error, measured once and shipped in ``validated.json``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from evalkit.stats.intervals import Interval

FILE = "validated.json"
SCHEMA = {"name": "evalkit-metrics-validated", "version": 2}


@dataclass(frozen=True)
class RankAgreement:
    """Spearman's correlation of a metric with the true error of maps: 1 same order, 0 no relation, -1 reverse order.

    ``overall`` and ``by_perturbation``: mean over worlds of the correlation within each world. ``by_world``: the
    correlation in each world. None where it is undefined.
    """

    metric: str
    overall: Interval | None
    by_perturbation: Mapping[str, Interval | None]
    by_world: Mapping[str, Interval | None]


@dataclass(frozen=True)
class MetricValidation:
    """The rank agreement of all map metrics, and how it was measured.

    ``perturbations``: what each does, in words. ``map_count``: number of maps.
    """

    command: str
    created: str
    versions: Mapping[str, str]
    worlds: tuple[str, ...]
    mapper: str
    map_count: int
    perturbations: Mapping[str, str]
    agreement: tuple[RankAgreement, ...]

    def agreement_of(self, metric: str) -> RankAgreement | None:
        """Return the rank agreement of one metric; None if it was not measured."""
        return next((one for one in self.agreement if one.metric == metric), None)


@cache
def load_validation() -> MetricValidation:
    """Return the validation of the metrics of this version."""
    content: Mapping[str, Any] = json.loads(files("evalkit.metrics").joinpath(FILE).read_text(encoding="utf-8"))
    agreement = tuple(
        RankAgreement(
            row["metric"],
            _read_interval(row["overall"]),
            _read_intervals(row["by_perturbation"]),
            _read_intervals(row["by_world"]),
        )
        for row in content["agreement"]
    )
    return MetricValidation(
        content["command"], content["created"], content["versions"], tuple(content["worlds"]), content["mapper"],
        content["map_count"], {name: one["what"] for name, one in content["perturbations"].items()}, agreement,
    )  # fmt: skip


def _read_intervals(content: Mapping[str, Any]) -> dict[str, Interval | None]:
    return {name: _read_interval(one) for name, one in content.items()}


def _read_interval(content: Mapping[str, Any] | None) -> Interval | None:
    return None if content is None else Interval(**content)
