"""Inject known faults between a sequence and its scores; the metrics must detect each of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit import metrics
from evalkit.commands.metric_validation import perturbation
from evalkit.commands.metric_validation.map_rebuilding import (
    compute_values,
    find_plugin_modules,
    find_true_poses,
    load_world,
    make_run,
)
from evalkit.core import se2
from evalkit.core.pose import Pose
from evalkit.core.run_result import RunResult
from evalkit.core.scan import Frame, Scan
from evalkit.core.se2 import Floats
from evalkit.execution.task import AnyTask, make_task
from evalkit.metrics.metric import Metric
from evalkit.plugins.changed_sequence import ChangedSequence
from evalkit.plugins.protocols import Sequence

StepRows = NDArray[np.void]

JITTER_M = 0.01
"""Jitter of the poses of the run without a fault, a typical error of a good method."""

MIN_FACTOR = 2.0
"""A fault is detected by a metric that gets worse by at least this factor."""

MAX_FACTOR = 1000.0
"""Larger factors are limited to this one: a share can fall to 0."""

NO_FAULT = "none"


@dataclass(frozen=True)
class Fault:
    """A fault: its description, and its effect on the steps of a run or on each frame."""

    what: str
    change_steps: Callable[[StepRows], StepRows] | None = None
    change_frame: Callable[[int, Frame], Frame] | None = None


@dataclass(frozen=True)
class Detection:
    """A metric that got worse by a fault: its values without and with the fault, and the factor."""

    metric: Metric
    without: float
    with_fault: float
    factor: float


def _shift_stamps(steps: StepRows) -> StepRows:
    shifted = steps[:-1].copy()
    shifted["stamp_ns"] = steps["stamp_ns"][1:]
    return shifted


def _change_poses(change: Callable[[Floats], Floats]) -> Callable[[StepRows], StepRows]:
    """Return a fault of the poses (N, 3) as a function of the steps."""

    def change_steps(steps: StepRows) -> StepRows:
        changed = steps.copy()
        poses = np.stack([steps["x"], steps["y"], steps["theta"]], axis=-1)
        changed["x"], changed["y"], changed["theta"] = change(poses).T
        return changed

    return change_steps


def _convert_to_degrees(poses: Floats) -> Floats:
    return np.column_stack([poses[:, :2], se2.wrap(np.degrees(poses[:, 2]))])


def _drop_extrinsics(_index: int, frame: Frame) -> Frame:
    return replace(frame, base_from_sensor=Pose())


def _mirror_beams(_index: int, frame: Frame) -> Frame:
    scan = frame.scan
    other = Scan(
        scan.stamp_ns, scan.ranges, -scan.angles, scan.range_min_m, scan.range_max_m, scan.time_increment_ns
    )  # fmt: skip
    return replace(frame, scan=other)


FAULTS: dict[str, Fault] = {
    "axes swapped": Fault("x and y of the poses are exchanged", _change_poses(lambda poses: poses[:, [1, 0, 2]])),
    "yaw flipped": Fault(
        "the heading of the poses has the wrong sign", _change_poses(lambda poses: poses * [1, 1, -1])
    ),
    "stamps one scan late": Fault("every pose has the stamp of the next scan", _shift_stamps),
    "degrees for radians": Fault("the heading of the poses is in degrees", _change_poses(_convert_to_degrees)),
    "pose inverted": Fault("the poses are base_from_start", _change_poses(se2.inverse)),
    "extrinsics dropped": Fault(
        "scans are mapped with the lidar at the origin of the base", change_frame=_drop_extrinsics
    ),
    "beams mirrored": Fault("the angles of the beams have the wrong sign", change_frame=_mirror_beams),
}


def make_fault_task(fault: str, world: str, seed: int, mapper: str, scans: int) -> AnyTask:
    """Return the task of one fault, or of the run without a fault."""
    return make_task(
        f"fault {fault}", score_with_fault, fault=fault, world=world, seed=seed, mapper=mapper, scans=scans
    ).depending_on(*find_plugin_modules(world, mapper))


def score_with_fault(fault: str, world: str, seed: int, mapper: str, scans: int) -> dict[str, Any]:
    """Compute all metrics of a good run with one injected fault: ``scores``."""
    sequence = load_world(world, seed)
    poses = perturbation.jitter(find_true_poses(sequence), JITTER_M, np.random.default_rng(seed))
    run = make_run(sequence, poses)
    if fault != NO_FAULT:
        run, sequence = inject_fault(run, sequence, FAULTS[fault])
    return {"scores": compute_values(run, sequence, mapper, scans)}


def inject_fault(run: RunResult, sequence: Sequence, fault: Fault) -> tuple[RunResult, Sequence]:
    """Return the run and the sequence with a fault."""
    if fault.change_steps is not None:
        run = replace(run, steps=fault.change_steps(run.steps))
    return run, sequence if fault.change_frame is None else ChangedSequence(sequence, fault.change_frame)


def compare_scores(
    without: Mapping[str, float | None], with_fault: Mapping[str, float | None]
) -> tuple[Detection, ...]:
    """Return the metrics that got worse, the worst first.

    Runtime and metrics without a better direction are excluded.
    """
    detections = []
    for metric in metrics.METRICS:
        before, after = without.get(metric.name), with_fault.get(metric.name)
        if metric.group != "runtime" and metric.better and before and after is not None:
            factor = _compute_factor(before, after, metric.better == "higher")
            if factor > 1.0:
                detections.append(Detection(metric, before, after, factor))
    return tuple(sorted(detections, key=lambda one: -one.factor))


def _compute_factor(before: float, after: float, higher_is_better: bool) -> float:
    """Return the factor by which a value got worse; differences of negative values (entropies) are exponentiated."""
    if before < 0.0 or after < 0.0:
        return float(np.exp(np.clip(before - after if higher_is_better else after - before, None, np.log(MAX_FACTOR))))
    better, worse = (after, before) if higher_is_better else (before, after)
    return min(worse / better, MAX_FACTOR) if better > 0.0 else MAX_FACTOR
