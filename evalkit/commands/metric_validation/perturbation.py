"""Perturb a true trajectory in a known way and by a known size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats

TURN_PER_M = np.radians(20.0)
"""Rotation jitter per metre of jitter: a centimetre corresponds to a fifth of a degree."""

JUMP_AT = 0.5
GHOST = (0.4, 0.7)
"""Share of the path at the jump, and shares between which the ghost room is displaced."""


@dataclass(frozen=True)
class Perturbation:
    """A perturbation: its description, the unit of its size, and sizes from barely visible to obvious."""

    what: str
    unit: str
    sizes: tuple[float, ...]
    perturb: Callable[[Floats, float, np.random.Generator], Floats]


def drift(poses: Floats, size: float, rng: np.random.Generator) -> Floats:
    """Return poses (N, 3) with a random walk of the heading: ``size`` degrees over a metre, twice that over four."""
    steps = _compute_steps(poses)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    steps[:, 2] += np.radians(size) * np.sqrt(lengths) * rng.standard_normal(len(steps))
    return _compose_steps(poses[0], steps)


def yaw_bias(poses: Floats, size: float, _rng: np.random.Generator) -> Floats:
    """Return poses (N, 3) that turn an additional ``size`` degrees to the left on every metre."""
    steps = _compute_steps(poses)
    steps[:, 2] += np.radians(size) * np.hypot(steps[:, 0], steps[:, 1])
    return _compose_steps(poses[0], steps)


def jitter(poses: Floats, size: float, rng: np.random.Generator) -> Floats:
    """Return poses (N, 3) with independent noise: ``size`` metres (1 sigma, x and y), 20 degrees for a metre."""
    return se2.compose(poses, rng.standard_normal((len(poses), 3)) * [size, size, TURN_PER_M * size])


def scale(poses: Floats, size: float, _rng: np.random.Generator) -> Floats:
    """Return poses (N, 3) with every step ``size`` percent too long."""
    steps = _compute_steps(poses)
    steps[:, :2] *= 1.0 + 0.01 * size
    return _compose_steps(poses[0], steps)


def jump(poses: Floats, size: float, _rng: np.random.Generator) -> Floats:
    """Return poses (N, 3) displaced ``size`` metres to the left from half the path on."""
    return _displace(poses, size, _compute_progress(poses) >= JUMP_AT)


def ghost(poses: Floats, size: float, _rng: np.random.Generator) -> Floats:
    """Return poses (N, 3) displaced ``size`` metres to the left from 40 to 70 % of the path: a ghost room."""
    progress = _compute_progress(poses)
    return _displace(poses, size, (progress >= GHOST[0]) & (progress < GHOST[1]))


_METRES = (0.05, 0.1, 0.2, 0.4, 0.8)

PERTURBATIONS: dict[str, Perturbation] = {
    "drift": Perturbation("random walk of the heading", "deg/sqrt(m)", (0.25, 0.5, 1.0, 2.0, 4.0), drift),
    "yaw bias": Perturbation(
        "a constant additional turn on every metre", "deg/m", (0.05, 0.1, 0.2, 0.5, 1.0), yaw_bias
    ),
    "jitter": Perturbation("independent noise on every pose", "m", (0.01, 0.02, 0.05, 0.1, 0.2), jitter),
    "scale": Perturbation("every step is too long", "%", (0.5, 1.0, 2.0, 5.0, 10.0), scale),
    "jump": Perturbation("one displacement to the side at half the path", "m", _METRES, jump),
    "ghost loop": Perturbation("displaced for a third of the path, then correct again", "m", _METRES, ghost),
}


def _compute_steps(poses: Floats) -> Floats:
    return se2.between(poses[:-1], poses[1:])


def _compose_steps(first: Floats, steps: Floats) -> Floats:
    rows = [first]
    for step in steps:
        rows.append(se2.compose(rows[-1], step))
    return np.array(rows)


def _compute_progress(poses: Floats) -> Floats:
    """Return the share (N,) of the path travelled."""
    lengths = np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1)
    shares = np.concatenate([[0.0], np.cumsum(lengths)]) / max(lengths.sum(), 1e-12)
    return np.asarray(shares + 1e-9)  # sums of steps are not exact


def _displace(poses: Floats, size: float, selected: Bools) -> Floats:
    """Displace the selected poses in the frame of the first of them, so that they stay a rigid copy."""
    moved = np.array(poses)
    if selected.any():
        theta = poses[np.argmax(selected), 2]
        moved[selected, :2] += size * np.array([-np.sin(theta), np.cos(theta)])
    return moved
