"""Responses: the metrics that a study explains or a tuning minimizes, and what a lost run counts for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evalkit.core.se2 import Floats
from evalkit.design.factors import Scale
from evalkit.design.run_points import RunScores
from evalkit.metrics.metric import Metric


@dataclass(frozen=True)
class Response:
    """A metric to study; ``lost``: a run with a worse value, or without a value, is lost and counts with this value.

    ``scale`` "log": effects are ratios.
    """

    metric: Metric
    scale: Scale = "linear"
    lost: float | None = None

    @property
    def name(self) -> str:
        """The metric's name."""
        return self.metric.name

    def worse(self, value: float) -> bool:
        """Whether a value is at or beyond the bound."""
        if self.lost is None:
            return False
        return value <= self.lost if self.metric.better == "higher" else value >= self.lost


def find_loss_reason(result: RunScores, responses: Sequence[Response]) -> str:
    """Why a run is lost (it failed, or a response is beyond its bound), or ""."""
    if result["status"] != "complete":
        return f"{result['status']}: {result['reason']}"
    for response in responses:
        value = result["scores"][response.name]
        if response.lost is not None and value is None:
            return f"no {response.metric.label}: {result['why'][response.name]}"
        if value is not None and response.worse(value):
            return f"{response.metric.label} {value:.3g} {response.metric.unit}".rstrip()
    return ""


def bounded_value(result: RunScores, response: Response) -> float:
    """A response's value; its bound (nan without one) if the run failed, has no value or is beyond the bound."""
    value = result["scores"][response.name]
    if value is None or result["status"] != "complete" or response.worse(value):
        return np.nan if response.lost is None else response.lost
    return value


def to_scale(response: Response, values: Floats) -> Floats:
    """Values on a response's scale: natural logarithms on a log scale, nan where there is none."""
    if response.scale == "linear":
        return values
    return np.log(values, out=np.full_like(values, np.nan), where=values > 0.0)
