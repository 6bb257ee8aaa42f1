"""Evaluate a finished run: align it with the truth, build its map, and compute every metric."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from evalkit import metrics
from evalkit.core import se2
from evalkit.core.arrays import spread_indices
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.known_map import KnownMap
from evalkit.core.pose import Pose
from evalkit.core.run_result import FinalAlignment, RunResult, Score, Scores
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.localisation import compute_fit
from evalkit.metrics.metric import NO_POSES, Evidence, MatchedPoses, MissingMap, PlacedScan, PlacedScans, Unmatched
from evalkit.metrics.recovery import add_recovery
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
MAP_OF_FINAL = "the map is drawn from the corrected poses"
MAP_ALIGNMENT = "the frame of the map is that of its file and settings"


def evaluate_run(
    result: RunResult,
    sequence: Sequence,
    make_mapper: Callable[[], Mapper],
    scans: int,
    known_map: KnownMap | None = None,
    align_truth: bool = False,
) -> Scores:
    """The scores, the map and the errors of a run; a failed run is evaluated up to its last answer.

    Answers and corrected poses of a SLAM are aligned in the same way, each on its own; the lost-track check looks at
    the answers. ``scans``: maximum number of scans in the map. ``known_map``: in which the run
    tracked the robot; its frame is that of the ground truth, unless ``align_truth``.
    """
    matched = collect_evidence(result, sequence, known_map, align_truth)
    evidence = add_map(matched, sequence, make_mapper, scans)
    own = _align(evidence)
    final = None if evidence.final is None else _align(evidence.final)
    scores = metrics.compute_scores(evidence, metrics.all_metrics())
    mapped = (evidence.final or evidence).grid
    grid = None if isinstance(mapped, MissingMap) else mapped
    lost = add_recovery(evidence, find_lost_track(evidence, sequence.frames))
    fit = compute_fit(evidence)
    pairs = None if fit is None else fit[:, :2]
    return Scores(scores, own.world_from_start, own.alignment, grid, own.errors_m, lost, final, pairs)


def evaluate_map(result: RunResult, grid: OccupancyGrid, sequence: Sequence) -> Scores:
    """The scores of a map without a trajectory, given in the frame of the world."""
    evidence = Evidence(result, sequence.truth(), Unmatched(NO_TRAJECTORY), grid)
    table = metrics.all_metrics()
    against_truth = [one for one in table if one.group == "map against truth" and one.name not in OF_PROBABILITIES]
    meaningful = [*against_truth, *(one for one in table if one.name in OF_THE_MAP_ALONE)]
    scores = {one.name: Score(None, reason=NO_TRAJECTORY) for one in table}
    scores |= metrics.compute_scores(evidence, meaningful)
    for name in OF_PROBABILITIES:
        scores[name] = replace(scores[name], reason=NO_PROBABILITIES)
    return Scores(scores, Pose(), MAP_ALIGNMENT, grid)


def collect_evidence(
    result: RunResult, sequence: Sequence, known_map: KnownMap | None = None, align_truth: bool = False
) -> Evidence:
    """The evidence of a run without its scans and map: enough for drift and runtime."""
    return _match(result, sequence.truth(), known_map, align_truth)


def _match(result: RunResult, truth: Truth, known_map: KnownMap | None, align_truth: bool) -> Evidence:
    corrected = result.with_final_answers
    final = None if corrected is None else _match(replace(corrected, final=None), truth, known_map, align_truth)
    start = None if result.start is None or align_truth else result.start.map_from_start
    matched = match_trajectories(result.estimate, truth.trajectory, map_from_start=start)
    return Evidence(result, truth, matched, known_map=known_map, final=final)


def add_map(
    evidence: Evidence, sequence: Sequence, make_mapper: Callable[[], Mapper], scans: int, halves: bool = True
) -> Evidence:
    """The evidence with scans and map, of a SLAM with the map of the corrected poses in ``final``.

    ``halves``: also the maps of both halves, for some consistency metrics.
    """
    world_from_base = evidence.run.estimate.moved(_find_world_from_start(evidence), "world")
    mapped, successive, odometry = _place_scans(sequence, world_from_base, scans)
    placed = replace(evidence, mapped=mapped, successive=successive, odometry=odometry)
    if evidence.final is not None:
        final = add_map(evidence.final, sequence, make_mapper, scans, halves)
        return replace(placed, grid=MissingMap(MAP_OF_FINAL), final=final)
    middle = len(mapped) // 2
    if not halves:
        return replace(placed, grid=render_map(mapped, make_mapper))
    first, grid = _render_maps(mapped, make_mapper, (middle, len(mapped)))
    return replace(placed, grid=grid, first_half=first, second_half=render_map(mapped[middle:], make_mapper))


def render_map(mapped: PlacedScans, make_mapper: Callable[[], Mapper]) -> OccupancyGrid | MissingMap:
    """Return the map of scans with known sensor poses, or why there is none."""
    return _render_maps(mapped, make_mapper, (len(mapped),))[0]


def _render_maps(
    mapped: PlacedScans, make_mapper: Callable[[], Mapper], counts: tuple[int, ...]
) -> tuple[OccupancyGrid | MissingMap, ...]:
    """Return the maps of the first scans with known sensor poses, by one mapper; ``counts``: numbers of scans, rising.

    A map may be impossible, for example because a diverged trajectory exceeds its largest size; the other scores of the
    run are still computed.
    """
    if not mapped:
        return (MissingMap(NO_POSES),) * len(counts)
    maps: list[OccupancyGrid | MissingMap] = []
    mapper, done = make_mapper(), 0
    try:
        for count in counts:
            for scan, world_from_sensor in mapped[done:count]:
                mapper.update(scan, Pose.of(world_from_sensor))
            done = count
            maps.append(_check_grid(mapper.grid()) if count else MissingMap(NO_POSES))
    except Exception as error:  # noqa: BLE001 - a mapper is third-party code
        maps += [MissingMap(f"the mapper failed ({error})")] * (len(counts) - len(maps))
    return tuple(maps)


def _check_grid(grid: object) -> OccupancyGrid:
    """Return what ``grid`` of a mapper returned; raises TypeError for another type."""
    if not isinstance(grid, OccupancyGrid):
        raise TypeError(f"grid() returned a {type(grid).__name__}, expected an evalkit.OccupancyGrid")
    return grid


def _align(evidence: Evidence) -> FinalAlignment:
    """The alignment to the truth, in words too, and the distance of each pose to the truth."""
    world_from_start, true = _find_world_from_start(evidence), evidence.truth.trajectory
    estimate = evidence.run.estimate
    errors = None if true is None else compute_errors_m(estimate.moved(world_from_start, "world"), true)
    return FinalAlignment(world_from_start, _describe_alignment(evidence), errors)


def _find_world_from_start(evidence: Evidence) -> Pose:
    """The alignment; without ground truth, the start in the known map."""
    if isinstance(evidence.matched, MatchedPoses):
        return evidence.matched.world_from_start
    return Pose() if evidence.run.start is None else evidence.run.start.map_from_start


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
    chosen, earlier = spread_indices(expected, most).tolist(), spread_indices(expected - 1, MAX_PAIRS).tolist()
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


def _motion_within_scan(frame: Frame, world_from_base: Trajectory, index: int) -> Pose | None:
    """``start_from_end`` of one scan: its share of the estimated step to the next scan (or from the last one)."""
    if frame.scan.duration_ns == 0 or len(world_from_base) < 2:
        return None
    first = min(index, len(world_from_base) - 2)
    step = se2.between(world_from_base.poses[first], world_from_base.poses[first + 1])
    elapsed = int(world_from_base.stamps_ns[first + 1] - world_from_base.stamps_ns[first])
    share = min(frame.scan.duration_ns / elapsed, 1.0)
    return Pose.of(se2.fraction(step, np.array([share]))[0])
