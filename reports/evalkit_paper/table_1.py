"""Synthetic validation of the paper (Table 1): scenes, and ICP over many seeds of noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit_baselines.paper.icp import Icp

SIGMA_M = 0.0483
"""Noise of the paper on every coordinate of the scan (1 sigma, m)."""

APPLIED = Pose(4.0, 5.0, math.radians(30.0))
"""``reference_from_scan``: the motion that the paper applies."""

MAX_ITERATIONS = 40
EPSILON = 1e-4
GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class Room:
    """A square room [low, high] x [low, high] (m) with a circle; number of points per side and around the circle."""

    low: float
    high: float
    centre: tuple[float, float]
    radius: float
    per_side: int
    around: int

    def points(self) -> Floats:
        """Reference points (N, 2) in metres, evenly spaced along the walls."""
        along = np.linspace(self.low, self.high, self.per_side, endpoint=False)
        low, high = np.full(self.per_side, self.low), np.full(self.per_side, self.high)
        back = self.low + self.high - along
        angle = np.linspace(0.0, 2.0 * np.pi, self.around, endpoint=False)
        x, y = self.centre
        circle = (x + self.radius * np.cos(angle), y + self.radius * np.sin(angle))
        parts = ((along, low), (high, along), (back, high), (low, back), circle)
        return np.concatenate([np.stack(part, axis=1) for part in parts])

    @property
    def middle(self) -> Floats:
        """Centre (2,) of the square."""
        return np.full(2, 0.5 * (self.low + self.high))

    def describe(self) -> str:
        """Describe the room."""
        x, y = self.centre
        return (
            f"square [{self.low:g}, {self.high:g}]^2 m with {self.per_side} points per side, circle at ({x:g}, {y:g}) "
            f"of radius {self.radius:g} m with {self.around} points"
        )


ROOMS = {
    "first": Room(0.0, 10.0, (2.0, 8.0), 1.5, 70, 200),
    "second": Room(-5.0, 5.0, (-2.0, 3.0), 1.0, 80, 100),
}

READINGS: Mapping[str, Mapping[str, Any]] = {
    "mean distance": {},
    "mean distance, before the step": {"error_at": "before"},
    "root mean square": {"error": "rmse"},
    "mean square (eq. 5 as printed)": {"error": "mean-squared"},
    "mean distance, many-to-one": {"one_to_one": False},
}
"""Readings of the error of Table 1 as parameters of the ICP; computed after the step unless stated."""

AS_PRINTED = next(name for name in READINGS if "eq. 5" in name)

QUANTITIES = ("k", "first error", "last error", "theta [deg]", "x [m]", "y [m]")
PRINTED = (25.0, 2.82559, 0.047363, 29.87, 4.01, 5.02)
"""Table 1 of the paper."""

HALF_DIGIT = (0.0, 5e-6, 5e-7, 5e-3, 5e-3, 5e-3)
"""Rounding error of the printed digits."""

ERRORS = slice(0, 3)
"""The quantities that depend on the definition of the error; the pose is nearly the same for all."""


def make_scan(room: Room, seed: int) -> Floats:
    """Points (N, 2) of the room in the scan frame, with noise."""
    points = room.points()
    noise = np.random.default_rng(seed).normal(0.0, SIGMA_M, points.shape)
    return np.asarray(APPLIED.inverse().transform(points) + noise)


def compute_deviations(rows: Floats) -> Floats:
    """Deviations (6,) of the printed row from the mean of rows (S, 6), in standard deviations beyond its rounding."""
    off = np.abs(np.array(PRINTED) - rows.mean(axis=0)) - HALF_DIGIT
    return np.asarray(np.maximum(off, 0.0) / np.maximum(rows.std(axis=0, ddof=1), 1e-12))


def make_icp(**parameters: Any) -> Icp:
    """The paper's ICP with the stop rule of its validation, without a maximum correspondence distance."""
    given = {"epsilon": EPSILON, "max_iterations": MAX_ITERATIONS, "max_correspondence_m": 0.0}
    return Icp(**{**given, **parameters})


def run_seeds(*, room: str, reading: str, begin: int, end: int) -> dict[str, Any]:
    """Run ICP from the identity for seeds [begin, end).

    "rows" (S, 6) of ``QUANTITIES`` in the reading's unit, "converged" (S,), "errors" (S, 40) by iteration and
    "residuals" (S, N) in m, both padded with nan.
    """
    parameters, where = READINGS[reading], ROOMS[room]
    target = Cloud(where.points())
    registration = make_icp(**parameters, trace=True)
    power = 2 if parameters.get("error") == "mean-squared" else 1
    rows, converged = np.zeros((end - begin, 6)), np.zeros(end - begin, dtype=np.bool_)
    errors = np.full((end - begin, MAX_ITERATIONS), np.nan)
    residuals = np.full((end - begin, len(target)), np.nan)
    for number, seed in enumerate(range(begin, end)):
        source = Cloud(make_scan(where, seed))
        match = registration.register(target, source, Pose())
        errors[number, : match.iterations] = [step.error**power for step in match.history]
        pose = match.target_from_source
        rows[number] = (
            match.iterations, errors[number, 0], match.error**power, math.degrees(pose.theta), pose.x, pose.y
        )  # fmt: skip
        converged[number] = match.converged
        residuals[number, : match.inliers] = _residuals(match, target, source)
    return {"rows": rows, "converged": converged, "errors": errors, "residuals": residuals}


