"""The parameter ``range_min_m`` of the readers: ranges nearer than the robot's own body are left out."""

from __future__ import annotations

from evalkit.core.errors import BadParameter
from evalkit.plugins.parameters import Parameter

RANGE_MIN = Parameter(
    "range_min_m", 0.0, "m", "nearer ranges are invalid, such as those of the robot's own body; 0: as recorded", low=0.0
)


def raise_range_min_m(owner: str, stated_m: float, given_m: float, range_max_m: float) -> float:
    """Return the larger of a stated and a given minimum (m); raises BadParameter if the given one is too large."""
    if not given_m < range_max_m:
        raise BadParameter(owner, "range_min_m", f"{given_m:g}", f"less than the maximum range, {range_max_m:g} m")
    return max(stated_m, given_m)
