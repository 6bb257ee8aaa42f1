"""The paper's method in C99 for embedded boards, run on this host: registration, mapper and pipeline.

The NumPy implementation in ``evalkit_baselines.paper`` is its specification: in double precision the results agree to
1e-9. README.md in this folder describes the core.
"""

from dataclasses import replace
from functools import partial

from evalkit.plugins.parameters import Value, with_defaults
from evalkit.plugins.specs import MapperSpec, OdometrySpec, RegistrationSpec
from evalkit_baselines import paper
from evalkit_baselines.embedded import mapper, pipeline, registration
from evalkit_baselines.embedded.compiled import compiled_missing
from evalkit_baselines.embedded.mapper import CompiledGrid
from evalkit_baselines.embedded.normals import normals_2d as normals_2d
from evalkit_baselines.embedded.pipeline import CompiledPipeline
from evalkit_baselines.embedded.registration import CompiledIcp
from evalkit_baselines.paper import CITATION

SPEC = RegistrationSpec(
    make=partial(CompiledIcp, "double"),
    summary="the paper's ICP in C99, double precision: what 'paper' computes, compiled",
    citation=CITATION,
    licence="MIT",
    parameters=registration.PARAMETERS,
    missing=compiled_missing,
    default=True,
    reference="paper",
)

FLOAT = replace(
    SPEC,
    make=partial(CompiledIcp, "float"),
    summary="the paper's ICP in C99, single precision: what a board without double arithmetic computes",
    default=False,
)

_LASTING_LINES: dict[str, Value] = {
    **{p.name: p.default for p in paper.MAP_LINE.parameters if p.name != "trace"},
    **paper.MAP_LINE.frontend,
}

MAP_LINE = replace(
    SPEC,
    summary="paper-map-line in C99: distances to walls with Cauchy weights, by default in one lasting map",
    parameters=with_defaults(registration.PARAMETERS, **{p.name: p.default for p in paper.MAP_LINE.parameters}),
    frontend=paper.MAP_LINE.frontend,
    tuned_on=paper.MAP_LINE.tuned_on,
    default=False,
    reference="paper-map-line",
)

PIPELINE = OdometrySpec(
    make=CompiledPipeline,
    summary="the paper's whole way from scan to pose in C99: projection, both stages and keyframes in one call",
    citation=CITATION,
    licence="MIT",
    guess="wheel odometry where recorded, else constant velocity",
    parameters=pipeline.PARAMETERS,
    missing=compiled_missing,
    reference="paper",
)

PIPELINE_LINE = replace(
    PIPELINE,
    summary="embedded-map-line from scan to pose in one call: projection, both stages and the lasting map in C99",
    parameters=with_defaults(PIPELINE.parameters, **_LASTING_LINES),
    tuned_on=paper.MAP_LINE.tuned_on,
    reference="paper-map-line",
)

MAPPER = MapperSpec(
    make=partial(CompiledGrid, False),
    summary="the paper's log-odds grid in C99: cells of 16 bits that hold thousandths",
    citation=f"{CITATION}; traversal: Amanatides and Woo 1987",
    licence="MIT",
    parameters=mapper.PARAMETERS,
    missing=compiled_missing,
)

POLYGON_MAPPER = replace(
    MAPPER,
    make=partial(CompiledGrid, True),
    summary="the log-odds grid in C99 with each scan filled as a polygon: every cell inside its outline once",
    citation=CITATION,
    parameters=mapper.POLYGON_PARAMETERS,
    differs="it frees the cells inside the outline of a scan, and not only those that beams cross",
)
