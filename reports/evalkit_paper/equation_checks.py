"""Compute the effect of each of the paper's equations as printed beside the corrected one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame, Scan
from evalkit.core.se2 import Floats
from evalkit.plugins import registry
from evalkit.plugins.protocols import Sequence
from evalkit_baselines.paper import icp
from evalkit_baselines.paper.association import Association
from evalkit_baselines.paper.grid import LogOddsGrid
from evalkit_baselines.paper.icp import Icp
from evalkit_paper import stage_errors, table_1
from evalkit_paper.map_faults import look_up
from evalkit_paper.table_1 import ROOMS

Rotation = Callable[[Floats], Floats]
"""From K (2, 2) of equation 3 to a rotation (2, 2)."""

WELL_OFF_M = 0.05
WELL_OFF_DEG = 2.0
"""Offset of the guess on scans in the comparison of stop rules."""


def rotation_as_printed(K: Floats) -> Floats:
    """Equation 4 as printed: R = U V^T of K = U S V^T."""
    U, _, Vt = np.linalg.svd(K)
    return np.asarray(U @ Vt)


def rotation_without_guard(K: Floats) -> Floats:
    """R = V U^T: correct orientation, but possibly a reflection (negative determinant)."""
    U, _, Vt = np.linalg.svd(K)
    return np.asarray(Vt.T @ U.T)


def rotation_with_guard(K: Floats) -> Floats:
    """R = V diag(1, det(V U^T)) U^T: never a reflection."""
    U, _, Vt = np.linalg.svd(K)
    return np.asarray(Vt.T @ np.diag([1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T)


def icp_with_rotation(target: Floats, source: Floats, rotation: Rotation, iterations: int) -> tuple[Floats, Floats]:
    """ICP with a given rotation formula: mean distances (I,) after each step, and the homogeneous motion (3, 3)."""
    tree, moved, motion, errors = cKDTree(target), source.copy(), np.eye(3), []
    for _ in range(iterations):
        distance, nearest = map(np.asarray, tree.query(moved))
        at = icp.select_closest(nearest.astype(np.int64), distance, len(target))
        p, q = moved[at], target[nearest[at]]
        R = rotation((p - p.mean(axis=0)).T @ (q - q.mean(axis=0)))
        t = q.mean(axis=0) - R @ p.mean(axis=0)
        moved = moved @ R.T + t
        step = np.eye(3)
        step[:2, :2], step[:2, 2] = R, t
        motion = step @ motion
        errors.append(float(np.hypot(*(moved[at] - q).T).mean()))
    return np.array(errors), motion


def check_transpose(*, seeds: int) -> dict[str, Any]:
    """Equation 4 as printed and corrected on Table 1's scene: mean distances (S, 40) "printed" and "correct".

    "printed_reached" and "correct_reached": number of seeds that end within 0.1 m and 2 deg of the true motion.
    """
    room = ROOMS["first"]
    found: dict[str, Any] = {}
    for name, rotation in (("printed", rotation_as_printed), ("correct", rotation_with_guard)):
        errors, reached = [], 0
        for seed in range(seeds):
            profile, motion = icp_with_rotation(
                room.points(), table_1.make_scan(room, seed), rotation, table_1.MAX_ITERATIONS
            )
            metres, degrees = _distance_and_angle(Pose.of(se2.from_matrix(motion)), table_1.APPLIED)
            reached += metres < 0.1 and degrees < 2.0
            errors.append(profile)
        found |= {name: np.array(errors), f"{name}_reached": reached}
    return {**found, "seeds": seeds}


def check_mirrored_walls(*, walls: int, points: int = 50, noise_m: float = table_1.SIGMA_M) -> dict[str, Any]:
    """Count single walls (3 m, measured twice with noise) that are mirrored, without and with the guard.

    "worst_m": largest displacement of a point 1 m in front of the wall; "exact_determinant": for a wall without noise.
    """
    rng, counts, worst_m = np.random.default_rng(0), {"unguarded": 0, "guarded": 0}, 0.0
    along = np.linspace(-1.5, 1.5, points)
    wall = np.stack([along, np.zeros(points)], axis=1)
    for _ in range(walls):
        source, target = (wall + rng.normal(0.0, noise_m, wall.shape) for _ in range(2))
        K = (source - source.mean(axis=0)).T @ (target - target.mean(axis=0))
        for name, rotation in (("unguarded", rotation_without_guard), ("guarded", rotation_with_guard)):
            R = rotation(K)
            if np.linalg.det(R) < 0.0:
                counts[name] += 1
                worst_m = max(worst_m, float(np.hypot(*(R @ [0.0, 1.0] - [0.0, 1.0]))))
    exact = float(np.linalg.det(rotation_without_guard(wall.T @ wall)))
    return {**counts, "walls": walls, "worst_m": worst_m, "exact_determinant": exact}


STOP_RULES: Mapping[str, Mapping[str, Any]] = {
    "printed": {"error": "mean-squared"},
    "mean": {},
    "tight": {"epsilon": 1e-6},
}
"""Mean squared with 1e-4 m^2, mean distance with 1e-4 m, mean distance with 1e-6 m."""


def compare_stop_rules(*, sequence: str, seed: int, laps: float, most: int, guess: str) -> dict[str, Any]:
    """Compare three stop rules on successive simulated scans, from the odometry's guess ("odometry") or a worse one
    ("off").

    "rules": for each rule the lists "iterations", "error_m" and "error_deg" (against ground truth), "first_square" and
    "last_square" (m^2, of the pairs after the first and the last step). "guess_m" and "guess_deg": errors of the
    guesses.
    """
    drive = _make_drive(sequence, seed, laps)
    frames, truth = list(drive.frames())[: most + 1], stage_errors.true_trajectory(drive).poses[: most + 1]
    sensors = [Pose.of(pose) @ frame.base_from_sensor for pose, frame in zip(truth, frames, strict=True)]
    clouds = [Cloud(frame.scan.points()) for frame in frames]
    rng = np.random.default_rng(seed)
    rules = {name: Icp(**parameters) for name, parameters in STOP_RULES.items()}
    found: dict[str, list[list[float]]] = {name: [] for name in rules}
    offs = []
    for first in range(len(frames) - 1):
        true = sensors[first].inverse() @ sensors[first + 1]
        start = _odometry_motion(*frames[first : first + 2]) if guess == "odometry" else true @ _random_offset(rng)
        offs.append(_distance_and_angle(start, true))
        for name, rule in rules.items():
            match = rule.register(clouds[first], clouds[first + 1], start)
            squares = match.history[0].error ** 2, match.error**2
            found[name].append([match.iterations, *_distance_and_angle(match.target_from_source, true), *squares])
    keys = ("iterations", "error_m", "error_deg", "first_square", "last_square")
    listed = {name: dict(zip(keys, np.array(rows).T.tolist(), strict=True)) for name, rows in found.items()}
    far, turned = np.array(offs).T.tolist()
    return {"rules": listed, "pairs": len(offs), "guess_m": far, "guess_deg": turned}


def _random_offset(rng: np.random.Generator) -> Pose:
    bearing, side = rng.uniform(0.0, 2.0 * np.pi), rng.choice([-1.0, 1.0])
    shift = WELL_OFF_M * np.array([math.cos(bearing), math.sin(bearing)])
    return Pose(float(shift[0]), float(shift[1]), math.radians(WELL_OFF_DEG) * float(side))


def _odometry_motion(first: Frame, second: Frame) -> Pose:
    """``first_from_second`` of the sensor from wheel odometry."""
    if first.odom_from_base is None or second.odom_from_base is None:
        raise ValueError("odometry: the sequence has none")
    between = first.odom_from_base.inverse() @ second.odom_from_base
    return first.base_from_sensor.inverse() @ between @ second.base_from_sensor


def _distance_and_angle(found: Pose, true: Pose) -> tuple[float, float]:
    """Distance (m) and angle (deg) between two poses."""
    left = true.inverse() @ found
    return math.hypot(left.x, left.y), abs(math.degrees(left.theta))


def measure_table_errors(*, seeds: int) -> dict[str, Any]:
    """Table 1 with the error computed "after" the step, "before" it, and as the mean "square" of equation 5.

    Of each the rows (S, 6) of ``table_1.QUANTITIES``, and under "NAME sigmas" the deviations (6,) of the printed row.
    """
    readings = {"after": "mean distance", "before": "mean distance, before the step", "square": table_1.AS_PRINTED}
    rows = {
        name: table_1.run_seeds(room="first", reading=reading, begin=0, end=seeds)["rows"]
        for name, reading in readings.items()
    }
    return rows | {f"{name} sigmas": table_1.compute_deviations(found) for name, found in rows.items()}


def check_composition(*, sequence: str, seed: int, laps: float) -> dict[str, Any]:
    """Compose the exact body-frame steps of a short drive on the left (eq. 9) and on the right.

    "true", "left" and "right": positions (N, 2); "left_error_m" and "right_error_m": errors at the end; "turned_deg":
    largest change of heading from the start.
    """
    drive = _make_drive(sequence, seed, laps)
    truth = stage_errors.true_trajectory(drive).poses
    path = se2.between(truth[:1], truth)
    body_steps = se2.between(path[:-1], path[1:])
    left, right = [path[0]], [path[0]]
    for step in body_steps:
        left.append(se2.compose(step, left[-1]))
        right.append(se2.compose(right[-1], step))
    ends = {name: np.array(poses) for name, poses in (("left", left), ("right", right))}
    return {
        "true": path[:, :2].copy(),
        **{name: poses[:, :2].copy() for name, poses in ends.items()},
        **{f"{name}_error_m": float(np.hypot(*(poses[-1] - path[-1])[:2])) for name, poses in ends.items()},
        "turned_deg": float(np.degrees(np.abs(se2.wrap(path[:, 2])).max())),
        "path_m": float(np.hypot(*np.diff(path[:, :2], axis=0).T).sum()),
    }


def check_free_space(*, sequence: str, seed: int, laps: float, every: int) -> dict[str, Any]:
    """Map with true poses and the printed update, which adds l_free = ln(0.3 / 0.7).

    "wrong": share of truly free cells that are occupied on the map; "cells": number of truly free cells.
    """
    drive = _make_drive(sequence, seed, laps)
    mapper = LogOddsGrid()
    for frame, pose in list(zip(drive.frames(), stage_errors.true_trajectory(drive).poses, strict=True))[::every]:
        mapper.update(frame.scan, Pose.of(pose) @ frame.base_from_sensor)
    grid = mapper.grid()
    free = _find_truly_free(drive, grid)
    return {"wrong": float(grid.occupied()[free].mean()), "cells": int(free.sum())}


def check_formulas(*, count: int) -> dict[str, Any]:
    """Largest differences between this software and each formula written out, over ``count`` random values."""
    rng = np.random.default_rng(0)
    return {
        "extrinsics": max(_check_extrinsics(rng) for _ in range(count)),
        "nearest": max(_check_nearest(rng) for _ in range(count)),
        "alignment": max(_check_alignment(rng) for _ in range(count)),
        "matrix": max(_check_matrix(rng) for _ in range(count)),
        "heading": _check_heading(count),
        "logistic": max(_check_logistic(beams) for beams in range(1, 9)),
        "count": count,
    }


def _check_extrinsics(rng: np.random.Generator) -> float:
    """Equation 1, R_l [r cos phi, r sin phi] + t_l, for one beam (m)."""
    r, phi, (x, y, turn) = rng.uniform(0.2, 12.0), rng.uniform(-np.pi, np.pi), rng.normal(size=3)
    scan = Scan(0, np.array([r]), np.array([phi]), 0.0, 20.0)
    found = Pose(x, y, turn).transform(scan.points())[0]
    plain = (x + r * math.cos(phi + turn), y + r * math.sin(phi + turn))
    return float(np.abs(found - plain).max())


def _check_nearest(rng: np.random.Generator) -> float:
    """Equation 2 against every distance (m)."""
    target, source = rng.normal(size=(30, 2)), rng.normal(size=(20, 2))
    _, distance = Association(cKDTree(target), len(source)).find(source)
    every = np.hypot(*(source[:, None] - target[None]).T).min(axis=0)
    return float(np.abs(distance - every).max())


def _check_alignment(rng: np.random.Generator) -> float:
    """Equation 3, K as a sum over the pairs, with the corrected rotation: motion (m, rad) of ``icp.fit_motion``."""
    source = rng.normal(size=(10, 2))
    target = Pose(*rng.normal(size=3)).transform(source) + rng.normal(0.0, 0.01, source.shape)
    p_bar, q_bar = source.mean(axis=0), target.mean(axis=0)
    K = sum((np.outer(p - p_bar, q - q_bar) for p, q in zip(source, target, strict=True)), np.zeros((2, 2)))
    R = rotation_with_guard(K)
    plain = [*(q_bar - R @ p_bar), math.atan2(R[1, 0], R[0, 0])]
    return float(np.abs(se2.between(np.array(plain), icp.fit_motion(source, target))).max())


def _check_matrix(rng: np.random.Generator) -> float:
    """The homogeneous matrix between equations 4 and 9: T [p, 1] against R p + t (m), and its position."""
    pose, point = rng.normal(size=3), rng.normal(size=2)
    T = se2.to_matrix(pose)
    turned = [math.cos(pose[2]) * point[0] - math.sin(pose[2]) * point[1],
              math.sin(pose[2]) * point[0] + math.cos(pose[2]) * point[1]]  # fmt: skip
    moved = float(np.abs((T @ [*point, 1.0])[:2] - turned - pose[:2]).max())
    return max(moved, float(np.abs(se2.from_matrix(T) - pose)[:2].max()))


def _check_heading(count: int) -> float:
    """Equation 7, atan2(r21, r11), over ``count`` headings (rad)."""
    rows = np.zeros((count, 3))
    rows[:, 2] = np.linspace(-np.pi, np.pi, count, endpoint=False)
    found = se2.from_matrix(se2.to_matrix(rows))[:, 2]
    return float(np.abs(se2.wrap(found - rows[:, 2])).max())


def _check_logistic(beams: int) -> float:
    """Equation 11: probabilities of a cell that ``beams`` scans hit, and of one that they cross, by Bayes' rule."""
    mapper = LogOddsGrid(l_min=-20.0, l_max=20.0)
    for _ in range(beams):
        mapper.update(Scan(0, np.array([1.02]), np.zeros(1), 0.0, 20.0), Pose(0.025, 0.025, 0.0))
    grid = mapper.grid()
    hit, crossed = (float(grid.probability()[0, column]) for column in (-1, 0))
    odds = math.exp(mapper.l_occ) ** beams, math.exp(mapper.l_free) ** beams
    return max(abs(hit - odds[0] / (1.0 + odds[0])), abs(crossed - odds[1] / (1.0 + odds[1])))