def _residuals(match: Match, target: Cloud, source: Cloud) -> Floats:
    pairs = match.history[-1].pairs
    if pairs is None:
        raise ValueError("pairs: the registration keeps none")
    moved = match.target_from_source.transform(source.points[pairs[:, 0]])
    return np.asarray(np.hypot(*(moved - target.points[pairs[:, 1]]).T))


def measure_extents(*, room: str) -> dict[str, Any]:
    """Extents (m) of the room and of the scan along x and y, without noise."""
    points = ROOMS[room].points()
    return {
        "reference": np.ptp(points, axis=0).tolist(),
        "scan": np.ptp(APPLIED.inverse().transform(points), axis=0).tolist(),
    }


def displaced_guess(room: Room, turn_rad: float, shift: Floats) -> Pose:
    """Guess that rotates the scan about the room's centre and shifts it by (2,) metres from the true pose."""
    x, y = room.middle.tolist()
    moved = Pose(x + float(shift[0]), y + float(shift[1]), turn_rad)
    return moved @ Pose(-x, -y, 0.0) @ APPLIED


def initial_offset(room: Room) -> tuple[float, float]:
    """Distance (m) and angle (deg) of the identity, the paper's guess, from the true pose."""
    moved = APPLIED.inverse().transform(room.middle[None])[0]
    return float(np.hypot(*(moved - room.middle))), abs(math.degrees(APPLIED.theta))


def measure_basin(
    *, room: str, one_to_one: bool, turn_deg: float, distances_m: Sequence[float], seeds: int, within_m: float,
    within_deg: float, max_iterations: int,
) -> dict[str, Any]:  # fmt: skip
    """Count how often ICP reaches the true pose from one rotation and each distance: "successes" (D,) of "trials".

    "misled" and "ran_out" (D,): failures that converged elsewhere, and failures that reached the iteration limit;
    "iterations" (D, S). Each seed has its own noise and bearing (bearings fill the circle evenly); rotations alternate
    in sign.
    """
    where = ROOMS[room]
    target = Cloud(where.points())
    registration = make_icp(one_to_one=one_to_one, max_iterations=max_iterations)
    successes, misled, ran_out = np.zeros((3, len(distances_m)), dtype=np.int64)
    iterations = np.zeros((len(distances_m), seeds), dtype=np.int64)
    for seed in range(seeds):
        source = Cloud(make_scan(where, seed))
        for column, distance in enumerate(distances_m):
            bearing = 2.0 * np.pi * (((seed + 1) * GOLDEN + column / len(distances_m)) % 1.0)
            shift = distance * np.array([math.cos(bearing), math.sin(bearing)])
            turn = math.radians(turn_deg) * (-1.0) ** seed
            match = registration.register(target, source, displaced_guess(where, turn, shift))
            iterations[column, seed] = match.iterations
            if _near(match.target_from_source, where, within_m, math.radians(within_deg)):
                successes[column] += 1
            elif match.converged:
                misled[column] += 1
            else:
                ran_out[column] += 1
    return {
        "successes": successes, "misled": misled, "ran_out": ran_out, "iterations": iterations, "trials": seeds
    }  # fmt: skip


def measure_overlap(*, room: str, overlaps: Sequence[float], limit_m: float, seeds: int) -> dict[str, Any]:
    """Share of successes (K,) where the reference holds only a part of what the scan sees: "plain" and "limited".

    A sector around the room's centre is missing from the reference, in another direction for each seed; the guess is
    0.2 m and 5 deg off. "limited": pairs farther apart than ``limit_m`` are dropped.
    """
    where, rows = ROOMS[room], {}
    points = where.points()
    bearing = np.arctan2(*(points - where.middle).T[::-1])
    for name, limit in (("plain", 0.0), ("limited", limit_m)):
        registration, successes = make_icp(max_correspondence_m=limit, max_iterations=200), np.zeros(len(overlaps))
        for seed in range(seeds):
            around = np.mod(bearing - 2.0 * np.pi * GOLDEN * seed, 2.0 * np.pi)
            shift = 0.2 * np.array([math.cos(seed), math.sin(seed)])
            guess = displaced_guess(where, math.radians(5.0) * (-1.0) ** seed, shift)
            for row, overlap in enumerate(overlaps):
                target = Cloud(points[around <= 2.0 * np.pi * overlap])
                match = registration.register(target, Cloud(make_scan(where, seed)), guess)
                successes[row] += _near(match.target_from_source, where, 0.1, math.radians(2.0))
        rows[name] = successes / seeds
    return rows


def _near(found: Pose, where: Room, within_m: float, within_rad: float) -> bool:
    """Whether a result is within the given distance at the room's centre and the given angle."""
    left = found @ APPLIED.inverse()
    moved = left.transform(where.middle[None])[0] - where.middle
    return bool(np.hypot(*moved) <= within_m and abs(left.theta) <= within_rad)
