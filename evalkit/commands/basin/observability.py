"""Observability of a pose: the information in the walls of a scene, by direction."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats


@dataclass(frozen=True, eq=False)
class Observability:
    """The directions of a motion by how well the walls determine them, worst first.

    Coordinates are x (m), y (m) and ``lever_m`` times the turn (rad), along the world's axes, about the sensor.
    ``directions`` (3, 3): unit vectors as columns. ``shares`` (3,): the eigenvalues of the point-to-line Hessian for
    each point: 0 if no wall stands across, at most 1. ``sigma_m`` (3,): the smallest standard deviation an unbiased
    answer can have (Cramer and Rao) if all points have the noise across their walls, inf if unobservable; an error of
    the range counts less there where a beam meets its wall at an angle. ``is_open`` (3,): not determined within the
    tolerance.
    """

    lever_m: float
    directions: Floats
    shares: Floats
    sigma_m: Floats
    is_open: Bools

    def names(self) -> tuple[str, ...]:
        """The open directions in words."""
        return tuple(name_direction(direction) for direction in self.directions.T[self.is_open])

    def observable(self, motions: Floats) -> Floats:
        """Small motions (N, 3) of x, y (m), theta (rad) without their components along open directions."""
        scale = np.array([1.0, 1.0, self.lever_m])
        lost = self.directions[:, self.is_open]
        scaled = motions * scale
        return np.asarray((scaled - scaled @ lost @ lost.T) / scale)


def observability(places: Iterable[tuple[Floats, Floats]], noise_m: float, within_m: float) -> Observability:
    """Observability from the points and unit normals (N, 2) of scans, by the Hessian of the distance to lines.

    Both scans of a pair have an error of ``noise_m`` (m) across their walls. A direction is open if twice the
    best possible standard deviation is more than ``within_m``.
    """
    known = list(places)
    points = np.concatenate([one for one, _ in known])
    normals = np.concatenate([one for _, one in known])
    lever_m = float(np.sqrt(np.mean(np.sum(points * points, axis=1))))
    turn = (points[:, 0] * normals[:, 1] - points[:, 1] * normals[:, 0]) / lever_m
    jacobian = np.column_stack([normals, turn])
    shares, directions = np.linalg.eigh(jacobian.T @ jacobian / len(points))
    shares = np.where(shares < 1e-9, 0.0, shares)
    with np.errstate(divide="ignore"):
        sigma_m = math.sqrt(2.0) * noise_m / np.sqrt(shares * len(points) / len(known))
    sigma_m = np.where(shares == 0.0, np.inf, sigma_m)  # also where there is no noise
    return Observability(lever_m, directions, shares, sigma_m, 2.0 * sigma_m > within_m)


def name_direction(direction: Floats) -> str:
    """A unit vector of x, y and scaled turn in words.

    >>> name_direction(np.array([0.0, -1.0, 0.0]))
    'shift along 90 deg'
    """
    x, y, turn = direction
    shift = math.hypot(x, y)
    along = f"shift along {math.degrees(math.atan2(y, x)) % 180.0:.0f} deg"
    if abs(turn) < 0.2:
        return along
    return "turn" if shift < 0.2 else f"{along} with a turn"
