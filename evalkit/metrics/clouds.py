"""Judges the hits of all scans laid together, without a map and without a truth: how sharp, and which way walls run."""

from __future__ import annotations

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.consistency import NO_HIT, WARP, collect_all_hits, collect_hits
from evalkit.metrics.neighbourhoods import MIN_HITS, PATCH_M, Neighbourhoods, compute_neighbourhoods, thin_evenly
from evalkit.metrics.surfaces import find_all_wall_pieces
from evalkit.metrics.table import Evidence, Metric, make_score, with_support

MAX_HITS = 20_000
MAX_PLACES = 1000
MIN_M = 1e-3
"""A neighbourhood is at least so thick: exact lines would be infinitely sharp."""

BINS = 1800
KERNEL_RAD = np.radians(1.0)
MIN_SHARED = 100
MIN_SHARE = 0.05


def entropies(found: Neighbourhoods) -> tuple[Floats, Bools]:
    """Entropy (K,) in nats of the Gaussian of each patch, and which (K,) have the five points that it takes.

    h = 1/2 ln |2 pi e Sigma| (Razlaw et al., ECMR 2015), here with the 2 x 2 covariance, no axis below 1 mm.
    """
    enough = found.counts >= MIN_HITS
    least = MIN_M**2
    determinant = np.maximum(found.small, least) * np.maximum(found.large, least)
    return np.log(2.0 * np.pi * np.e) + 0.5 * np.log(determinant), np.asarray(enough)


def mean_map_entropy(points: Floats, radius_m: float = PATCH_M) -> tuple[float, int, float]:
    """Mean entropy (nat) over at most 1,000 places of points (N, 2), N > 0, at how many, and at what share of all."""
    points = thin_evenly(points, MAX_HITS)
    values, enough = entropies(compute_neighbourhoods(points, thin_evenly(points, MAX_PLACES), radius_m))
    return (float(values[enough].mean()) if enough.any() else 0.0), int(enough.sum()), float(enough.mean())


def joint_minus_separate(first: Floats, second: Floats, radius_m: float = PATCH_M) -> tuple[float, int]:
    """By how many nats the entropy of clouds (N, 2), (M, 2) laid together exceeds their own, and at how many places.

    CorAl (Adolfsson et al., ECMR 2021) with one radius: what the scene itself has of entropy cancels. Only places count
    at which both clouds have five points within the radius.
    """
    first, second = thin_evenly(first, MAX_HITS // 2), thin_evenly(second, MAX_HITS // 2)
    both = np.concatenate([first, second])
    added, places = 0.0, 0
    for own, other in ((first, second), (second, first)):
        middles = thin_evenly(own, MAX_PLACES // 2)
        separate, enough = entropies(compute_neighbourhoods(own, middles, radius_m))
        shared = enough & (compute_neighbourhoods(other, middles, radius_m).counts >= MIN_HITS)
        joint, _ = entropies(compute_neighbourhoods(both, middles, radius_m))
        added, places = added + float((joint - separate)[shared].sum()), places + int(shared.sum())
    return (added / places if places else 0.0), places


def direction_entropy(directions: Floats) -> float:
    """The differential entropy (nat) of directions (K,) that repeat every half turn: ln pi if all are as frequent.

    Of their density under a Gaussian kernel of 1 deg, on a grid so fine that the frame does not matter; all the same
    direction gives the entropy of the kernel, 1/2 ln(2 pi e) + ln(pi / 180).
    """
    counts = np.bincount((directions % np.pi / np.pi * BINS).astype(int) % BINS, minlength=BINS)
    spacing = np.pi / BINS
    frequencies = 2.0 * np.pi * np.fft.rfftfreq(BINS, spacing)
    smooth = np.fft.irfft(np.fft.rfft(counts) * np.exp(-0.5 * (KERNEL_RAD * frequencies) ** 2), BINS)
    density = np.maximum(smooth, 1e-12 * len(directions)) / (len(directions) * spacing)
    return float(-np.sum(density * np.log(density)) * spacing)


def _mean_map_entropy(evidence: Evidence) -> Score:
    points = collect_all_hits(evidence)
    if len(points) == 0:
        return Score(None, 0, NO_HIT)
    value, places, share = mean_map_entropy(points)
    if share < MIN_SHARE:
        return Score(
            None, places, f"only {100.0 * share:.0f} % of the hits have {MIN_HITS} others within {PATCH_M:g} m"
        )
    return make_score(value, places)


def _joint(evidence: Evidence) -> Score:
    middle = len(evidence.mapped) // 2
    first, second = collect_hits(evidence.mapped[:middle]), collect_hits(evidence.mapped[middle:])
    if len(first) == 0 or len(second) == 0:
        return Score(None, 0, NO_HIT)
    value, places = joint_minus_separate(first, second)
    if places < MIN_SHARED:
        return Score(None, places, "both halves of the run hardly see the same places")
    return make_score(value, places)


def _directions(evidence: Evidence) -> Score:
    found = find_all_wall_pieces(evidence).direction
    if len(found) < MIN_SHARED:
        return Score(None, len(found), f"the scans show only {len(found)} pieces of wall, {MIN_SHARED} are needed")
    return make_score(direction_entropy(found), len(found))


_ROWS = (
    Metric("mme_nat", "mean map entropy of points", "nat", "lower", "map consistency",
           f"Entropy 1/2 ln |2 pi e Sigma| of the hits within {PATCH_M:g} m of one, all mapped scans laid together; "
           f"mean over those of at most 1,000 places that have {MIN_HITS} of them.",
           "Razlaw et al., ECMR 2015 (mean map entropy), in the plane",
           f"errors so large that they scatter the hits, for which it can even fall; {WARP}", _mean_map_entropy),
    Metric("coral_nat", "entropy added by the other half", "nat", "lower", "map consistency",
           "Entropy of the hits of both halves of the run together minus that of each half alone, at places that both "
           f"see ({MIN_HITS} hits of either within {PATCH_M:g} m); mean. What the scene itself has cancels.",
           "Adolfsson et al., ECMR 2021 (CorAl), with one radius and for the halves of a run",
           f"drift within places seen in one half only, errors that smear both halves alike; {WARP}", _joint),
    Metric("direction_spread_nat", "angular fragmentation", "nat", "lower", "map consistency",
           "Differential entropy of the directions in which walls run in the single scans, in the world, modulo 180 "
           "deg, smoothed by 1 deg: ln pi = 1.14 if every direction is as frequent, less the fewer there are.",
           "evalkit",
           "every error of position; places whose walls run all ways anyway", _directions),
)  # fmt: skip

METRICS = with_support(
    _ROWS,
    {
        "mme_nat": ("places with five hits around", (NO_HIT, "only ... % of the hits have ... others within ... m")),
        "coral_nat": (
            "places that both halves of the run see",
            (NO_HIT, "both halves of the run hardly see the same places"),
        ),
        "direction_spread_nat": (
            "pieces of wall in single scans",
            ("the scans show only ... pieces of wall, ... are needed",),
        ),
    },
)
