"""Metrics of the hits of all scans, without map and ground truth: entropies and wall directions."""

from __future__ import annotations

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.consistency import (
    MAX_HITS,
    MAX_PLACES,
    NO_HIT,
    NO_OVERLAP,
    collect_all_hits,
    collect_half_hits,
    sample_all_neighbourhoods,
)
from evalkit.metrics.metric import Evidence, make_metrics, make_score
from evalkit.metrics.neighbourhoods import (
    MIN_HITS,
    PATCH_M,
    Neighbourhoods,
    compute_neighbourhoods,
    sort_into_cells,
    thin_evenly,
)
from evalkit.metrics.surfaces import find_all_wall_pieces

MIN_M = 1e-3
"""Smallest standard deviation of a neighbourhood: exact lines would have an infinite entropy."""

BINS = 1800
KERNEL_RAD = np.radians(1.0)
MIN_SHARED = 100
MIN_SHARE = 0.05


def entropies(places: Neighbourhoods) -> tuple[Floats, Bools]:
    """Return the entropy (K,) in nats of the Gaussian of each neighbourhood, and which (K,) have at least five points.

    h = 1/2 ln |2 pi e Sigma| (Razlaw et al., ECMR 2015), here with the 2 x 2 covariance; standard deviations are at
    least 1 mm.
    """
    enough = places.counts >= MIN_HITS
    determinant = np.maximum(places.small, MIN_M**2) * np.maximum(places.large, MIN_M**2)
    return np.log(2.0 * np.pi * np.e) + 0.5 * np.log(determinant), np.asarray(enough)


def average_entropies(around: Neighbourhoods) -> tuple[float, int, float]:
    """Return the mean entropy (nat) of neighbourhoods, how many have one, and their share of all."""
    values, enough = entropies(around)
    return (float(values[enough].mean()) if enough.any() else 0.0), int(enough.sum()), float(enough.mean())


def joint_minus_separate(first: Floats, second: Floats) -> tuple[float, int]:
    """Return the mean excess (nat) of the joint entropy of two clouds (N, 2), (M, 2) over their separate entropies.

    With the number of places. CorAl (Adolfsson et al., ECMR 2021) with one radius: the entropy of the scene itself
    cancels. Only places where both clouds have five points within 0.5 m count.
    """
    first, second = thin_evenly(first, MAX_HITS // 2), thin_evenly(second, MAX_HITS // 2)
    one, two, both = (sort_into_cells(hits) for hits in (first, second, np.concatenate([first, second])))
    added, places = 0.0, 0
    for hits, own, other in ((first, one, two), (second, two, one)):
        middles = thin_evenly(hits, MAX_PLACES // 2)
        separate, enough = entropies(compute_neighbourhoods(own, middles))
        shared = enough & (compute_neighbourhoods(other, middles).counts >= MIN_HITS)
        joint, _ = entropies(compute_neighbourhoods(both, middles))
        added, places = added + float((joint - separate)[shared].sum()), places + int(shared.sum())
    return (added / places if places else 0.0), places


def direction_entropy(directions: Floats) -> float:
    """Return the differential entropy (nat) of directions (K,) with period pi: ln pi if all are equally frequent.

    Of the density under a Gaussian kernel of 1 deg, on a grid fine enough to be independent of the frame. Identical
    directions give the entropy of the kernel, 1/2 ln(2 pi e) + ln(pi / 180).
    """
    counts = np.bincount((directions % np.pi / np.pi * BINS).astype(int) % BINS, minlength=BINS)
    spacing = np.pi / BINS
    frequencies = 2.0 * np.pi * np.fft.rfftfreq(BINS, spacing)
    smooth = np.fft.irfft(np.fft.rfft(counts) * np.exp(-0.5 * (KERNEL_RAD * frequencies) ** 2), BINS)
    density = np.maximum(smooth, 1e-12 * len(directions)) / (len(directions) * spacing)
    return float(-np.sum(density * np.log(density)) * spacing)


def _score_mean_map_entropy(evidence: Evidence) -> Score:
    points = collect_all_hits(evidence)
    if len(points) == 0:
        return Score(None, reason=NO_HIT)
    value, places, share = average_entropies(sample_all_neighbourhoods(evidence))
    if share < MIN_SHARE:
        return Score(
            None, places, f"only {100.0 * share:.0f} % of the hits have {MIN_HITS} others within {PATCH_M:g} m"
        )
    return make_score(value, places)


def _score_joint_entropy(evidence: Evidence) -> Score:
    first, second = collect_half_hits(evidence)
    if len(first) == 0 or len(second) == 0:
        return Score(None, reason=NO_HIT)
    value, places = joint_minus_separate(first, second)
    if places < MIN_SHARED:
        return Score(None, places, NO_OVERLAP)
    return make_score(value, places)


def _score_directions(evidence: Evidence) -> Score:
    directions = find_all_wall_pieces(evidence).direction
    if len(directions) < MIN_SHARED:
        return Score(
            None,
            len(directions),
            f"the scans contain {len(directions)} pieces of wall, at least {MIN_SHARED} are needed",
        )
    return make_score(direction_entropy(directions), len(directions))


METRICS = make_metrics(
    "clouds",
    {
        "mme_nat": _score_mean_map_entropy,
        "coral_nat": _score_joint_entropy,
        "direction_spread_nat": _score_directions,
    },
    MIN_HITS=MIN_HITS,
    PATCH_M=PATCH_M,
)
