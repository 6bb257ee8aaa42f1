"""The method of "Occupancy grid mapping based on ICP for indoor autonomous vehicles": five variants, and the mapper.

The docstring of ``icp`` lists the printed equations and their corrections. The variants are the same code with other
parameters:

- ``paper``: mean distance, epsilon 1e-4 m, one-to-one pairs: the variant that gives its Table 1.
- ``paper-literal``: equation 5 as printed, the mean *squared* distance with epsilon 1e-4 m^2.
- ``paper-tight``: as ``paper``, but with iterations to convergence (epsilon 1e-6 m).
- ``paper-map``: as ``paper-tight`` and many-to-one, against one lasting map instead of the last keyframes, so that
  revisited places are matched where they were first seen.
- ``paper-map-line``: the same with the distance to the wall instead of to the point, with Cauchy weights.

The settings of the two lasting maps (voxels of 10 cm, keyframes every 0.3 m or 10 deg, a Cauchy weight of 10 cm for the
lines) were chosen on the recordings fr079 and intel, the same for both; ``baselines/README.md`` describes the choice of
the largest distances of a pair.
"""

from collections.abc import Mapping

from evalkit.plugins.parameters import Value, with_defaults
from evalkit.plugins.specs import MapperSpec, RegistrationSpec
from evalkit_baselines.paper import grid, icp
from evalkit_baselines.paper.grid import LogOddsGrid
from evalkit_baselines.paper.icp import Icp

CITATION = "Occupancy grid mapping based on ICP for indoor autonomous vehicles"


def _variant(
    summary: str, frontend: Mapping[str, Value] | None = None, default: bool = False, **defaults: Value
) -> RegistrationSpec:
    return RegistrationSpec(
        make=Icp,
        summary=summary,
        citation=CITATION,
        licence="MIT",
        role="" if frontend else "reference",  # the paper has no lasting map
        parameters=with_defaults(icp.PARAMETERS, **defaults),
        frontend=frontend or {},
        tuned_on=("fr079", "intel") if frontend else (),
        default=default,
    )


LASTING_MAP: dict[str, Value] = {
    "local_map": "voxels",
    "local_map_voxel_m": 0.1,
    "keyframe_distance_m": 0.3,
    "keyframe_angle_deg": 10.0,
}

SPEC = _variant("the paper's point-to-point ICP: one-to-one pairs, mean distance, epsilon 1e-4 m")
LITERAL = _variant("the paper's ICP with eq. 5 as printed: mean squared, epsilon 1e-4 m^2", error="mean-squared")
TIGHT = _variant("the paper's ICP with iterations to convergence: epsilon 1e-6 m", epsilon=1e-6)
MAP = _variant(
    "paper-tight, many-to-one, against one lasting map",
    LASTING_MAP,
    epsilon=1e-6,
    one_to_one=False,
    max_correspondence_m=0.2,
)
MAP_LINE = _variant(
    "paper-map with the distance to the wall instead of to the point",
    LASTING_MAP,
    default=True,
    epsilon=1e-6,
    one_to_one=False,
    metric="line",
    cauchy_m=0.1,
    max_correspondence_m=1.0,
)

MAPPER = MapperSpec(
    make=LogOddsGrid,
    summary="the paper's log-odds grid: 5 cm cells, +-0.847 along every beam, clamped at +-5",
    citation=f"{CITATION}; traversal: Amanatides and Woo 1987",
    licence="MIT",
    parameters=grid.PARAMETERS,
    default=True,
)
