"""Pieces of wall detected in single scans, examined in the hits of all scans: variance and duplicated walls."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from evalkit.core.arrays import Bools, Ints, spread_indices
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.consistency import NO_HIT, collect_all_hits, sample_all_hits
from evalkit.metrics.metric import Evidence, PlacedScans, cached, make_metrics, make_score, place_hits
from evalkit.metrics.neighbourhoods import (
    MIN_HITS,
    PATCH_M,
    PointCells,
    build_kd_tree,
    compute_neighbourhoods,
    compute_neighbourhoods_each,
    thin_evenly,
)

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MAX_SCANS = 100
PLACES_A_SCAN = 40
MAX_PLACES = 500
MAX_CROSSED = 40_000
"""At most this many hits are used for profiles across walls, evenly spaced."""

MIN_PLACES = 20
MIN_STRETCHES = 20
CM2 = 1e4

ORTHOGONAL_RAD = np.radians(10.0)
"""Walls within 10 deg of a direction form one family; those within 10 deg of its normal the orthogonal family."""

ALONG_M = 0.25
"""Half the length of a stretch of wall; within it, a wall counts once."""

NEAREST_M, FARTHEST_M = 0.1, 0.5
"""A second copy nearer than the first limit may be noise; beyond the second limit it is another wall."""

SMOOTH_M = 0.02
BIN_M = 0.01
MIN_SHARE = 0.25
DEEPEST = 0.5
"""A second mode has at least a quarter of the first mode's height; between them the density falls to half of it."""

_REACH = round((FARTHEST_M + 0.1) / BIN_M)
"""Bins on each side of a piece of wall."""

_BLOCK = 64
"""Pieces of wall whose neighbours, or stretches whose hits, are in memory at once."""


@dataclass(frozen=True, eq=False)
class WallPieces:
    """Pieces of wall of single scans in the world.

    ``middles`` (K, 2): in m. ``direction`` (K,): within [0, pi). ``sensors`` (K, 2): positions of the sensors that
    observed them.
    """

    middles: Floats
    direction: Floats
    sensors: Floats

    def __len__(self) -> int:
        return len(self.middles)

    def at(self, chosen: Ints) -> WallPieces:
        """Return the pieces with these indices."""
        return WallPieces(self.middles[chosen], self.direction[chosen], self.sensors[chosen])


def find_wall_pieces(mapped: PlacedScans) -> WallPieces:
    """Return the places of at most 100 scans, 40 per scan, where the scan's hits within 0.5 m lie along a line."""
    clouds, middles, sensors = list[Floats](), [np.zeros((0, 2))], [np.zeros((0, 2))]
    for placed in (mapped[index] for index in spread_indices(len(mapped), MAX_SCANS).tolist()):
        points = place_hits(placed)
        if len(points):
            clouds.append(points)
            middles.append(thin_evenly(points, PLACES_A_SCAN))
            sensors.append(np.broadcast_to(placed[1][:2], middles[-1].shape))
    around = compute_neighbourhoods_each(zip(clouds, middles[1:], strict=True))
    flat = around.flat
    return WallPieces(np.concatenate(middles)[flat], around.direction[flat], np.concatenate(sensors)[flat])


def find_orthogonal_families(directions: Floats) -> tuple[Ints, Ints]:
    """Return the indices of two orthogonal families of directions (K,), K > 0, such that the smaller family is largest.

    Among equals, the pair with more members in total.
    """
    candidates = np.radians(np.arange(0.0, 90.0, 1.0))

    def near(angle: float) -> Ints:
        turned = directions - angle + np.pi / 2.0
        turned += np.pi * (turned < 0.0)  # a remainder, in a fifth of its time: both are within [0, pi)
        turned -= np.pi * (turned >= np.pi)
        off = np.abs(turned - np.pi / 2.0)
        return np.asarray(np.flatnonzero(off <= ORTHOGONAL_RAD), dtype=np.int64)

    pairs = [(near(angle), near(angle + np.pi / 2.0)) for angle in candidates]
    return max(pairs, key=lambda pair: (min(map(len, pair)), sum(map(len, pair))))


def mean_variance(hits: Floats | PointCells, middles: Floats) -> tuple[float, int]:
    """Return the mean lambda_min (m2) of the hits (N, 2) within 0.5 m of the middles (K, 2), K > 0, and their number.

    Only middles with at least five hits count; (nan, 0) without any.
    """
    places = compute_neighbourhoods(hits, middles, PATCH_M)
    small = places.small[places.counts >= MIN_HITS]
    return (float(small.mean()) if len(small) else float("nan")), len(small)


