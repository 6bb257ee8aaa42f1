"""Evaluate a finished run: align it with the truth, build its map, and compute every metric."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from evalkit import metrics
from evalkit.core import se2
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.run_result import RunResult, Score, Scores
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.table import NO_POSES, Evidence, MatchedPoses, MissingMap, PlacedScan, PlacedScans, Unmatched
from evalkit.metrics.track import find_lost_track
from evalkit.metrics.trajectory import compute_errors_m, match_trajectories
from evalkit.plugins.protocols import Mapper, Sequence

MAX_PAIRS = 100
"""Maximum number of pairs of successive scans that are kept for metrics of scan-to-scan motion."""

OF_THE_MAP_ALONE = ("occupied_percent", "corners", "enclosed_areas", "enclosed_m2", "wall_width_m")
"""Consistency metrics that need neither scans nor probabilities; most metrics against the true map need neither."""

OF_PROBABILITIES = ("map_entropy", "map_log_loss", "map_ssim")
"""Metrics that need cell probabilities, which a map file does not hold."""

NO_TRAJECTORY = "no trajectory: the back end is a map made elsewhere"
NO_PROBABILITIES = "a map file holds occupied, free and unknown cells without probabilities"
MAP_ALIGNMENT = "the frame of the map is that of its file and settings"


def evaluate_run(result: RunResult, sequence: Sequence, make_mapper: Callable[[], Mapper], scans: int) -> Scores:
    """The scores, the map and the errors of a run; a failed run is evaluated up to its last answer.

    ``scans``: maximum number of scans in the map.
    """
    evidence = add_map(collect_evidence(result, sequence), sequence, make_mapper, scans)
    world_from_start = _find_world_from_start(evidence)
    true = evidence.truth.trajectory
    errors = None if true is None else compute_errors_m(result.estimate.moved(world_from_start, "world"), true)
    scores = metrics.compute_scores(evidence, metrics.all_metrics())
    grid = None if isinstance(evidence.grid, MissingMap) else evidence.grid
    lost = find_lost_track(evidence, sequence.frames)
    return Scores(scores, world_from_start, _describe_alignment(evidence), grid, errors, lost)


def evaluate_map(result: RunResult, grid: OccupancyGrid, sequence: Sequence) -> Scores:
    """The scores of a map without a trajectory, given in the frame of the world."""
    evidence = Evidence(result, sequence.truth(), Unmatched(NO_TRAJECTORY), grid)
    table = metrics.all_metrics()
    against_truth = [one for one in table if one.group == "map against truth" and one.name not in OF_PROBABILITIES]
    meaningful = [*against_truth, *(one for one in table if one.name in OF_THE_MAP_ALONE)]
    scores = {one.name: Score(None, 0, NO_TRAJECTORY) for one in table}
    scores |= metrics.compute_scores(evidence, meaningful)
    for name in OF_PROBABILITIES:
        scores[name] = replace(scores[name], reason=NO_PROBABILITIES)
    return Scores(scores, Pose(), MAP_ALIGNMENT, grid)


def collect_evidence(result: RunResult, sequence: Sequence) -> Evidence:
    """The evidence of a run without its scans and map: enough for drift and runtime."""
    truth = sequence.truth()
    return Evidence(result, truth, match_trajectories(result.estimate, truth.trajectory))


def add_map(
    evidence: Evidence, sequence: Sequence, make_mapper: Callable[[], Mapper], scans: int, halves: bool = True
) -> Evidence:
    """The evidence with scans and map. ``halves``: also the maps of both halves, for some consistency metrics."""
    world_from_base = evidence.run.estimate.moved(_find_world_from_start(evidence), "world")
    mapped, successive, odometry = _place_scans(sequence, world_from_base, scans)
    grid = render_map(mapped, make_mapper)
    with_grid = replace(evidence, grid=grid, mapped=mapped, successive=successive, odometry=odometry)
    if not halves:
        return with_grid
    middle = len(mapped) // 2
    first, second = render_map(mapped[:middle], make_mapper), render_map(mapped[middle:], make_mapper)
    return replace(with_grid, first_half=first, second_half=second)


def render_map(mapped: PlacedScans, make_mapper: Callable[[], Mapper]) -> OccupancyGrid | MissingMap:
    """Return the map of scans with known sensor poses.

    A map may be impossible, for example because a diverged trajectory exceeds its largest size; the other scores of the
    run are still computed.
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


