"""Build maps with every variant of the log-odds grid in known worlds and measure their quality."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np

from evalkit.core import se2
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.consistency import collect_hits, map_entropy, wall_thicknesses
from evalkit.metrics.maps import WallDistances, chamfer, compare_walls, f1, iou, nearest_distances_m, precision, recall
from evalkit.metrics.occupancy import log_loss, wall_width_m
from evalkit.metrics.table import PlacedScans, Unmatched
from evalkit.metrics.trajectory import match_trajectories, position_errors, rms
from evalkit.odometry import frontend
from evalkit.odometry.run_odometry import estimate_poses
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value, resolve_parameters

Variant = Mapping[str, Value]
"""Differences from ``DEFAULT``: parameters of the mapper, "scans" and "deskewed"."""

DEFAULT: Variant = {
    "resolution_m": 0.05, "l_occ": 0.847, "l_free": -0.847, "l_min": -5.0, "l_max": 5.0, "once_per_scan": True,
    "traversal": "exact", "clear_no_returns": False, "scans": 250, "deskewed": True,
}  # fmt: skip
THRESHOLDS = (0.5, 0.65, 0.8, 0.9, 0.97, 0.99)
DEFAULT_THRESHOLD = THRESHOLDS.index(0.65)
"""Index of map_server's threshold."""

FINE_M = 0.025
"""Resolution (m) of the true map for the log-loss: not coarser than any map."""

MEASURES = ("f1", "precision", "recall", "chamfer_m", "width_m", "log_loss", "entropy")
DRIFT_MEASURES = ("F1 at 10 cm", "mean distance to wall", "95 % distance to wall", "IoU", "entropy", "wall thickness")
COMPILED = ("embedded-log-odds", "log-odds")
"""The compiled mapper, and the NumPy reference for variants that it does not support."""


@dataclass(frozen=True, eq=False)
class Drive:
    """A sequence with the poses (N, 3) ``world_from_base`` that its maps use."""

    frames: tuple[Frame, ...]
    truth: Truth
    poses: Floats
    ate_m: float

    def select_scans(self, scans: int, deskewed: bool = True) -> PlacedScans:
        """At most ``scans`` evenly spaced scans with sensor poses, deskewed by the poses."""
        chosen = np.unique(np.linspace(0, len(self.frames) - 1, min(scans, len(self.frames))).astype(int))
        return tuple(self._scan_with_pose(int(index), deskewed) for index in chosen)

    def _scan_with_pose(self, index: int, deskewed: bool) -> tuple[Any, Floats]:
        frame = self.frames[index]
        scan = frame.scan.deskewed(frame.base_from_sensor, self._within(index)) if deskewed else frame.scan
        return scan, se2.compose(self.poses[index], frame.base_from_sensor.row)

    def _within(self, index: int) -> Pose:
        first = min(index, len(self.frames) - 2)
        took = self.frames[first + 1].scan.stamp_ns - self.frames[first].scan.stamp_ns
        share = self.frames[index].scan.duration_ns / took
        step = se2.between(self.poses[first], self.poses[first + 1])
        return Pose.of(se2.fraction(step, np.array([share]))[0])

    @cached_property
    def true(self) -> OccupancyGrid:
        """True map at the resolution of the world."""
        if self.truth.grid is None:
            raise ValueError("truth: no map")
        return self.truth.grid


def make_drive(world: str, seed: int, laps: float, poses: str = "true", **sensor: Value) -> Drive:
    """Make a drive through a world at 10 Hz; ``poses``: "true", or "estimated" by the paper's ICP with epsilon 1e-6."""
    sequence = _make_sequence(world, seed=seed, laps=laps, **sensor)
    frames, truth = tuple(sequence.frames()), sequence.truth()
    if truth.trajectory is None:
        raise ValueError(f"{world}: no true trajectory")
    if poses == "true":
        return Drive(frames, truth, truth.trajectory.poses, 0.0)
    found = match_trajectories(_estimate_poses(frames), truth.trajectory)
    if isinstance(found, Unmatched):
        raise ValueError(f"{world}: {found.reason}")
    return Drive(frames, truth, found.estimate, rms(position_errors(found)))


