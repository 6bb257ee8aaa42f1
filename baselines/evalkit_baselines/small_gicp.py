"""small_gicp's point-to-plane and point-to-point ICP on planar clouds.

What the adapters change, and why (small_gicp is a 3D library, and z = 0 silently breaks part of it):

* Points get z = 0. Point-to-point then stays exactly in the plane.
* small_gicp estimates normals itself and accepts none from Python. For a cloud at z = 0 all normals are vertical, the
  residual is zero and the result is the guess. For point-to-plane the *target* is therefore extruded to three layers,
  ``layer_m`` below, at and above 0, so that walls have an area; the source stays flat and matches the middle layer. The
  30 neighbours of a normal are ten points of the plane, three times each.
* Its point-to-plane weights each axis separately (normal times distance, in x and in y), not the distance along the
  normal: the same at walls parallel to the target's axes, half a point-to-point at diagonal walls. This is unchanged.
* Its generalised ICP is left out: it computes covariances like normals, and with a flat source it is identical to its
  point-to-point ICP.
* A result that left the plane is rejected: the guess is kept, not converged.
* One thread. Cloud, tree and normals of a target live as long as the target.
* ``translation_epsilon_m`` and ``rotation_epsilon_deg`` are a tenth of its defaults (1 mm, 0.1 deg). With the defaults
  point-to-point stops centimetres early, and the result depends on the position of the source's frame.

``error`` is the root of twice small_gicp's mean cost: for point-to-point the root mean square distance (m).
"""

from __future__ import annotations

import importlib.util
import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from evalkit.core.errors import NotInstalled
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.odometry import planar3d
from evalkit.plugins.parameters import declared_parameters, parameter
from evalkit.plugins.specs import RegistrationSpec
from evalkit_baselines.planar_registration import (
    AdapterClocks,
    LibraryAnswer,
    PlanarRegistration,
    Prepare,
    keep_prepared,
)

INSTALL = "pip install 'evalkit[small-gicp]'"


@dataclass(frozen=True)
class SmallGicpPointSettings:
    """Parameters of point-to-point ICP, and of the other method."""

    max_correspondence_m: float = parameter(0.2, "m", "largest distance of a pair", low=1e-3)
    max_iterations: int = parameter(40, "", "largest number of iterations", low=1, high=1_000_000)
    translation_epsilon_m: float = parameter(1e-4, "m", "stop where a step is shorter", low=0.0)
    rotation_epsilon_deg: float = parameter(0.01, "deg", "and turns by less", low=0.0)


@dataclass(frozen=True)
class SmallGicpPlaneSettings(SmallGicpPointSettings):
    """Parameters of point-to-plane ICP."""

    normal_neighbours: int = parameter(30, "", "points of all three layers that define a wall", low=5, high=10_000)
    layer_m: float = parameter(0.12, "m", "height of a layer above the one below", low=1e-3)


def point_to_point(**parameters: Any) -> PlanarRegistration:
    """Make small_gicp's point-to-point ICP with the parameters of ``SmallGicpPointSettings``."""
    library = _import_small_gicp()

    def make_flat(cloud: Cloud, clocks: AdapterClocks) -> tuple[Any, Any]:
        with clocks.conversion:
            space = library.PointCloud(planar3d.points_3d(cloud.points))
        return space, library.KdTree(space, num_threads=1)

    return _make(library, "ICP", keep_prepared("small_gicp flat", make_flat), SmallGicpPointSettings(**parameters))


def point_to_plane(**parameters: Any) -> PlanarRegistration:
    """Make small_gicp's point-to-plane ICP on a target extruded to three layers (``SmallGicpPlaneSettings``)."""
    library, settings = _import_small_gicp(), SmallGicpPlaneSettings(**parameters)

    def extrude(cloud: Cloud, clocks: AdapterClocks) -> tuple[Any, Any]:
        with clocks.conversion:
            space = library.PointCloud(extrude_layers(cloud.points, settings.layer_m))
        tree = library.KdTree(space, num_threads=1)
        library.estimate_normals_covariances(space, tree, num_neighbors=settings.normal_neighbours, num_threads=1)
        return space, tree

    key = ("small_gicp layers", settings.layer_m, settings.normal_neighbours)
    return _make(library, "PLANE_ICP", keep_prepared(key, extrude), settings)


def _make(library: Any, method: str, target: Prepare, settings: SmallGicpPointSettings) -> PlanarRegistration:
    def convert(cloud: Cloud, clocks: AdapterClocks) -> Any:
        with clocks.conversion:
            return library.PointCloud(planar3d.points_3d(cloud.points))

    def align(fixed: tuple[Any, Any], moving: Any, initial: Floats) -> LibraryAnswer:
        cloud, tree = fixed
        found = library.align(
            cloud, moving, tree, init_T_target_source=initial, registration_type=method,
            max_correspondence_distance=settings.max_correspondence_m, max_iterations=settings.max_iterations,
            translation_epsilon=settings.translation_epsilon_m,
            rotation_epsilon=math.radians(settings.rotation_epsilon_deg), num_threads=1,
        )  # fmt: skip
        pairs = int(found.num_inliers)
        error = math.sqrt(2.0 * max(float(found.error), 0.0) / max(pairs, 1))
        return LibraryAnswer(found.T_target_source, pairs, error, bool(found.converged), int(found.iterations))

    return PlanarRegistration(target, keep_prepared("small_gicp source", convert), align)


def extrude_layers(points: Floats, height_m: float) -> Floats:
    """Return the points (3 N, 3) of a planar cloud (N, 2), ``height_m`` below, at and above z = 0."""
    space = np.tile(planar3d.points_3d(points), (3, 1))
    space[:, 2] = np.repeat([-height_m, 0.0, height_m], len(points))
    return space


def small_gicp_missing() -> str:
    """Return why small_gicp cannot be imported and how to install it, or ""; does not import it."""
    return "" if importlib.util.find_spec("small_gicp") else f"not installed: {INSTALL}"


def _import_small_gicp() -> Any:
    try:
        import small_gicp  # noqa: PLC0415 - optional
    except ImportError as error:
        raise NotInstalled("small_gicp", f"does not load ({error})", INSTALL) from error
    return small_gicp


_LIBRARY = "Koide, small_gicp: efficient and parallel algorithms for point cloud registration, JOSS 9(100), 2024"

POINT_TO_PLANE = RegistrationSpec(
    make=point_to_plane,
    summary="small_gicp point-to-plane ICP on walls of three layers",
    citation=f"Chen and Medioni, IVC 1992; {_LIBRARY}",
    licence="MIT",
    role="peer",
    requires=("small_gicp",),
    parameters=declared_parameters(SmallGicpPlaneSettings),
    missing=small_gicp_missing,
    default=True,
)

POINT_TO_POINT = replace(
    POINT_TO_PLANE,
    make=point_to_point,
    summary="small_gicp point-to-point ICP",
    role="",
    citation=f"Besl and McKay, PAMI 1992; {_LIBRARY}",
    parameters=declared_parameters(SmallGicpPointSettings),
    default=False,
)
