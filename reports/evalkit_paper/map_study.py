"""Results of the map study: measures of all map variants on all drives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.se2 import Floats
from evalkit_paper import map_measurements
from evalkit_paper.map_measurements import DEFAULT_THRESHOLD, Variant
from evalkit_paper.map_recommendation import Recommendation, recommend

POSES = ("true", "estimated")
"""Kinds of poses that maps are drawn at."""

WORDS: Mapping[str, str] = {
    "resolution_m": "cells {:g} m", "l_occ": "l_occ {:g}", "l_free": "l_free {:g}", "l_min": "l_min {:g}",
    "l_max": "l_max {:g}", "scans": "{} scans", "traversal": "{}",
}  # fmt: skip
FLAGS: Mapping[str, str] = {
    "once_per_scan": "every beam counts", "clear_no_returns": "no-returns clear", "deskewed": "motion in the scan kept",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class MapStudy:
    """``results[u]`` is the result of ``map_measurements.measure_maps`` for drive ``units[u]`` (world, seed, poses)."""

    variants: tuple[Variant, ...]
    units: tuple[tuple[str, int, str], ...]
    results: Sequence[Mapping[str, Any]]

    @cached_property
    def _f1(self) -> Floats:
        return np.asarray(np.stack([result["f1"] for result in self.results], axis=-1))  # (V, T, U)

    @property
    def mappers(self) -> list[str]:
        """Mapper used for each variant."""
        return list(self.results[0]["mappers"])

    def f1(self, number: int, threshold: int | None = None) -> Floats:
        """F1 of a variant over the drives (U,), or at all thresholds (T, U)."""
        return np.asarray(self._f1[number] if threshold is None else self._f1[number, threshold])

    def mean(self, measure: str, number: int, threshold: int | None = None) -> float:
        """Mean of a measure of a variant over the drives; nan if no map has a value."""
        values = np.array([result[measure][number] for result in self.results], dtype=np.float64)
        chosen = values if threshold is None else values[:, threshold]
        return float(np.nanmean(chosen)) if np.isfinite(chosen).any() else float("nan")

    def number(self, variant: Variant) -> int:
        """Index of a variant. Raises KeyError if it was not measured."""
        try:
            return self.variants.index(map_measurements.departures(variant))
        except ValueError:
            raise KeyError(describe_variant(variant)) from None

    def sequences(self) -> list[tuple[str, str]]:
        """All pairs of world and kind of poses."""
        return list(dict.fromkeys((world, poses) for world, _, poses in self.units))

    def drives_of(self, world: str, poses: str) -> list[int]:
        """Indices of the drives of a world with a kind of poses."""
        return [u for u, (own, _, kind) in enumerate(self.units) if (own, kind) == (world, poses)]

    def ate_m(self) -> dict[str, list[float]]:
        """ATE (m) of the estimated poses, by world."""
        found: dict[str, list[float]] = {}
        for (world, _, poses), result in zip(self.units, self.results, strict=True):
            if poses == "estimated":
                found.setdefault(world, []).append(float(result["ate_m"]))
        return found

    def mapper_settings(self) -> list[int]:
        """Indices of the variants that differ only in settings of the mapper."""
        return [n for n, variant in enumerate(self.variants) if not {"scans", "deskewed"} & set(variant)]

    def choice(self, own: Sequence[int], seeds: Sequence[int]) -> Recommendation:
        """Apply the recommendation rule to some variants, on the drives with the given seeds."""
        drives = [u for u, (_, seed, _) in enumerate(self.units) if seed in seeds]
        loss = np.array([[self.results[u]["log_loss"][n] for u in drives] for n in own])
        peers = [own.index(self._reference_variant(n)) for n in own]
        counts: Ints = np.array([_count_departures(self.variants[n]) for n in own])
        return recommend(
            self._f1[np.ix_(own, range(self._f1.shape[1]), drives)], loss, np.array(peers), counts, DEFAULT_THRESHOLD
        )

    def seed_means(self, number: int, threshold: int, held_out: int) -> tuple[float, float]:
        """Mean F1 over the drives used for the choice, and over those of the held-out seed (the same for seed 0)."""
        last = np.array([seed == held_out for _, seed, _ in self.units])
        values = self.f1(number, threshold)
        seen = values[~last] if (~last).any() else values
        return float(seen.mean()), float(values[last].mean())

    def _reference_variant(self, number: int) -> int:
        return self.number({name: v for name, v in self.variants[number].items() if name == "resolution_m"})


def factor_variants(study: MapStudy, factor: str) -> list[int]:
    """Indices of the variants of one factor, in order."""
    return [study.number(variant) for variant in map_measurements.factors()[factor]]


def describe_variant(variant: Variant) -> str:
    """Describe how a variant differs from the paper's settings."""
    own = map_measurements.departures(variant)
    words = [FLAGS[name] if name in FLAGS else WORDS[name].format(value) for name, value in own.items()]
    return ", ".join(words) or "paper's settings"


def format_change(ratio: float) -> str:
    """Format a ratio as a change in percent."""
    return f"{100.0 * (ratio - 1.0):+.0f} %"


def _count_departures(variant: Variant) -> int:
    names = {"bounds" if name in ("l_min", "l_max") else name for name in map_measurements.departures(variant)}
    return len(names)