def measure_maps(
    world: str, seed: int, laps: float, poses: str, variants: Sequence[Variant], sensor: Variant | None = None
) -> dict[str, Any]:
    """Measure the maps of all variants: ``MEASURES`` by name (V, T) or, without a threshold, (V,), and "ate_m".

    "mappers": mapper used for each variant. ``sensor``: parameters of the sequence that differ from the defaults.
    """
    sequence = make_drive(world, seed, laps, poses, **(sensor or {}))
    fine = _make_sequence(world, laps=laps, resolution_m=FINE_M).truth().grid
    drawn: dict[tuple[int, bool], PlacedScans] = {}
    rows: dict[str, list[Any]] = {name: [] for name in MEASURES}
    mappers = []
    for variant in variants:
        full = complete(variant)
        place = (int(full["scans"]), bool(full["deskewed"]))
        if place not in drawn:
            drawn[place] = sequence.select_scans(*place)
        name, grid = _build_map(full, drawn[place])
        mappers.append(name)
        by_threshold = np.array([_wall_measures(grid, sequence.true, threshold) for threshold in THRESHOLDS]).T
        for measure, values in zip(MEASURES[:5], by_threshold, strict=True):
            rows[measure].append(values)
        rows["log_loss"].append(log_loss(grid, fine)[0] if fine is not None else np.nan)
        rows["entropy"].append(map_entropy(grid))
    return {name: np.array(values) for name, values in rows.items()} | {"ate_m": sequence.ate_m, "mappers": mappers}


def measure_drift(
    world: str, seed: int, laps: float, metres: Sequence[float], degrees: Sequence[float]
) -> dict[str, Any]:
    """``DRIFT_MEASURES`` (K, 6) of maps whose poses drift evenly, up to each of ``metres`` and of ``degrees``."""
    sequence = make_drive(world, seed, laps)
    middle = np.append(sequence.poses[:, :2].mean(axis=0), 0.0)
    moved = [np.array([metre, 0.0, 0.0]) for metre in metres]
    turned = [se2.compose(se2.compose(middle, [0.0, 0.0, np.radians(d)]), se2.inverse(middle)) for d in degrees]
    return {
        "metres": np.array([_drift_measures(sequence, motion) for motion in moved]),
        "degrees": np.array([_drift_measures(sequence, motion) for motion in turned]),
    }


def render_maps(world: str, seed: int, laps: float, poses: str, variants: Sequence[Variant]) -> dict[str, Any]:
    """Maps of all variants as probabilities in 0..255 ("0", "1", ...), "extents" (V, 4) in m, and the true "walls"."""
    sequence = make_drive(world, seed, laps, poses)
    result: dict[str, Any] = {"walls": sequence.true.centres(sequence.true.occupied()), "ate_m": sequence.ate_m}
    extents = []
    for number, variant in enumerate(variants):
        full = complete(variant)
        _, grid = _build_map(full, sequence.select_scans(int(full["scans"])))
        result[str(number)] = np.round(255.0 * np.where(grid.observed, grid.probability(), 0.5)).astype(np.uint8)
        extents.append(_map_extent(grid))
    return result | {"extents": np.array(extents)}


def compare_mappers(world: str, seed: int, laps: float, variants: Sequence[Variant]) -> dict[str, Any]:
    """Largest difference in log-odds between the maps of compiled mapper and reference, and number of cells."""
    sequence = make_drive(world, seed, laps)
    apart, cells, other = 0.0, 0, 0
    for variant in variants:
        full = complete(variant)
        scans = sequence.select_scans(int(full["scans"]))
        one, two = (_build_map_with(name, full, scans) for name in COMPILED)
        if one.shape != two.shape:
            raise ValueError(f"{variant}: maps of {one.shape} and {two.shape} cells")
        apart = max(apart, float(np.abs(one.log_odds - two.log_odds).max()))
        cells += int(two.observed.sum())
        other += int((one.observed != two.observed).sum())
    return {"log_odds": apart, "cells": cells, "observed by one only": other}


def is_compiled(variant: Variant) -> bool:
    """Whether the compiled mapper supports a variant: cells once per scan, exact traversal."""
    full = complete(variant)
    return bool(full["once_per_scan"]) and full["traversal"] == "exact" and not registry.mapper(COMPILED[0]).missing()


def _make_sequence(world: str, **parameters: Value) -> Any:
    spec = registry.dataset(world)
    return spec.make(**resolve_parameters(world, spec.parameters, {"rate_hz": 10.0, **parameters}))


def _estimate_poses(frames: Iterable[Frame]) -> Trajectory:
    """Poses of ``paper-tight``: by the compiled core, which gives the same, or in NumPy if the core is not built."""
    spec, parameters = registry.backend("embedded"), {"epsilon": 1e-6}
    if spec.missing():
        spec, parameters = registry.backend("paper-tight"), {}
    odometry = frontend.make_odometry(spec, frontend.complete_parameters("paper-tight", spec, parameters))
    known = list(frames)
    return Trajectory(np.array([frame.scan.stamp_ns for frame in known]), estimate_poses(odometry, known))


def _build_map(full: Variant, scans: PlacedScans) -> tuple[str, OccupancyGrid]:
    name = COMPILED[0] if is_compiled(full) else COMPILED[1]
    return name, _build_map_with(name, full, scans)


