"""How far each map metric without a truth can be trusted: measured once, shipped, and shown beside its numbers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from evalkit.stats.intervals import Interval

FILE = "validated.json"


@dataclass(frozen=True)
class Trust:
    """How one metric ranked maps as their true error did: Spearman's correlation in all, by way, by world."""

    metric: str
    overall: Interval | None
    by_way: Mapping[str, Interval | None]
    by_world: Mapping[str, Interval | None]


@dataclass(frozen=True)
class Validation:
    """A measurement of trust: how it was made, the ways in which trajectories were spoiled, and every metric's trust.

    ``ways``: what each does, in words. ``maps``: how many were made.
    """

    command: str
    made: str
    versions: Mapping[str, str]
    worlds: tuple[str, ...]
    mapper: str
    maps: int
    ways: Mapping[str, str]
    trust: tuple[Trust, ...]

    def of(self, metric: str) -> Trust | None:
        """The trust in one metric; None where it was not measured."""
        return next((each for each in self.trust if each.metric == metric), None)


@cache
def shipped() -> Validation:
    """What ``make metric-validation`` found for the metrics of this version."""
    return of(json.loads(files("evalkit.metrics").joinpath(FILE).read_text(encoding="utf-8")))


def of(content: Mapping[str, Any]) -> Validation:
    """The measurement in the JSON form that the command writes."""
    trust = tuple(
        Trust(row["metric"], _interval(row["overall"]), _intervals(row["by_way"]), _intervals(row["by_world"]))
        for row in content["trust"]
    )
    return Validation(
        content["command"], content["made"], content["versions"], tuple(content["worlds"]), content["mapper"],
        len(content["rows"]), {way: told["what"] for way, told in content["ways"].items()}, trust,
    )  # fmt: skip


def _intervals(found: Mapping[str, Any]) -> dict[str, Interval | None]:
    return {name: _interval(one) for name, one in found.items()}


def _interval(found: Mapping[str, Any] | None) -> Interval | None:
    return None if found is None else Interval(**found)