def _find_world_from_start(evidence: Evidence) -> Pose:
    return evidence.matched.world_from_start if isinstance(evidence.matched, MatchedPoses) else Pose()


def _describe_alignment(evidence: Evidence) -> str:
    matched = evidence.matched
    if isinstance(matched, MatchedPoses):
        return f"{matched.alignment} over {len(matched.stamps_ns):,} poses; {matched.rule}"
    return "" if evidence.truth.trajectory is None else matched.reason


def _place_scans(
    sequence: Sequence, world_from_base: Trajectory, most: int
) -> tuple[PlacedScans, tuple[tuple[PlacedScan, PlacedScan], ...], Trajectory | None]:
    """At most ``most`` scans and ``MAX_PAIRS`` pairs of successive scans, with their poses ``world_from_sensor``.

    Both are evenly spaced over the whole sequence, the same for every method; scans without an answer are left out.
    Scans are deskewed with the speed of the estimate, whatever the back end did. Also returns the wheel odometry.
    """
    expected = len(sequence)
    chosen, earlier = _choose_evenly(expected, most), _choose_evenly(expected - 1, MAX_PAIRS)
    wanted = {*chosen, *earlier, *(index + 1 for index in earlier)}
    placed: dict[int, PlacedScan] = {}
    odometry: dict[int, Floats] = {}
    for index, frame in enumerate(sequence.frames()):
        if index > max(wanted, default=-1):
            break
        if frame.odom_from_base is not None:
            odometry[frame.scan.stamp_ns] = frame.odom_from_base.row
        row = _find_row(world_from_base, frame.scan.stamp_ns) if index in wanted else None
        if row is not None:
            scan = frame.scan.deskewed(frame.base_from_sensor, _motion_within_scan(frame, world_from_base, row))
            placed[index] = scan, se2.compose(world_from_base.poses[row], frame.base_from_sensor.row)
    pairs = ((index, index + 1) for index in earlier if index in placed and index + 1 in placed)
    wheels = Trajectory(np.array(list(odometry)), np.array(list(odometry.values())), "odom") if odometry else None
    return tuple(placed[i] for i in chosen if i in placed), tuple((placed[i], placed[j]) for i, j in pairs), wheels


def _find_row(trajectory: Trajectory, stamp_ns: int) -> int | None:
    """The row of the pose with exactly this stamp; None where there is none."""
    row = int(np.searchsorted(trajectory.stamps_ns, stamp_ns))
    return row if row < len(trajectory) and trajectory.stamps_ns[row] == stamp_ns else None


def _choose_evenly(count: int, most: int) -> list[int]:
    """At most ``most`` of the indices 0..count-1 in order, first and last included."""
    return [int(i) for i in np.unique(np.linspace(0, count - 1, min(most, count)).astype(int))] if count > 0 else []


def _motion_within_scan(frame: Frame, world_from_base: Trajectory, index: int) -> Pose | None:
    """``start_from_end`` of one scan: its share of the estimated step to the next scan (or from the last one)."""
    if frame.scan.duration_ns == 0 or len(world_from_base) < 2:
        return None
    first = min(index, len(world_from_base) - 2)
    step = se2.between(world_from_base.poses[first], world_from_base.poses[first + 1])
    elapsed = int(world_from_base.stamps_ns[first + 1] - world_from_base.stamps_ns[first])
    share = min(frame.scan.duration_ns / elapsed, 1.0)
    return Pose.of(se2.fraction(step, np.array([share]))[0])