def _build_map_with(name: str, full: Variant, scans: PlacedScans) -> OccupancyGrid:
    spec = registry.mapper(name)
    known = {parameter.name for parameter in spec.parameters}
    mapper = spec.make(**resolve_parameters(name, spec.parameters, {k: v for k, v in full.items() if k in known}))
    for scan, world_from_sensor in scans:
        mapper.update(scan, Pose.of(world_from_sensor))
    return mapper.grid()


def _wall_measures(grid: OccupancyGrid, true: OccupancyGrid, threshold: float) -> tuple[float, ...]:
    """The first five of ``MEASURES``; zero or nan for a map without walls."""
    mapped, theirs = grid.centres(grid.occupied(threshold)), true.centres(true.occupied())
    if not len(mapped):
        return 0.0, np.nan, 0.0, np.nan, np.nan
    coarser = max(true, grid, key=lambda each: each.resolution_m)
    found = WallDistances(
        mapped, theirs, nearest_distances_m(mapped, theirs), nearest_distances_m(theirs, mapped), coarser
    )
    return f1(found), precision(found), recall(found), chamfer(found), wall_width_m(grid, threshold)


def _drift_measures(sequence: Drive, motion: Floats) -> tuple[float, ...]:
    share = np.linspace(0.0, 1.0, len(sequence.poses))
    poses = se2.compose(se2.fraction(motion, share), sequence.poses)
    scans = Drive(sequence.frames, sequence.truth, poses, 0.0).select_scans(int(DEFAULT["scans"]))
    _, grid = _build_map(DEFAULT, scans)
    found = compare_walls(grid, sequence.true)
    far = float(found.to_true.mean()), float(np.percentile(found.to_true, 95))
    thick = float(wall_thicknesses(collect_hits(scans))[0].mean())
    return f1(found), *far, iou(found), map_entropy(grid), thick


def _map_extent(grid: OccupancyGrid) -> tuple[float, float, float, float]:
    """Left, right, bottom, top (m)."""
    rows, columns = grid.shape
    left, bottom = grid.origin_x, grid.origin_y
    return left, left + columns * grid.resolution_m, bottom, bottom + rows * grid.resolution_m


def complete(variant: Variant) -> dict[str, Value]:
    """Complete a variant with the defaults."""
    return {**DEFAULT, **variant}


@cache
def factors() -> dict[str, tuple[Variant, ...]]:
    """Variants of one factor at a time, in order, including the default."""
    return {
        "resolution": _one_factor("resolution_m", (0.025, 0.05, 0.1, 0.2)),
        "evidence": tuple({"l_occ": v, "l_free": -v} for v in (0.405, 0.847, 1.386, 2.197)),
        "free": _one_factor("l_free", (-0.05, -0.1, -0.2, -0.405, -0.847, -1.386)),
        "bounds": tuple({"l_min": -v, "l_max": v} for v in (2.0, 3.5, 5.0, 7.0, 10.0, 15.0)),
        "scans": _one_factor("scans", (62, 125, 250, 500, 1000)),
        "rule": _one_factor("once_per_scan", (True, False)),
        "traversal": _one_factor("traversal", ("exact", "bresenham")),
        "no return": _one_factor("clear_no_returns", (False, True)),
        "deskew": _one_factor("deskewed", (True, False)),
    }


@cache
def interactions() -> tuple[Variant, ...]:
    """Variants of factors that are likely to interact."""
    rules = [
        {"resolution_m": size, "once_per_scan": once, "traversal": how}
        for size in (0.025, 0.05, 0.1, 0.2)
        for once in (True, False)
        for how in ("exact", "bresenham")
    ]
    weak = [{"resolution_m": size, "l_free": free} for size in (0.025, 0.1) for free in (-0.2, -0.405)]
    many = [{"scans": 1000, "l_free": free} for free in (-0.2, -0.405, -1.386)]
    wide = [{"l_min": -10.0, "l_max": 10.0, "l_free": -0.405}, {"l_occ": 0.405, "l_free": -0.2}]
    return (*rules, *weak, *many, *wide)


def variants(with_interactions: bool) -> tuple[Variant, ...]:
    """All variants of the study once, default first, as differences from it."""
    every = [*(v for own in factors().values() for v in own), *(interactions() if with_interactions else ())]
    found = [departures({})]
    for variant in every:
        if (own := departures(variant)) not in found:
            found.append(own)
    return tuple(found)


def departures(variant: Variant) -> dict[str, Value]:
    """The settings that differ from the default."""
    return {name: value for name, value in variant.items() if value != DEFAULT[name]}


def _one_factor(name: str, values: Sequence[Value]) -> tuple[Variant, ...]:
    return tuple({name: value} for value in values)
