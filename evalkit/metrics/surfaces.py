"""Judges pieces of wall, known as such from a single scan, by what all scans laid together make of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.consistency import NO_HIT, WARP, collect_all_hits
from evalkit.metrics.neighbourhoods import MIN_HITS, PATCH_M, build_kd_tree, compute_neighbourhoods, thin_evenly
from evalkit.metrics.table import DIVERGED, Evidence, Metric, PlacedScans, cached, make_score, with_support

MAX_SCANS = 100
PLACES_A_SCAN = 40
MAX_HITS = 20_000
MAX_PLACES = 500
MAX_CROSSED = 40_000
"""Of more hits so many are laid together for variances, and so many across stretches of wall, evenly spaced."""

MIN_PLACES = 20
MIN_STRETCHES = 20
CM2 = 1e4

ORTHOGONAL_RAD = np.radians(10.0)
"""Walls within 10 deg of one direction belong to one surface, and to its orthogonal one within 10 deg of 90."""

ALONG_M = 0.25
"""A place of a wall reaches so far to either side along it, and counts once within that."""

NEAREST_M, FARTHEST_M = 0.1, 0.5
"""A second copy nearer than this is not told from noise; farther off it is another wall."""

SMOOTH_M = 0.02
BIN_M = 0.01
MIN_SHARE = 0.25
DEEPEST = 0.5
"""A second mode has a quarter of the first one's height at least, and between them the density falls to half of it."""

_REACH = round((FARTHEST_M + 0.1) / BIN_M)
"""Bins to either side of a piece of wall."""


@dataclass(frozen=True, eq=False)
class WallPieces:
    """Pieces of wall of single scans in the world: middle (K, 2) in m, ``direction`` (K,) within [0, pi), the sensor
    (K, 2) that saw each."""

    middles: Floats
    direction: Floats
    sensors: Floats

    def __len__(self) -> int:
        return len(self.middles)

    def at(self, chosen: Ints) -> WallPieces:
        """Some of the pieces, by index."""
        return WallPieces(self.middles[chosen], self.direction[chosen], self.sensors[chosen])


def find_wall_pieces(mapped: PlacedScans) -> WallPieces:
    """The places of at most 100 scans, 40 of each, around which that scan's hits within 0.5 m lie along a line."""
    middles, directions, sensors = [np.zeros((0, 2))], [np.zeros(0)], [np.zeros((0, 2))]
    for index in np.unique(np.linspace(0, len(mapped) - 1, min(MAX_SCANS, len(mapped))).astype(int)):
        scan, world_from_sensor = mapped[int(index)]
        points = se2.transform(world_from_sensor, scan.points())
        if len(points):
            places = thin_evenly(points, PLACES_A_SCAN)
            seen = compute_neighbourhoods(points, places)
            middles.append(places[seen.flat])
            directions.append(seen.direction[seen.flat])
            sensors.append(np.broadcast_to(world_from_sensor[:2], middles[-1].shape))
    return WallPieces(np.concatenate(middles), np.concatenate(directions), np.concatenate(sensors))


def find_orthogonal_families(directions: Floats) -> tuple[Ints, Ints]:
    """Indices of two families of directions (K,), K > 0, at right angles to each other, so that the smaller is largest.

    Of equals the pair with more members in all.
    """
    candidates = np.radians(np.arange(0.0, 90.0, 1.0))

    def near(angle: float) -> Ints:
        off = np.abs((directions - angle + np.pi / 2.0) % np.pi - np.pi / 2.0)
        return np.asarray(np.flatnonzero(off <= ORTHOGONAL_RAD), dtype=np.int64)

    pairs = [(near(angle), near(angle + np.pi / 2.0)) for angle in candidates]
    return max(pairs, key=lambda pair: (min(map(len, pair)), sum(map(len, pair))))


def mean_variance(hits: Floats, middles: Floats) -> tuple[float, int]:
    """Mean lambda_min (m2) of the hits (N, 2) within 0.5 m of the middles (K, 2), K > 0, that have five, and how many.

    (nan, 0) where none has.
    """
    found = compute_neighbourhoods(hits, middles, PATCH_M)
    small = found.small[found.counts >= MIN_HITS]
    return (float(small.mean()) if len(small) else float("nan")), len(small)


