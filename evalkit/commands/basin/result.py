"""What ``evalkit basin`` found: one row a back end and scene, as values and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from evalkit.commands.basin.convergence import QUANTILES, Basin, Criterion, Shares, guesses, off
from evalkit.commands.basin.observability import Observability, observability
from evalkit.commands.basin.scenes import Seen
from evalkit.commands.basin.trials import Entrant, Outcome, Trials
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats

CELLS = 5
"""Cells along each axis of a map."""

BINS = 8
"""Bins of a curve."""

LEVELS = (0.50, 0.75, 0.95)


@dataclass(frozen=True, eq=False)
class Scene:
    """One place as all back ends saw it: its trials, pairs of scans and what they can tell."""

    trials: Trials
    seen: tuple[Seen, ...]
    known: Observability

    @classmethod
    def of(cls, trials: Trials, criterion: Criterion) -> Scene:
        """The scene of trials, made again from their seed."""
        seen = trials.seen()
        known = observability([(one.points, one.normals) for one in seen], trials.noise_m, criterion.within_m)
        return cls(trials, seen, known)

    @property
    def what(self) -> str:
        """The place in words."""
        return self.trials.what

    def guesses(self) -> Floats:
        """Where every attempt (N, 3) starts: ``target_from_source``."""
        return guesses(self.trials.drawn(), *self.trials.truths(self.seen))


@dataclass(frozen=True, eq=False)
class Row:
    """One back end at one scene; ``basin`` None where it gave no answer at all, and ``reason`` says why."""

    backend: str
    scene: str
    reason: str
    trials: Trials
    outcome: Outcome
    basin: Basin | None

    def _known(self) -> Basin:
        if self.basin is None:
            raise ValueError(f"{self.backend}: has no basin: {self.reason}")
        return self.basin

    def cells(self) -> Shares:
        """Success over the distance (m) and the turn (rad)."""
        reach_m, reach_rad = self.trials.reach_m, self.trials.reach_rad
        return self._known().by_distance_and_turn(
            np.linspace(0.0, reach_m, CELLS + 1), np.linspace(0.0, reach_rad, CELLS + 1)
        )

    def plane(self) -> Shares:
        """Success over the offset in x and y (m)."""
        return self._known().by_place(np.linspace(-self.trials.reach_m, self.trials.reach_m, CELLS + 1))

    def along(self) -> Shares:
        """Success over the distance (m) of guesses that are not turned."""
        return self._known().along(np.linspace(0.0, self.trials.reach_m, BINS + 1))

    def around(self) -> Shares:
        """Success over the turn (rad) of guesses that are not shifted."""
        return self._known().around(np.linspace(0.0, self.trials.reach_rad, BINS + 1))

    def reach_m(self, level: float) -> float:
        """How far off (m) a guess that is not turned may be for this share of success."""
        return self.along().reach(level)

    def reach_deg(self, level: float) -> float:
        """How far turned (deg) a guess that is not shifted may be for this share of success."""
        return math.degrees(self.around().reach(level))


@dataclass(frozen=True, eq=False)
class Result:
    """All of it: what was asked, what counts as success, the scenes and the rows, scene by scene."""

    criterion: Criterion
    scenes: tuple[Scene, ...]
    rows: tuple[Row, ...]
    entrants: tuple[Entrant, ...]

    @property
    def broken(self) -> tuple[Row, ...]:
        """The rows of back ends that could be asked and raised or ended their process."""
        absent = {each.label for each in self.entrants if each.reason}
        return tuple(row for row in self.rows if row.reason and row.backend not in absent)

    def at(self, scene: Scene) -> tuple[Row, ...]:
        """The rows of one scene."""
        return tuple(row for row in self.rows if row.scene == scene.trials.place)

    def as_json(self) -> dict[str, Any]:
        """All of it in numbers, texts, lists and dictionaries."""
        return {
            "schema": {"name": "evalkit-basin", "version": 1},
            "success": {"within_m": self.criterion.within_m, "within_deg": math.degrees(self.criterion.within_rad)},
            "scenes": {scene.trials.place: _scene(scene) for scene in self.scenes},
            "parameters": {each.label: dict(each.values) for each in self.entrants},
            "rows": [_row(row) for row in self.rows],
        }


def result(
    trials: Sequence[Trials], entrants: Sequence[Entrant], outcomes: Sequence[Outcome], criterion: Criterion
) -> Result:
    """The result of the outcomes of all trials."""
    scenes = {one.place: Scene.of(one, criterion) for one in trials}
    rows = tuple(_judged(outcome, scenes[outcome.trials.place], criterion) for outcome in outcomes)
    return Result(criterion, tuple(scenes.values()), rows, tuple(entrants))


def _judged(outcome: Outcome, scene: Scene, criterion: Criterion) -> Row:
    trials, basin, reason = outcome.trials, None, outcome.reason
    if outcome.answered:
        errors = off(outcome.rows, *trials.truths(scene.seen))
        basin = Basin.of(trials.drawn(), errors, outcome.claimed, scene.known, criterion)
        if outcome.answered < trials.offsets:
            reason = f"no answer to {trials.offsets - outcome.answered} of {trials.offsets}: {reason}"
    return Row(outcome.backend, trials.place, reason, trials, outcome, basin)


def answer(row: Row, attempt: int) -> Pose | None:
    """What a back end answered to one attempt."""
    found = row.outcome.rows[attempt]
    return Pose.of(found) if np.isfinite(found).all() else None


def _scene(scene: Scene) -> dict[str, Any]:
    known = scene.known
    return vars(scene.trials) | {
        "what": scene.what,
        "pairs": len(scene.seen),
        "open_directions": list(known.names()),
        "lever_m": known.lever_m,
        "information_shares": known.shares.tolist(),
        "best_sigma_m": [value if math.isfinite(value) else None for value in known.sigma_m.tolist()],
    }


def _row(row: Row) -> dict[str, Any]:
    told: dict[str, Any] = {"backend": row.backend, "scene": row.scene, "reason": row.reason}
    if row.basin is None:
        return told
    share, claimed, accuracy = row.basin.overall(), row.basin.falsely_claimed(), row.basin.accuracy()
    names = [f"A{100 * level:.0f}" for level in QUANTILES]
    return told | {
        "attempts": share.support,
        "answered": row.outcome.answered,
        "success": {"share": share.value, "low": share.low, "high": share.high},
        "failures_told_as_converged": None if claimed is None else claimed.value,
        "reach_m": {f"{level:g}": row.reach_m(level) for level in LEVELS},
        "reach_deg": {f"{level:g}": row.reach_deg(level) for level in LEVELS},
        "error_m": {name: _finite(value) for name, value in zip(names, accuracy[:, 0], strict=True)},
        "error_deg": {name: _finite(math.degrees(value)) for name, value in zip(names, accuracy[:, 1], strict=True)},
        "by_distance_and_turn": _cells(row.cells(), ("distance_m", "turn_rad")),
        "by_x_and_y": _cells(row.plane(), ("x_m", "y_m")),
        "by_distance": _cells(row.along(), ("distance_m",)),
        "by_turn": _cells(row.around(), ("turn_rad",)),
    }


def _cells(shares: Shares, axes: Sequence[str]) -> dict[str, Any]:
    borders = {name: edges.tolist() for name, edges in zip(axes, shares.edges, strict=True)}
    counts = {"successes": shares.successes.tolist(), "trials": shares.trials.tolist()}
    return borders | counts | {"low": _finite_all(shares.low), "high": _finite_all(shares.high)}


def _finite_all(values: Floats) -> Any:
    return [_finite_all(value) for value in values] if values.ndim else _finite(float(values))


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
