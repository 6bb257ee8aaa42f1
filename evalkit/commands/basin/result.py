"""The result of ``evalkit basin``: one row per back end and scene, as values and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from evalkit.commands.basin.convergence import QUANTILES, Basin, Criterion, SuccessCounts, compute_offsets, make_guesses
from evalkit.commands.basin.observability import Observability, observability
from evalkit.commands.basin.scenes import KnownPair
from evalkit.commands.basin.trials import BasinMethod, TrialAnswers, TrialPlan
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats
from evalkit.io.json_values import replace_non_finite

CELLS = 5
"""Cells along each axis of a map."""

BINS = 8
"""Bins of a curve."""

LEVELS = (0.50, 0.75, 0.95)


@dataclass(frozen=True, eq=False)
class BasinScene:
    """One scene: its trials, its pairs of scans and their observability."""

    trials: TrialPlan
    seen: tuple[KnownPair, ...]
    known: Observability

    @classmethod
    def of(cls, trials: TrialPlan, criterion: Criterion) -> BasinScene:
        """The scene of a plan, reproduced from its seed."""
        seen = trials.pairs_of_scans()
        known = observability([(one.points, one.normals) for one in seen], trials.noise_m, criterion.within_m)
        return cls(trials, seen, known)

    @property
    def what(self) -> str:
        """A description of the scene."""
        return self.trials.what

    def guesses(self) -> Floats:
        """The guesses (N, 3) of all trials, ``target_from_source``."""
        return make_guesses(self.trials.offsets_drawn(), *self.trials.truths(self.seen))


@dataclass(frozen=True, eq=False)
class BasinRow:
    """One back end in one scene; ``basin`` is None if it gave no answer, and ``reason`` explains why."""

    backend: str
    scene: str
    reason: str
    trials: TrialPlan
    outcome: TrialAnswers
    basin: Basin | None

    def _require_basin(self) -> Basin:
        if self.basin is None:
            raise ValueError(f"{self.backend}: has no basin: {self.reason}")
        return self.basin

    def cells(self) -> SuccessCounts:
        """Success over the distance (m) and the turn (rad)."""
        reach_m, reach_rad = self.trials.reach_m, self.trials.reach_rad
        return self._require_basin().by_distance_and_turn(
            np.linspace(0.0, reach_m, CELLS + 1), np.linspace(0.0, reach_rad, CELLS + 1)
        )

    def plane(self) -> SuccessCounts:
        """Success over the offset in x and y (m)."""
        return self._require_basin().by_place(np.linspace(-self.trials.reach_m, self.trials.reach_m, CELLS + 1))

    def along(self) -> SuccessCounts:
        """Success over the distance (m) of guesses that are not turned."""
        return self._require_basin().along(np.linspace(0.0, self.trials.reach_m, BINS + 1))

    def around(self) -> SuccessCounts:
        """Success over the turn (rad) of guesses that are not shifted."""
        return self._require_basin().around(np.linspace(0.0, self.trials.reach_rad, BINS + 1))

    def reach_m(self, level: float) -> float:
        """The largest shift (m) of a guess without turn up to which every bin reaches this share of success."""
        return self.along().reach(level)

    def reach_deg(self, level: float) -> float:
        """The largest turn (deg) of a guess without shift up to which every bin reaches this share of success."""
        return math.degrees(self.around().reach(level))


@dataclass(frozen=True, eq=False)
class BasinResult:
    """The methods, the criterion of success, the scenes, and the rows scene by scene."""

    criterion: Criterion
    scenes: tuple[BasinScene, ...]
    rows: tuple[BasinRow, ...]
    methods: tuple[BasinMethod, ...]

    @property
    def broken(self) -> tuple[BasinRow, ...]:
        """The rows of installed back ends that raised an exception or ended their process."""
        absent = {each.label for each in self.methods if each.reason}
        return tuple(row for row in self.rows if row.reason and row.backend not in absent)

    def at(self, scene: BasinScene) -> tuple[BasinRow, ...]:
        """The rows of one scene."""
        return tuple(row for row in self.rows if row.scene == scene.trials.place)

    def as_json(self) -> dict[str, Any]:
        """The result as JSON values."""
        content: dict[str, Any] = replace_non_finite({
            "schema": {"name": "evalkit-basin", "version": 2},
            "success": {"within_m": self.criterion.within_m, "within_deg": math.degrees(self.criterion.within_rad)},
            "scenes": {scene.trials.place: _scene(scene) for scene in self.scenes},
            "parameters": {each.label: dict(each.values) for each in self.methods},
            "rows": [_row(row) for row in self.rows],
        })  # fmt: skip
        return content


def make_result(
    trials: Sequence[TrialPlan], methods: Sequence[BasinMethod], outcomes: Sequence[TrialAnswers], criterion: Criterion
) -> BasinResult:
    """The result of the answers to all trials."""
    scenes = {one.place: BasinScene.of(one, criterion) for one in trials}
    rows = tuple(_evaluate(outcome, scenes[outcome.trials.place], criterion) for outcome in outcomes)
    return BasinResult(criterion, tuple(scenes.values()), rows, tuple(methods))


def _evaluate(outcome: TrialAnswers, scene: BasinScene, criterion: Criterion) -> BasinRow:
    trials, basin, reason = outcome.trials, None, outcome.reason
    if outcome.answered:
        errors = compute_offsets(outcome.rows, *trials.truths(scene.seen))
        basin = Basin.of(trials.offsets_drawn(), errors, outcome.claimed, scene.known, criterion)
        if outcome.answered < trials.offsets:
            reason = f"no answer to {trials.offsets - outcome.answered} of {trials.offsets}: {reason}"
    return BasinRow(outcome.backend, trials.place, reason, trials, outcome, basin)


def find_answer(row: BasinRow, attempt: int) -> Pose | None:
    """The answer of a back end to one trial, or None."""
    answered = row.outcome.rows[attempt]
    return Pose.of(answered) if np.isfinite(answered).all() else None


def _scene(scene: BasinScene) -> dict[str, Any]:
    known = scene.known
    return vars(scene.trials) | {
        "what": scene.what,
        "pairs": len(scene.seen),
        "open_directions": list(known.names()),
        "lever_m": known.lever_m,
        "information_shares": known.shares.tolist(),
        "best_sigma_m": known.sigma_m.tolist(),
    }


def _row(row: BasinRow) -> dict[str, Any]:
    content: dict[str, Any] = {"backend": row.backend, "scene": row.scene, "reason": row.reason}
    if row.basin is None:
        return content
    share, claimed, accuracy = row.basin.overall(), row.basin.falsely_claimed(), row.basin.accuracy()
    names = [f"A{100 * level:.0f}" for level in QUANTILES]
    return content | {
        "trials": share.support,
        "answered": row.outcome.answered,
        "success": {"share": share.value, "low": share.low, "high": share.high},
        "failures_reported_as_converged": None if claimed is None else claimed.value,
        "reach_m": {f"{level:g}": row.reach_m(level) for level in LEVELS},
        "reach_deg": {f"{level:g}": row.reach_deg(level) for level in LEVELS},
        "error_m": dict(zip(names, accuracy[:, 0].tolist(), strict=True)),
        "error_deg": dict(zip(names, np.degrees(accuracy[:, 1]).tolist(), strict=True)),
        "by_distance_and_turn": _cells(row.cells(), ("distance_m", "turn_rad")),
        "by_x_and_y": _cells(row.plane(), ("x_m", "y_m")),
        "by_distance": _cells(row.along(), ("distance_m",)),
        "by_turn": _cells(row.around(), ("turn_rad",)),
    }


def _cells(shares: SuccessCounts, axes: Sequence[str]) -> dict[str, Any]:
    borders = {name: edges.tolist() for name, edges in zip(axes, shares.edges, strict=True)}
    counts = {"successes": shares.successes.tolist(), "trials": shares.trials.tolist()}
    return borders | counts | {"low": shares.low.tolist(), "high": shares.high.tolist()}
