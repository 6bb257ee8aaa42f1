"""Generate the points of a design, as positions and as levels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from evalkit.config.forms import MAX_POINTS
from evalkit.core.errors import BadParameter
from evalkit.core.se2 import Floats
from evalkit.design.designs import Model, make_fractional, make_grid, make_optimal, make_space_filling
from evalkit.design.factors import Factor, FactorLevel

LevelsByFactor = Mapping[str, FactorLevel]
"""A point's levels by factor."""


def sample(
    kind: str, factors: Sequence[Factor], points: int, resolution: int, seed: int
) -> tuple[Floats, list[LevelsByFactor]]:
    """Positions (N, K) and levels of a design's points; curves have levels only.

    Raises BadParameter with the key whose value the design cannot have.
    """
    if kind == "curves":
        return np.zeros((0, len(factors))), [{f.name: level} for f in factors for level in f.levels]
    if kind in ("sobol", "latin"):
        shares = make_space_filling(len(factors), points, np.random.default_rng(seed), kind)
        return _interpolate_levels(factors, shares)
    levels = [len(factor.levels) for factor in factors]
    if kind == "grid":
        if math.prod(levels) > MAX_POINTS:
            raise BadParameter(
                "a grid", "factors", math.prod(levels), f"at most {MAX_POINTS} points; take another kind"
            )
        positions = make_grid(levels)
    elif kind == "fractional":
        if not 3 <= resolution <= 5:
            raise BadParameter("a fractional design", "resolution", resolution, "3, 4 or 5")
        positions = make_fractional(len(factors), resolution) * (np.array(levels) - 1)
    else:
        model = Model(tuple(factor.axis for factor in factors))
        if points <= len(model.terms):
            raise BadParameter(
                "an optimal design", "points", points, f"more than {len(model.terms)}, the columns of its model"
            )
        positions = make_optimal(model, points, np.random.default_rng(seed))
    rows: list[LevelsByFactor] = [
        {f.name: f.levels[at] for f, at in zip(factors, row, strict=True)} for row in positions.tolist()
    ]
    return positions.astype(np.float64), rows


def _interpolate_levels(factors: Sequence[Factor], shares: Floats) -> tuple[Floats, list[LevelsByFactor]]:
    """Positions and levels at shares (N, K) of the way from the first level of each factor to the last."""
    rows = [[factor.at(float(share)) for factor, share in zip(factors, row, strict=True)] for row in shares]
    positions = np.array([[position for _, position in row] for row in rows])
    return positions, [{f.name: level for f, (level, _) in zip(factors, row, strict=True)} for row in rows]