def orthogonal_variance(hits: Floats, pieces: WallPieces) -> tuple[float, int]:
    """Mean lambda_min (m2) of the hits around pieces of wall, summed over two orthogonal families, and of how many.

    The support is that of the smaller family; (nan, 0) without any piece.
    """
    if len(pieces) == 0:
        return float("nan"), 0
    families = find_orthogonal_families(pieces.direction)
    if not all(map(len, families)):
        return float("nan"), 0
    found = [mean_variance(hits, thin_evenly(pieces.middles[family], MAX_PLACES)) for family in families]
    return sum(value for value, _ in found), min(count for _, count in found)


def find_second_copies(hits: Floats, sensors: Floats, pieces: WallPieces) -> Floats:
    """How far (K,) from each stretch of wall its second copy stands (m); nan where there is none.

    ``sensors`` (N, 2): where each of the hits (N, 2) was seen from. Of pieces that lie on or beside one another, as the
    copies of a wall do, one stands for the stretch. Only hits seen from the piece's own side count, so that the other
    face of a wall is no copy of it.
    """
    stretches = pieces.at(_apart(pieces))
    if len(stretches) == 0:
        return np.zeros(0)
    return np.array([_second_mode(density) for density in _profiles(hits, sensors, stretches)])


def _apart(pieces: WallPieces) -> Ints:
    """Indices of pieces no two of which lie within 0.25 m along and 0.5 m across, in nearly the same direction."""
    if len(pieces) == 0:
        return np.zeros(0, dtype=np.int64)
    reach = float(np.hypot(ALONG_M, FARTHEST_M))
    around = build_kd_tree(pieces.middles).query_ball_point(pieces.middles, reach)
    along = np.stack([np.cos(pieces.direction), np.sin(pieces.direction)], axis=1)
    free, kept = np.ones(len(pieces), np.bool_), []
    for index, neighbours in enumerate(around):
        if free[index]:
            kept.append(index)
            near = np.asarray(neighbours)
            beside = np.abs((pieces.middles[near] - pieces.middles[index]) @ along[index]) <= ALONG_M
            turned = np.abs((pieces.direction[near] - pieces.direction[index] + np.pi / 2.0) % np.pi - np.pi / 2.0)
            free[near[beside & (turned <= ORTHOGONAL_RAD)]] = False
    return np.array(kept, dtype=np.int64)


def _profiles(hits: Floats, sensors: Floats, stretches: WallPieces) -> Floats:
    """Per stretch (K, B): the smoothed histogram of hits across it, towards the sensor that saw it, in bins of 1 cm."""
    from scipy import ndimage

    normals = np.stack([-np.sin(stretches.direction), np.cos(stretches.direction)], axis=1)
    side = np.sign(np.sum((stretches.sensors - stretches.middles) * normals, axis=1))
    normals *= np.where(side == 0.0, 1.0, side)[:, None]
    tree, width = build_kd_tree(hits), 2 * _REACH + 1
    counts = np.zeros((len(stretches), width))
    around = tree.query_ball_point(stretches.middles, float(np.hypot(ALONG_M, _REACH * BIN_M)), return_sorted=False)
    for row, (near, middle, normal) in enumerate(zip(around, stretches.middles, normals, strict=True)):
        offsets = hits[near] - middle
        ours = (sensors[near] - middle) @ normal > 0.0
        along = np.abs(offsets @ np.array([normal[1], -normal[0]])) <= ALONG_M
        bins = np.round((offsets @ normal)[ours & along] / BIN_M).astype(int) + _REACH
        counts[row] = np.bincount(bins[(bins >= 0) & (bins < width)], minlength=width)
    return np.asarray(ndimage.gaussian_filter1d(counts, SMOOTH_M / BIN_M, axis=1, mode="constant"))


def _second_mode(density: Floats) -> float:
    """How far from the highest peak of a density (B,) the highest other one stands that is a mode of its own (m)."""
    peaks = np.flatnonzero((density[1:-1] > density[:-2]) & (density[1:-1] >= density[2:])) + 1
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
    """The pieces of wall of single mapped scans."""
    return find_wall_pieces(evidence.mapped)


@cached
def _copies(evidence: Evidence) -> Floats:
    points = collect_all_hits(evidence)
    sensors = np.repeat(
        np.array([world_from_sensor[:2] for _, world_from_sensor in evidence.mapped]),
        [int(scan.hits.sum()) for scan, _ in evidence.mapped],
        axis=0,
    )
    return find_second_copies(
        thin_evenly(points, MAX_CROSSED), thin_evenly(sensors, MAX_CROSSED), find_all_wall_pieces(evidence)
    )