def orthogonal_variance(hits: Floats | PointCells, pieces: WallPieces) -> tuple[float, int]:
    """Return the mean lambda_min (m2) of the hits around pieces of wall, summed over two orthogonal families, and a
    number.

    The number of places in the smaller family; (nan, 0) without any piece.
    """
    if len(pieces) == 0:
        return float("nan"), 0
    families = find_orthogonal_families(pieces.direction)
    if not all(map(len, families)):
        return float("nan"), 0
    variances = [mean_variance(hits, thin_evenly(pieces.middles[family], MAX_PLACES)) for family in families]
    return sum(value for value, _ in variances), min(count for _, count in variances)


def find_second_copies(hits: Floats, sensors: Floats, pieces: WallPieces) -> Floats:
    """Return the distance (K,) of the second copy of each stretch of wall (m); nan without a copy.

    ``sensors`` (N, 2): the sensor positions of the hits (N, 2). Of pieces that lie on or beside each other, as the
    copies of a wall do, one represents the stretch. Only hits observed from the piece's own side count, so that the
    opposite face of a wall is not a copy.
    """
    stretches = pieces.at(_choose_spaced(pieces))
    if len(stretches) == 0:
        return np.zeros(0)
    densities, copies = _compute_profiles(hits, sensors, stretches), np.full(len(stretches), np.nan)
    peaks = _mark_peaks(densities)
    highest = np.max(densities, axis=1, where=peaks, initial=0.0)
    several = np.count_nonzero(peaks & (densities >= MIN_SHARE * highest[:, None]), axis=1) > 1
    copies[several] = [_find_second_mode(density) for density in densities[several]]
    return copies


def _choose_spaced(pieces: WallPieces) -> Ints:
    """Return the indices of pieces of which no two lie within 0.25 m along and 0.5 m across,
    in nearly equal direction."""
    if len(pieces) == 0:
        return np.zeros(0, dtype=np.int64)
    reach = float(np.hypot(ALONG_M, FARTHEST_M))
    tree = build_kd_tree(pieces.middles)
    along = np.stack([np.cos(pieces.direction), np.sin(pieces.direction)], axis=1)
    free, kept = np.ones(len(pieces), np.bool_), []
    while len(block := np.flatnonzero(free)[:_BLOCK]):
        around = [np.asarray(near, np.int64) for near in tree.query_ball_point(pieces.middles[block], reach)]
        piece, near = np.repeat(block, list(map(len, around))), np.concatenate(around)
        beside = np.abs(np.sum((pieces.middles[near] - pieces.middles[piece]) * along[piece], axis=1)) <= ALONG_M
        turned = np.abs((pieces.direction[near] - pieces.direction[piece] + np.pi / 2.0) % np.pi - np.pi / 2.0)
        alike = beside & (turned <= ORTHOGONAL_RAD)
        piece, near = piece[alike], near[alike]
        ends = np.append(np.searchsorted(piece, block), len(piece))
        for index, (first, last) in zip(block, pairwise(ends), strict=True):
            if free[index]:
                kept.append(index)
                free[near[first:last]] = False
        free[block] = False
    return np.array(kept, dtype=np.int64)


def _compute_profiles(hits: Floats, sensors: Floats, stretches: WallPieces) -> Floats:
    """Return for each stretch (K, B) the smoothed histogram of hits across it, towards its sensor, in bins of 1 cm."""
    from scipy import ndimage

    normals = np.stack([-np.sin(stretches.direction), np.cos(stretches.direction)], axis=1)
    side = np.sign(np.sum((stretches.sensors - stretches.middles) * normals, axis=1))
    normals *= np.where(side == 0.0, 1.0, side)[:, None]
    tree = build_kd_tree(hits)
    blocks = [
        _count_across(hits, sensors, tree, stretches.middles[begin : begin + _BLOCK], normals[begin : begin + _BLOCK])
        for begin in range(0, len(stretches), _BLOCK)
    ]
    return np.asarray(ndimage.gaussian_filter1d(np.concatenate(blocks), SMOOTH_M / BIN_M, axis=1, mode="constant"))


