"""A finished run made numbers: aligned with the truth, mapped by the common mapper, scored by every metric."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from evalkit import metrics
from evalkit.core import se2
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.run_result import RunResult, Scores
from evalkit.core.scan import Frame
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.table import NO_POSES, Evidence, MatchedPoses, MissingMap, PlacedScan, PlacedScans
from evalkit.metrics.trajectory import compute_errors_m, match_trajectories
from evalkit.plugins.protocols import Mapper, Sequence

MAX_PAIRS = 100
"""So many pairs of successive scans are kept for the metrics that look from one scan to the next."""


def score(run: RunResult, sequence: Sequence, make_mapper: Callable[[], Mapper], scans: int) -> Scores:
    """The scores, the map and the error over time of a run, failed runs as far as they came."""
    evidence = with_map(without_map(run, sequence), sequence, make_mapper, scans)
    world_from_start = _world_from_start(evidence)
    true = evidence.truth.trajectory
    errors = None if true is None else compute_errors_m(run.estimate.moved(world_from_start, "world"), true)
    scores = metrics.compute_scores(evidence, metrics.all_metrics())
    grid = None if isinstance(evidence.grid, MissingMap) else evidence.grid
    return Scores(scores, world_from_start, _describe_alignment(evidence), grid, errors)


def without_map(run: RunResult, sequence: Sequence) -> Evidence:
    """What a run shows without its scans looked at again: enough for drift and runtime."""
    truth = sequence.truth()
    return Evidence(run, truth, match_trajectories(run.estimate, truth.trajectory))


def with_map(
    evidence: Evidence, sequence: Sequence, make_mapper: Callable[[], Mapper], scans: int, halves: bool = True
) -> Evidence:
    """The same with its map; ``halves``: with those of its two halves too, which some consistency metrics compare."""
    world_from_base = evidence.run.estimate.moved(_world_from_start(evidence), "world")
    mapped, successive = _placed(sequence, world_from_base, scans)
    with_grid = replace(evidence, grid=render_map(mapped, make_mapper), mapped=mapped, successive=successive)
    if not halves:
        return with_grid
    middle = len(mapped) // 2
    first, second = render_map(mapped[:middle], make_mapper), render_map(mapped[middle:], make_mapper)
    return replace(with_grid, first_half=first, second_half=second)


def render_map(mapped: PlacedScans, make_mapper: Callable[[], Mapper]) -> OccupancyGrid | MissingMap:
    """Return the map of scans with known sensor poses.

    A map may be impossible, for example because a diverged trajectory exceeds its largest size; the other scores of the
    run are computed nevertheless.
    """
    if not mapped:
        return MissingMap(NO_POSES)
    mapper = make_mapper()
    try:
        for scan, world_from_sensor in mapped:
            mapper.update(scan, Pose.of(world_from_sensor))
        return mapper.grid()
    except Exception as error:  # noqa: BLE001 - a mapper is third-party code
        return MissingMap(f"the mapper failed ({error})")


def _world_from_start(evidence: Evidence) -> Pose:
    return evidence.matched.world_from_start if isinstance(evidence.matched, MatchedPoses) else Pose()


def _describe_alignment(evidence: Evidence) -> str:
    matched = evidence.matched
    if isinstance(matched, MatchedPoses):
        return f"{matched.alignment} over {len(matched.stamps_ns):,} poses; {matched.rule}"
    return "" if evidence.truth.trajectory is None else matched.reason


def _placed(
    sequence: Sequence, world_from_base: Trajectory, most: int
) -> tuple[PlacedScans, tuple[tuple[PlacedScan, PlacedScan], ...]]:
    """At most that many scans and at most ``MAX_PAIRS`` pairs of successive ones, with where the sensor was.

    Both are evenly spaced over the whole sequence, the same for every method; what a run has not answered is
    missing. The motion within a scan is undone by the estimate's own speed, whatever the back end did with it.
    """
    expected = len(sequence)
    chosen, earlier = _evenly(expected, most), _evenly(expected - 1, MAX_PAIRS)
    wanted = {*chosen, *earlier, *(index + 1 for index in earlier)}
    placed: dict[int, PlacedScan] = {}
    for index, frame in enumerate(sequence.frames()):
        if index > max(wanted, default=-1):
            break
        row = _row_at(world_from_base, frame.scan.stamp_ns) if index in wanted else None
        if row is not None:
            scan = frame.scan.deskewed(frame.base_from_sensor, _within(frame, world_from_base, row))
            placed[index] = scan, se2.compose(world_from_base.poses[row], frame.base_from_sensor.row)
    pairs = ((index, index + 1) for index in earlier if index in placed and index + 1 in placed)
    return tuple(placed[i] for i in chosen if i in placed), tuple((placed[i], placed[j]) for i, j in pairs)


def _row_at(trajectory: Trajectory, stamp_ns: int) -> int | None:
    """Which pose is of that very time; None where there is none."""
    row = int(np.searchsorted(trajectory.stamps_ns, stamp_ns))
    return row if row < len(trajectory) and trajectory.stamps_ns[row] == stamp_ns else None


def _evenly(count: int, most: int) -> list[int]:
    """At most that many of the indices of ``count`` things, first and last among them, in order."""
    return [int(i) for i in np.unique(np.linspace(0, count - 1, min(most, count)).astype(int))] if count > 0 else []


def _within(frame: Frame, world_from_base: Trajectory, index: int) -> Pose | None:
    """``start_from_end`` of one scan by the estimate: the step to the next scan (or from the one before), in part."""
    if frame.scan.duration_ns == 0 or len(world_from_base) < 2:
        return None
    first = min(index, len(world_from_base) - 2)
    step = se2.between(world_from_base.poses[first], world_from_base.poses[first + 1])
    elapsed = int(world_from_base.stamps_ns[first + 1] - world_from_base.stamps_ns[first])
    share = min(frame.scan.duration_ns / elapsed, 1.0)
    return Pose.of(se2.fraction(step, np.array([share]))[0])