def count_shared_targets(*, seeds: int) -> dict[str, Any]:
    """First association on Table 1's scene with and without the one-to-one filter, means over seeds.

    "points": points of the scan; "pairs_all" and "targets_all": pairs without the filter and reference points they use;
    "pairs_one" and "targets_one": the same with the filter.
    """
    room, counts = ROOMS["first"], {}
    target = Cloud(room.points())
    for name, one_to_one in (("all", False), ("one", True)):
        registration = table_1.make_icp(one_to_one=one_to_one, trace=True, max_iterations=1)
        first = [
            registration.register(target, Cloud(table_1.make_scan(room, s)), Pose()).history[0] for s in range(seeds)
        ]
        pairs = [step.pairs for step in first if step.pairs is not None]
        counts[f"pairs_{name}"] = float(np.mean([len(rows) for rows in pairs]))
        counts[f"targets_{name}"] = float(np.mean([len(np.unique(rows[:, 1])) for rows in pairs]))
    return {**counts, "points": len(target)}


def _make_drive(sequence: str, seed: int, laps: float) -> Sequence:
    return registry.dataset(sequence).make(seed=seed, laps=laps)


def _find_truly_free(drive: Sequence, like: OccupancyGrid) -> Bools:
    """Observed cells (H, W) of a map whose centres are free on the true map."""
    true = drive.truth().grid
    if true is None:
        raise ValueError("truth: the sequence has no true map")
    marked = np.zeros(like.shape, dtype=np.bool_)
    marked[like.observed] = look_up(true.free(), true, like.centres(like.observed))
    return marked
