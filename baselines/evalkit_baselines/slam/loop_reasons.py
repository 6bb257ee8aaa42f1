"""Why a candidate for a loop closure was accepted or not, in words."""

from __future__ import annotations

import math


def describe_passed(chi_square: float, overlap: float) -> str:
    """Describe a candidate that passes all checks."""
    return f"chi2 {chi_square:.1f}, overlap {overlap:.2f}"


def describe_few_points(points: float, least: float) -> str:
    """Return the reason of a candidate one of whose maps has too few points."""
    return f"{points:.0f} points, fewer than {least:.0f}"


def describe_low_score(bound: float, least: float) -> str:
    """Return the reason of a candidate none of whose motions has a score above ``bound``."""
    return f"score at most {_round_up(bound, 4)}, not above {least:g}"


def describe_ambiguous(share: float, score: float) -> str:
    """Return the reason of a candidate of which another motion has a share of the best score."""
    return f"ambiguous: another motion has {share:.2f} of the score {score:.2f}"


def describe_little_overlap(overlap: float, least: float) -> str:
    """Return the reason of a candidate of whose points too small a share lies on the other map."""
    return f"overlap {_round_down(overlap)} < {least:g}"


def describe_degenerate(sigma_m: float, most_m: float) -> str:
    """Return the reason of a candidate whose walls do not fix the position (1 sigma)."""
    return f"degenerate: position known to {_round_up(sigma_m)} m > {most_m:g} m"


def describe_far(chi_square: float, gate: float) -> str:
    """Return the reason of a candidate that contradicts the graph."""
    return f"chi2 {chi_square:.1f} > {gate:.1f}"


def describe_contradiction(share: float, least: float) -> str:
    """Return the reason of a candidate of whose points in view of the other map's scans too few lie on that map."""
    return f"contradicted: {_round_down(share)} < {least:g} of what could be seen there"


def describe_unconfirmed(reason: str) -> str:
    """Describe a candidate that passed, and that no other one confirms yet."""
    return f"not confirmed yet: {reason}"


def describe_found_again(reason: str, part: int) -> str:
    """Describe a closure that placed a part of the drive which began after a lost track."""
    return f"found again after a lost track (part {part}): {reason}"


def describe_withdrawn(reason: str) -> str:
    """Describe a closure that was accepted, and that contradicts others."""
    return f"withdrawn, contradicts other loops: {reason}"


def _round_up(value: float, digits: int = 3) -> str:
    return f"{math.ceil(value * 10**digits) / 10**digits:.{digits}f}"


def _round_down(value: float) -> str:
    return f"{math.floor(value * 1000) / 1000:.3f}"