def _mean_variance(evidence: Evidence) -> Score:
    points = collect_all_hits(evidence)
    if len(points) == 0:
        return Score(None, 0, NO_HIT)
    value, places = mean_variance(thin_evenly(points, MAX_HITS), thin_evenly(points, 2 * MAX_PLACES))
    if places < MIN_PLACES:
        return Score(None, places, f"only {places} places have {MIN_HITS} hits within {PATCH_M:g} m")
    return make_score(CM2 * value, places)


def _orthogonal(evidence: Evidence) -> Score:
    points = collect_all_hits(evidence)
    if len(points) == 0:
        return Score(None, 0, NO_HIT)
    value, places = orthogonal_variance(thin_evenly(points, MAX_HITS), find_all_wall_pieces(evidence))
    if places < MIN_PLACES:
        return Score(None, places, "single scans hardly show walls at right angles to each other")
    return make_score(CM2 * value, places)


def _ghost_percent(evidence: Evidence) -> Score:
    if len(collect_all_hits(evidence)) == 0:
        return Score(None, 0, NO_HIT)
    copies = _copies(evidence)
    if len(copies) < MIN_STRETCHES:
        return Score(None, len(copies), f"single scans show only {len(copies)} stretches of wall")
    return make_score(100.0 * float(np.isfinite(copies).mean()), len(copies))


def _ghost_distance(evidence: Evidence) -> Score:
    found = _ghost_percent(evidence)
    if found.value is None:
        return found
    copies = _copies(evidence)
    copies = copies[np.isfinite(copies)]
    return make_score(np.median(copies), len(copies)) if len(copies) else Score(None, 0, "no wall has a second copy")


KORNILOVA = "Kornilova and Ferrer, 2021, arXiv 2106.11351 (mutually orthogonal metric), in the plane"
SCATTER = (
    f"Smaller variance lambda_min of the hits ({MAX_HITS:,} of them, evenly, if there are more) within {PATCH_M:g} m"
)
COPY = (
    f"A stretch of wall, known from a single scan, has a second copy where the hits from the same side, {ALONG_M:g} m "
    f"to either side along it, have a second mode {NEAREST_M:g} to {FARTHEST_M:g} m off across it; "
    f"of the hits at most {MAX_CROSSED:,}, evenly"
)

_ROWS = (
    Metric("mpv_cm2", "mean plane variance", "cm2", "lower", "map consistency",
           f"{SCATTER} of one that has {MIN_HITS} of them, all mapped scans laid together; mean over at most 1,000 "
           "places, corners and furniture included.", "Razlaw et al., ECMR 2015 (mean plane variance), in the plane",
           f"errors along a wall; how cluttered the place is sets its least value; {WARP}", _mean_variance, 1),
    Metric("mom_cm2", "orthogonal walls' variance", "cm2", "lower", "map consistency",
           f"{SCATTER} of a piece of wall, which lies along a line in a single scan; mean over the walls within 10 deg "
           "of one direction, plus that of the walls at right angles to them (the two that most pieces have).",
           KORNILOVA, f"walls that run neither way; slips in places seen once; {WARP}", _orthogonal, 1,
           headline=True),
    Metric("ghost_wall_percent", "ghost walls", "%", "lower", "map consistency",
           f"Stretches of wall with a second copy, of all. {COPY}.", "evalkit",
           "copies nearer or farther than that, so that a large slip can count for less than a small one; smearing "
           f"without copies; clutter in front of a wall counts as one; {WARP}", _ghost_percent, 1),
    Metric("ghost_wall_m", "ghost walls apart", "m", "", "map consistency",
           f"How far the second copies of walls stand from the first, median. {COPY}.", "evalkit",
           "how many copies there are; which of both is right", _ghost_distance, 2),
)  # fmt: skip

_GHOSTS = (NO_HIT, "single scans show only ... stretches of wall")

METRICS = with_support(
    _ROWS,
    {
        "mpv_cm2": ("places with five hits around", (NO_HIT, "only ... places have ... hits within ... m", DIVERGED)),
        "mom_cm2": (
            "pieces of wall of the rarer of both directions",
            (NO_HIT, "single scans hardly show walls at right angles to each other", DIVERGED),
        ),
        "ghost_wall_percent": ("stretches of wall", _GHOSTS),
        "ghost_wall_m": ("stretches with a second copy", (*_GHOSTS, "no wall has a second copy")),
    },
)
