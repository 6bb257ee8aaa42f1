"""The matchers of ``paper-slam``: ``paper-map-line`` with ``share_noise``, and other limits for each purpose."""

from __future__ import annotations

from typing import Any, NamedTuple

from evalkit.plugins.protocols import Registration
from evalkit_baselines import paper
from evalkit_baselines.slam.second_try import (
    DIRECT_EPSILON_M,
    FINE_CORRESPONDENCE_M,
    FINE_ITERATIONS,
    PART_ITERATIONS,
    Coarse,
    CoarseToFine,
    SecondTry,
)
from evalkit_baselines.slam.wide_search import WideSearch

_NARROW = {"max_correspondence_m": FINE_CORRESPONDENCE_M}


class Matchers(NamedTuple):
    """``in_two_stages``: of a scan with the one before and with the map; ``direct``: with the map alone.

    ``wide``, ``narrow``: of two maps, with far and then with near pairs.
    """

    in_two_stages: SecondTry
    direct: Registration
    wide: Registration
    narrow: Registration


def make_matchers() -> Matchers:
    """Make all matchers."""
    wide, narrow = _make_icp(), _make_icp(**_NARROW)
    coarse = _make_icp(max_iterations=PART_ITERATIONS)
    brief = _make_icp(**_NARROW, max_iterations=PART_ITERATIONS)
    fine = _make_icp(**_NARROW, max_iterations=FINE_ITERATIONS)
    direct = _make_icp(**_NARROW, max_iterations=FINE_ITERATIONS, epsilon=DIRECT_EPSILON_M)
    of_scan, of_scan_again = Coarse(wide, coarse), Coarse(narrow, brief)
    in_two_stages = SecondTry(
        CoarseToFine(of_scan, fine),
        CoarseToFine(of_scan_again, fine),
        brief,
        scan_to_scan=(of_scan, of_scan_again),
        search=WideSearch(),
    )
    return Matchers(in_two_stages, direct, wide, narrow)


def _make_icp(**changed: Any) -> Registration:
    defaults = {each.name: each.default for each in paper.MAP_LINE.parameters}
    made: Registration = paper.MAP_LINE.make(**{**defaults, "share_noise": True, **changed})
    return made
