"""The results of a study as tables of numbers; lost runs enter with their bound as value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from evalkit.commands.study.effects import ModelFit
from evalkit.commands.study.plan import Design, Point, Study, format_task_name
from evalkit.core.se2 import Floats
from evalkit.design.responses import Response, bounded_value, find_loss_reason, to_scale
from evalkit.design.run_points import RunScores

WITH_EFFECTS = ("optimal", "fractional")
"""The kinds of design that estimate effects."""


@dataclass(frozen=True, eq=False)
class StudyResult:
    """A study with the results of its tasks by name."""

    study: Study
    results: Mapping[str, RunScores]

    def result(self, key: str, seed: int | None) -> RunScores:
        """The result of one run."""
        return self.results[format_task_name(key, seed)]

    def lost(self, key: str, seed: int | None) -> str:
        """Why a run is lost (it failed, or a response is beyond its bound), or ""."""
        return find_loss_reason(self.result(key, seed), self.study.responses)

    def bounded_value(self, response: Response, key: str, seed: int | None) -> float:
        """A metric's value; the response's bound (nan without one) if the run is lost by it or failed."""
        return bounded_value(self.result(key, seed), response)

    def table(self, design: Design, response: Response) -> Floats:
        """The bounded metric (N, S) of a design's points and seeds."""
        return np.array([self.row(design, response, point) for point in design.points])

    def row(self, design: Design, response: Response, point: Point) -> Floats:
        """The bounded metric (S,) of one point."""
        return np.array([self.bounded_value(response, point.key, seed) for seed in design.runs(point)])

    def counts(self, design: Design) -> tuple[int, int]:
        """The number of a design's lost runs and of all its runs."""
        lost = [self.lost(point.key, seed) for point in design.points for seed in design.runs(point)]
        return sum(map(bool, lost)), len(lost)

    def fit(self, design: Design, response: Response) -> ModelFit | None:
        """Return the effects on a response, None where ``missing_fits`` or a design without a model has none."""
        return self._fit(design, response)[0]

    def fits(self, response: Response) -> list[tuple[Design, ModelFit]]:
        """Return the designs for which effects on a response can be computed, with their fits."""
        return [(design, fit) for design in self.study.designs if (fit := self.fit(design, response)) is not None]

    def missing_fits(self, response: Response) -> list[tuple[Design, str]]:
        """Return the designs with a model whose effects on a response cannot be computed, with the reasons."""
        return [(design, why) for design in self.study.designs if (why := self._fit(design, response)[1])]

    @cache  # noqa: B019 - an outcome lives as long as its page is made
    def _fit(self, design: Design, response: Response) -> tuple[ModelFit | None, str]:
        """The effects (of the logarithm on a log scale) from means over the seeds, or why there are none."""
        if design.kind not in WITH_EFFECTS:
            return None, ""
        values = to_scale(response, self.table(design, response))
        known = np.isfinite(values).any(axis=1)
        means = np.array([row[np.isfinite(row)].mean() for row in values[known]])
        try:
            return ModelFit(design.model, design.positions[known], means), ""
        except ValueError as error:
            return None, f"{known.sum()} of {len(values)} points have a value, and {error}"
