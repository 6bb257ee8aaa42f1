"""A finished run made numbers: aligned with the truth, mapped by the common mapper, scored by every metric."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from evalkit import metrics, se2
from evalkit.metrics.table import Evidence, Mapped, Matched
from evalkit.metrics.trajectory import errors_m, match
from evalkit.protocols import Mapper, Sequence
from evalkit.se2 import Floats
from evalkit.types import Frame, OccupancyGrid, Pose, Run, Score, Trajectory


@dataclass(frozen=True, eq=False)
class Scored:
    """What scoring makes of a run. ``world_from_start``: alignment used for errors, maps and drawings."""

    scores: dict[str, Score]
    world_from_start: Pose
    grid: OccupancyGrid | None
    errors_m: Floats | None


def score(run: Run, sequence: Sequence, make_mapper: Callable[[], Mapper], scans: int) -> Scored:
    """The scores, the map and the error over time of a run, failed runs as far as they came."""
    truth = sequence.truth()
    matched = match(run.estimate, truth.trajectory) if truth.trajectory is not None else None
    world_from_start = matched.world_from_start if isinstance(matched, Matched) else Pose()
    world_from_base = run.estimate.moved(world_from_start, "world")
    mapped = _mapped(sequence, world_from_base, scans)
    middle = len(mapped) // 2
    evidence = Evidence(
        run,
        truth,
        matched,
        draw(mapped, make_mapper),
        mapped,
        first_half=draw(mapped[:middle], make_mapper),
        second_half=draw(mapped[middle:], make_mapper),
    )
    errors = None if truth.trajectory is None else errors_m(world_from_base, truth.trajectory)
    return Scored(metrics.score(evidence, metrics.all_metrics()), world_from_start, evidence.grid, errors)


def draw(mapped: Mapped, make_mapper: Callable[[], Mapper]) -> OccupancyGrid | None:
    """The map of scans with known sensor poses; None of none."""
    if not mapped:
        return None
    mapper = make_mapper()
    for scan, world_from_sensor in mapped:
        mapper.update(scan, Pose.of(world_from_sensor))
    return mapper.grid()


def _mapped(sequence: Sequence, world_from_base: Trajectory, most: int) -> Mapped:
    """At most that many scans, evenly spaced, the same for every contestant, with where the sensor was.

    The motion within a scan is undone by the estimate's own speed, whatever the back end did with it.
    """
    count = len(world_from_base)
    if count == 0:
        return ()
    chosen = set(np.unique(np.linspace(0, count - 1, min(most, count)).astype(int)).tolist())
    last = max(chosen)
    mapped = []
    for index, frame in enumerate(sequence.frames()):
        if index in chosen:
            scan = frame.scan.deskewed(frame.base_from_sensor, _within(frame, world_from_base, index))
            mapped.append((scan, se2.compose(world_from_base.poses[index], frame.base_from_sensor.row)))
        if index == last:
            break
    return tuple(mapped)


def _within(frame: Frame, world_from_base: Trajectory, index: int) -> Pose | None:
    """``start_from_end`` of one scan by the estimate: the step to the next scan (or from the one before), in part."""
    if frame.scan.duration_ns == 0 or len(world_from_base) < 2:
        return None
    first = min(index, len(world_from_base) - 2)
    step = se2.between(world_from_base.poses[first], world_from_base.poses[first + 1])
    elapsed = int(world_from_base.stamps_ns[first + 1] - world_from_base.stamps_ns[first])
    share = min(frame.scan.duration_ns / elapsed, 1.0)
    return Pose.of(se2.fraction(step, np.array([share]))[0])
