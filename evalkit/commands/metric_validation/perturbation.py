"""Spoils a true trajectory in a known way and by a known size: what a metric without a truth must be able to see."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats

TURN_PER_M = np.radians(20.0)
"""Jitter of a centimetre comes with a fifth of a degree."""

JUMP_AT = 0.5
GHOST = (0.4, 0.7)
"""Shares of the path at which the estimate jumps, and between which it stands aside."""


@dataclass(frozen=True)
class Way:
    """A way to go wrong: what it does, the unit of its size, and sizes from hardly there to plain."""

    what: str
    unit: str
    sizes: tuple[float, ...]
    spoil: Callable[[Floats, float, np.random.Generator], Floats]


def drift(poses: Floats, size: float, rng: np.random.Generator) -> Floats:
    """Poses (N, 3) whose heading walks at random: ``size`` degrees over a metre, twice that over four."""
    steps = _steps(poses)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    steps[:, 2] += np.radians(size) * np.sqrt(lengths) * rng.standard_normal(len(steps))
    return _chained(poses[0], steps)


def yaw_bias(poses: Floats, size: float, _rng: np.random.Generator) -> Floats:
    """Poses (N, 3) that turn ``size`` degrees too far to the left on every metre."""
    steps = _steps(poses)
    steps[:, 2] += np.radians(size) * np.hypot(steps[:, 0], steps[:, 1])
    return _chained(poses[0], steps)


def jitter(poses: Floats, size: float, rng: np.random.Generator) -> Floats:
    """Poses (N, 3) each off by noise of its own: ``size`` metres (1 sigma, x and y), 20 degrees for a metre."""
    return se2.compose(poses, rng.standard_normal((len(poses), 3)) * [size, size, TURN_PER_M * size])


def scale(poses: Floats, size: float, _rng: np.random.Generator) -> Floats:
    """Poses (N, 3) whose every step is ``size`` per cent too long."""
    steps = _steps(poses)
    steps[:, :2] *= 1.0 + 0.01 * size
    return _chained(poses[0], steps)


def jump(poses: Floats, size: float, _rng: np.random.Generator) -> Floats:
    """Poses (N, 3) that slip ``size`` metres to the left at half the path and stay there."""
    return _aside(poses, size, _progress(poses) >= JUMP_AT)


def ghost(poses: Floats, size: float, _rng: np.random.Generator) -> Floats:
    """Poses (N, 3) that stand ``size`` metres aside from 40 to 70 % of the path, and are right again: a ghost room."""
    progress = _progress(poses)
    return _aside(poses, size, (progress >= GHOST[0]) & (progress < GHOST[1]))


_METRES = (0.05, 0.1, 0.2, 0.4, 0.8)

WAYS: dict[str, Way] = {
    "drift": Way("the heading walks at random", "deg/sqrt(m)", (0.25, 0.5, 1.0, 2.0, 4.0), drift),
    "yaw bias": Way("a constant turn too far on every metre", "deg/m", (0.05, 0.1, 0.2, 0.5, 1.0), yaw_bias),
    "jitter": Way("every pose has noise of its own", "m", (0.01, 0.02, 0.05, 0.1, 0.2), jitter),
    "scale": Way("every step is too long", "%", (0.5, 1.0, 2.0, 5.0, 10.0), scale),
    "jump": Way("one slip to the side at half the path", "m", _METRES, jump),
    "ghost loop": Way("aside for a third of the path, then right again", "m", _METRES, ghost),
}


def _steps(poses: Floats) -> Floats:
    return se2.between(poses[:-1], poses[1:])


def _chained(first: Floats, steps: Floats) -> Floats:
    rows = [first]
    for step in steps:
        rows.append(se2.compose(rows[-1], step))
    return np.array(rows)


def _progress(poses: Floats) -> Floats:
    """Share (N,) of the path gone."""
    lengths = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    gone = np.concatenate([[0.0], np.cumsum(lengths)]) / max(lengths.sum(), 1e-12)
    return np.asarray(gone + 1e-9)  # sums of steps are not exact


def _aside(poses: Floats, size: float, which: Bools) -> Floats:
    """In the frame of the first of them, so that what stands aside is a rigid copy."""
    moved = np.array(poses)
    if which.any():
        theta = poses[np.argmax(which), 2]
        moved[which, :2] += size * np.array([-np.sin(theta), np.cos(theta)])
    return moved
