"""Mistakes planted into the path between a sequence and its scores: each must be plain in the numbers of a report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit import metrics
from evalkit.commands.metric_validation import perturbation
from evalkit.commands.metric_validation.map_rebuilding import recording, run_of, scored, true_poses
from evalkit.core import se2
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.run_result import RunResult
from evalkit.core.scan import Frame, Scan
from evalkit.execution.task import AnyTask, make_task
from evalkit.metrics.table import Metric
from evalkit.plugins import registry
from evalkit.plugins.protocols import Sequence

Steps = NDArray[np.void]

GOOD_M = 0.01
"""The run that mistakes are planted into is off by this jitter: as good as anybody's."""

CAUGHT = 2.0
"""A mistake is caught where a metric gets worse by this factor at least."""

MOST = 1000.0
"""A larger factor is told as this one: a share can fall to nothing."""

NO_MISTAKE = "none"


@dataclass(frozen=True)
class Plant:
    """A mistake: what it is, and what it does to the answers or to each frame that is drawn."""

    what: str
    answers: Callable[[Steps], Steps] | None = None
    frame: Callable[[Frame], Frame] | None = None


@dataclass(frozen=True)
class Sighting:
    """A metric that shows a mistake: its value without and with it, and by which factor it got worse."""

    metric: Metric
    without: float
    planted: float
    factor: float


class Tampered:
    """A sequence whose frames somebody has got wrong; its truth is right."""

    def __init__(self, sequence: Sequence, change: Callable[[Frame], Frame]) -> None:
        self._sequence, self._change = sequence, change

    def __len__(self) -> int:
        return len(self._sequence)

    def frames(self) -> Iterator[Frame]:
        """The frames with the mistake."""
        return map(self._change, self._sequence.frames())

    def truth(self) -> Truth:
        """That of the sequence."""
        return self._sequence.truth()

    def notes(self) -> Mapping[str, int]:
        """Those of the sequence."""
        return self._sequence.notes()


def _swapped(steps: Steps) -> Steps:
    turned = steps.copy()
    turned["x"], turned["y"] = steps["y"], steps["x"]
    return turned


def _flipped(steps: Steps) -> Steps:
    turned = steps.copy()
    turned["theta"] = -steps["theta"]
    return turned


def _late(steps: Steps) -> Steps:
    shifted = steps[:-1].copy()
    shifted["stamp_ns"] = steps["stamp_ns"][1:]
    return shifted


def _in_degrees(steps: Steps) -> Steps:
    turned = steps.copy()
    turned["theta"] = se2.wrap(np.degrees(steps["theta"]))
    return turned


def _inverted(steps: Steps) -> Steps:
    turned = steps.copy()
    rows = se2.inverse(np.stack([steps["x"], steps["y"], steps["theta"]], axis=-1))
    turned["x"], turned["y"], turned["theta"] = rows.T
    return turned


def _without_extrinsics(frame: Frame) -> Frame:
    return replace(frame, base_from_sensor=Pose())


def _mirrored(frame: Frame) -> Frame:
    scan = frame.scan
    other = Scan(
        scan.stamp_ns, scan.ranges, -scan.angles, scan.range_min_m, scan.range_max_m, scan.time_increment_ns
    )  # fmt: skip
    return replace(frame, scan=other)


PLANTS: dict[str, Plant] = {
    "axes swapped": Plant("x and y of the answers are exchanged", _swapped),
    "yaw flipped": Plant("the heading of the answers has the wrong sign", _flipped),
    "stamps one scan late": Plant("every answer carries the stamp of the next scan", _late),
    "degrees for radians": Plant("the heading of the answers is in degrees", _in_degrees),
    "pose inverted": Plant("the answers are base_from_start", _inverted),
    "extrinsics dropped": Plant("scans are drawn as if the lidar sat in the base's origin", frame=_without_extrinsics),
    "beams mirrored": Plant("the beams' angles run the wrong way round", frame=_mirrored),
}


def job(plant: str, world: str, seed: int, mapper: str, scans: int) -> AnyTask:
    """The job of one mistake, or of none."""
    plug_ins = (registry.plug_in_of("datasets", world).module, registry.plug_in_of("mappers", mapper).module)
    return make_task(
        f"planted {plant}", planted, plant=plant, world=world, seed=seed, mapper=mapper, scans=scans
    ).depending_on(*plug_ins)


def planted(plant: str, world: str, seed: int, mapper: str, scans: int) -> dict[str, Any]:
    """Every metric of a good run over a world with one mistake planted into it."""
    sequence = recording(world, seed)
    poses = perturbation.jitter(true_poses(sequence), GOOD_M, np.random.default_rng(seed))
    run = run_of(sequence, poses)
    if plant != NO_MISTAKE:
        run, sequence = tampered(run, sequence, PLANTS[plant])
    return {"scores": scored(run, sequence, mapper, scans)}


def tampered(run: RunResult, sequence: Sequence, plant: Plant) -> tuple[RunResult, Sequence]:
    """The run and the sequence that its scoring meets."""
    if plant.answers is not None:
        run = replace(run, steps=plant.answers(run.steps))
    return run, sequence if plant.frame is None else Tampered(sequence, plant.frame)


def sightings(without: Mapping[str, float | None], planted: Mapping[str, float | None]) -> tuple[Sighting, ...]:
    """The metrics that got worse, the worst first; runtime and those without a better direction are not asked."""
    found = []
    for metric in metrics.METRICS:
        before, after = without.get(metric.name), planted.get(metric.name)
        if metric.group != "runtime" and metric.better and before and after is not None:
            factor = _worse(before, after, metric.better == "higher")
            if factor > 1.0:
                found.append(Sighting(metric, before, after, factor))
    return tuple(sorted(found, key=lambda sighting: -sighting.factor))


def _worse(before: float, after: float, higher_is_better: bool) -> float:
    """By which factor a number got worse; differential entropies may be negative: their difference is exponentiated."""
    if before < 0.0 or after < 0.0:
        return float(np.exp(np.clip(before - after if higher_is_better else after - before, None, np.log(MOST))))
    better, worse = (after, before) if higher_is_better else (before, after)
    return min(worse / better, MOST) if better > 0.0 else MOST
