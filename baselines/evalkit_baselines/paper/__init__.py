"""The method of "Occupancy grid mapping based on ICP for indoor autonomous vehicles": ICP in four readings, and map.

What the paper prints and what is meant stands in ``icp``. The readings are the same code with other parameters:

- ``paper``: mean distance, epsilon 1e-4 m, one-to-one pairs: the reading that gives its Table 1.
- ``paper-literal``: equation 5 as printed, the mean *squared* distance with epsilon 1e-4 m^2.
- ``paper-tight``: as ``paper``, but iterated to the end (epsilon 1e-6 m).
- ``paper-map``: as ``paper-tight``, without the one-to-one filter, for dense submaps.
"""

from evalkit.protocols import BackendSpec, MapperSpec, Value, with_defaults
from evalkit_baselines.paper import grid, icp
from evalkit_baselines.paper.grid import LogOddsGrid
from evalkit_baselines.paper.icp import Icp

CITATION = "Occupancy grid mapping based on ICP for indoor autonomous vehicles"


def _reading(summary: str, **defaults: Value) -> BackendSpec:
    return BackendSpec(
        make=Icp,
        kind="registration",
        summary=summary,
        citation=CITATION,
        licence="MIT",
        parameters=with_defaults(icp.PARAMETERS, **defaults),
    )


SPEC = _reading("the paper's point-to-point ICP: one-to-one pairs, mean distance, epsilon 1e-4 m")
LITERAL = _reading("the paper's ICP with eq. 5 as printed: mean squared, epsilon 1e-4 m^2", error="mean-squared")
TIGHT = _reading("the paper's ICP iterated to the end: epsilon 1e-6 m", epsilon=1e-6)
MAP = _reading("the paper's ICP for dense submaps: epsilon 1e-6 m, many-to-one", epsilon=1e-6, one_to_one=False)

MAPPER = MapperSpec(
    make=LogOddsGrid,
    summary="the paper's log-odds grid: 5 cm cells, +-0.847 along every beam, clamped at +-5",
    citation=f"{CITATION}; traversal: Amanatides and Woo 1987",
    licence="MIT",
    parameters=grid.PARAMETERS,
)