def _count_across(hits: Floats, sensors: Floats, tree: cKDTree, middles: Floats, normals: Floats) -> Floats:
    """Return the histogram (K, B) of hits across each stretch, seen from its own side, in bins of 1 cm."""
    width, reach = 2 * _REACH + 1, float(np.hypot(ALONG_M, _REACH * BIN_M))
    pairs = build_kd_tree(middles).sparse_distance_matrix(tree, reach, output_type="ndarray")
    row, near = pairs["i"], pairs["j"]
    (x, y), middle = normals[row].T, middles[row]
    (off_x, off_y), (to_x, to_y) = (hits[near] - middle).T, (sensors[near] - middle).T
    bins = np.round((off_x * x + off_y * y) / BIN_M).astype(int) + _REACH
    ours = (to_x * x + to_y * y > 0.0) & (np.abs(off_x * y - off_y * x) <= ALONG_M) & (bins >= 0) & (bins < width)
    counts = np.bincount(row[ours] * width + bins[ours], minlength=len(middles) * width)
    return counts.reshape(-1, width).astype(np.float64)


def _mark_peaks(densities: Floats) -> Bools:
    """Return which bins (..., B) of densities (..., B) are higher than the one before and not lower than the next."""
    inner = densities[..., 1:-1]
    peaks = np.zeros(densities.shape, np.bool_)
    peaks[..., 1:-1] = (inner > densities[..., :-2]) & (inner >= densities[..., 2:])
    return peaks


def _find_second_mode(density: Floats) -> float:
    """Return the distance from the highest peak of a density (B,) to the highest other peak that is a separate mode
    (m).
    """
    peaks = np.flatnonzero(_mark_peaks(density))
    if len(peaks) < 2:
        return float("nan")
    peaks = peaks[np.argsort(-density[peaks], kind="stable")]
    first = int(peaks[0])
    for other in map(int, peaks[1:]):
        if density[other] < MIN_SHARE * density[first]:
            break
        between = density[min(first, other) : max(first, other) + 1].min()
        away = abs(other - first) * BIN_M
        if NEAREST_M - 1e-9 <= away <= FARTHEST_M + 1e-9 and between <= DEEPEST * density[other]:
            return away
    return float("nan")


@cached
def find_all_wall_pieces(evidence: Evidence) -> WallPieces:
    """Return the pieces of wall of all single mapped scans."""
    return find_wall_pieces(evidence.mapped)


@cached
def _find_copies(evidence: Evidence) -> Floats:
    points = collect_all_hits(evidence)
    sensors = np.repeat(
        np.array([world_from_sensor[:2] for _, world_from_sensor in evidence.mapped]),
        [int(scan.hits.sum()) for scan, _ in evidence.mapped],
        axis=0,
    )
    return find_second_copies(
        thin_evenly(points, MAX_CROSSED), thin_evenly(sensors, MAX_CROSSED), find_all_wall_pieces(evidence)
    )


def _score_mean_variance(evidence: Evidence) -> Score:
    points = collect_all_hits(evidence)
    if len(points) == 0:
        return Score(None, reason=NO_HIT)
    value, places = mean_variance(sample_all_hits(evidence), thin_evenly(points, 2 * MAX_PLACES))
    if places < MIN_PLACES:
        return Score(None, places, f"only {places} places have {MIN_HITS} hits within {PATCH_M:g} m")
    return make_score(CM2 * value, places)


def _score_orthogonal(evidence: Evidence) -> Score:
    if len(collect_all_hits(evidence)) == 0:
        return Score(None, reason=NO_HIT)
    value, places = orthogonal_variance(sample_all_hits(evidence), find_all_wall_pieces(evidence))
    if places < MIN_PLACES:
        return Score(None, places, _NO_ORTHOGONAL)
    return make_score(CM2 * value, places)


def _score_ghost_percent(evidence: Evidence) -> Score:
    if len(collect_all_hits(evidence)) == 0:
        return Score(None, reason=NO_HIT)
    copies = _find_copies(evidence)
    if len(copies) < MIN_STRETCHES:
        return Score(None, len(copies), f"single scans contain only {len(copies)} stretches of wall")
    return make_score(100.0 * float(np.isfinite(copies).mean()), len(copies))


def _score_ghost_distance(evidence: Evidence) -> Score:
    share = _score_ghost_percent(evidence)
    if share.value is None:
        return share
    copies = _find_copies(evidence)
    copies = copies[np.isfinite(copies)]
    return make_score(np.median(copies), len(copies)) if len(copies) else Score(None, reason=_NO_COPY)


_NO_ORTHOGONAL = "single scans contain too few walls at right angles to each other"
_NO_COPY = "no wall has a second copy"


METRICS = make_metrics(
    "surfaces",
    {
        "mpv_cm2": _score_mean_variance,
        "mom_cm2": _score_orthogonal,
        "ghost_wall_percent": _score_ghost_percent,
        "ghost_wall_m": _score_ghost_distance,
    },
)
