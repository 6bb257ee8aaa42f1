"""Open3D's three legacy registrations on planar clouds: point-to-point, point-to-plane, generalised ICP.

What the adapters change, and why (Open3D is a 3D library, and z = 0 silently breaks part of it):

* Points get z = 0. Point-to-point then stays exactly in the plane.
* Open3D's ``estimate_normals`` makes every normal of such a cloud the z axis: the point-to-plane residual is zero, and
  the result is the guess with a perfect fitness. With its own covariances, generalised ICP is the same as
  point-to-point. Normals are therefore computed in the plane by the compiled core, covariances from them; the time is
  reported apart (``preparation_ns``). A cloud's are computed once, for both stages and for the next scan.
* The legacy pipeline is used, not the tensor one: the tensor point-to-plane rejects planar input as a singular system.
* In 3D, a rotation by half a turn about a wall mirrors it: near single walls the point-to-point result may be turned
  over (Open3D does so for half of all rough, short walls). Such a result is rejected: the guess is kept, not converged.
* One thread on every machine, because the last bits of a sum depend on how it is split.
* ``relative_fitness`` and ``relative_rmse`` keep Open3D's names; it compares them with absolute changes.

Open3D reports neither the number of iterations nor whether it stopped by its criterion or by the limit. ``iterations``
is therefore 0, and ``converged`` only means that enough points had a partner at the end.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import importlib.metadata
import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

from evalkit.core.errors import NotInstalled
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.odometry import planar3d
from evalkit.plugins.parameters import declared_parameters, parameter
from evalkit.plugins.specs import RegistrationSpec
from evalkit_baselines.embedded.compiled import compiled_missing
from evalkit_baselines.embedded.normals import MAX_NEIGHBOURS, normals_2d
from evalkit_baselines.planar_registration import (
    AdapterClocks,
    LibraryAnswer,
    PlanarRegistration,
    Prepare,
    keep_prepared,
)

INSTALL = "pip install 'evalkit[open3d]'"
SYSTEM_LIBRARIES = ("libGL.so.1", "libEGL.so.1", "libX11.so.6", "libusb-1.0.so.0")
INSTALL_SYSTEM = "apt-get install -y --no-install-recommends libgl1 libegl1 libx11-6 libusb-1.0-0"
OLDEST = (0, 20)
DRAWING = "open3d.visualization.draw_plotly"

Describe = Callable[[Any, Cloud, AdapterClocks], None]
"""Adds normals or covariances to an Open3D cloud made of evalkit's cloud."""


@dataclass(frozen=True)
class Open3DPointSettings:
    """Parameters of point-to-point ICP, and of the other two methods."""

    max_correspondence_m: float = parameter(0.2, "m", "largest distance of a pair", low=1e-3)
    max_iterations: int = parameter(40, "", "largest number of iterations", low=1)
    relative_fitness: float = parameter(1e-6, "", "stop where the share of paired points changes by less", low=0.0)
    relative_rmse: float = parameter(1e-6, "m", "and the root mean square distance changes by less", low=0.0)


@dataclass(frozen=True)
class Open3DPlaneSettings(Open3DPointSettings):
    """Parameters of point-to-plane ICP."""

    normal_neighbours: int = parameter(
        20, "", "points that define a wall, the point itself included", low=3, high=MAX_NEIGHBOURS
    )
    normal_radius_m: float = parameter(0.5, "m", "largest distance of these points", low=1e-3)
    kernel: str = parameter("none", "", "robust loss on the residual", choices=("none", "tukey", "huber", "cauchy"))
    kernel_width_m: float = parameter(0.15, "m", "width of the robust loss", low=1e-4)


@dataclass(frozen=True)
class GeneralizedSettings(Open3DPlaneSettings):
    """Parameters of generalised ICP."""

    epsilon: float = parameter(1e-3, "", "variance across a wall, 1 along it", low=1e-9, high=1.0)


def point_to_point(**parameters: Any) -> PlanarRegistration:
    """Make Open3D's point-to-point ICP with the parameters of ``Open3DPointSettings``."""
    settings = Open3DPointSettings(**parameters)
    open3d = _import_open3d()
    methods = open3d.pipelines.registration
    plain = _to_open3d(open3d)
    align = _make_align(methods, methods.registration_icp, methods.TransformationEstimationPointToPoint(), settings)
    return PlanarRegistration(plain, plain, align)


def point_to_plane(**parameters: Any) -> PlanarRegistration:
    """Make Open3D's point-to-plane ICP on normals computed in the plane (``Open3DPlaneSettings``)."""
    settings = Open3DPlaneSettings(**parameters)
    open3d = _import_open3d()
    methods = open3d.pipelines.registration

    def add_normals(space: Any, cloud: Cloud, clocks: AdapterClocks) -> None:
        with clocks.preparation:
            normals = normals_2d(cloud.points, settings.normal_neighbours, settings.normal_radius_m)
        with clocks.conversion:
            space.normals = open3d.utility.Vector3dVector(planar3d.points_3d(normals))

    with_normals = _to_open3d(open3d, add_normals, (settings.normal_neighbours, settings.normal_radius_m))
    estimation = methods.TransformationEstimationPointToPlane(_make_loss(methods, settings))
    align = _make_align(methods, methods.registration_icp, estimation, settings)
    return PlanarRegistration(with_normals, _to_open3d(open3d), align)


def generalized(**parameters: Any) -> PlanarRegistration:
    """Make Open3D's generalised ICP on covariances computed in the plane; parameters as in ``GeneralizedSettings``."""
    settings = GeneralizedSettings(**parameters)
    open3d = _import_open3d()
    methods = open3d.pipelines.registration

    def add_covariances(space: Any, cloud: Cloud, clocks: AdapterClocks) -> None:
        with clocks.preparation:
            normals = normals_2d(cloud.points, settings.normal_neighbours, settings.normal_radius_m)
            covariances = planar3d.covariances_3d(normals, settings.epsilon)
        with clocks.conversion:
            space.covariances = open3d.utility.Matrix3dVector(covariances)

    key = (settings.normal_neighbours, settings.normal_radius_m, settings.epsilon)
    with_covariances = _to_open3d(open3d, add_covariances, key)
    estimation = methods.TransformationEstimationForGeneralizedICP(settings.epsilon, _make_loss(methods, settings))
    align = _make_align(methods, methods.registration_generalized_icp, estimation, settings)
    return PlanarRegistration(with_covariances, with_covariances, align)


def _to_open3d(open3d: Any, describe: Describe | None = None, key: tuple[float, ...] = ()) -> Prepare:
    """The conversion of a cloud to an Open3D cloud; ``key``: the settings of ``describe``."""

    def convert(cloud: Cloud, clocks: AdapterClocks) -> Any:
        with clocks.conversion:
            space = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(planar3d.points_3d(cloud.points)))
        if describe is not None:
            describe(space, cloud, clocks)
        return space

    return keep_prepared(("open3d", *key), convert)


def _make_align(methods: Any, method: Callable[..., Any], estimation: Any, settings: Open3DPointSettings) -> Any:
    criteria = methods.ICPConvergenceCriteria(
        relative_fitness=settings.relative_fitness,
        relative_rmse=settings.relative_rmse,
        max_iteration=settings.max_iterations,
    )

    def align(fixed: Any, moving: Any, initial: Floats) -> LibraryAnswer:
        found = method(moving, fixed, settings.max_correspondence_m, initial, estimation, criteria)
        return LibraryAnswer(found.transformation, len(found.correspondence_set), float(found.inlier_rmse))

    return align


def open3d_missing() -> str:
    """Return why Open3D cannot be imported and how to install it, or ""; does not import it (1.3 s)."""
    if importlib.util.find_spec("open3d") is None:
        return f"not installed: {INSTALL}"
    if (found := _read_version()) and found < OLDEST:
        return f"open3d {found[0]}.{found[1]} cannot be limited to one thread, 0.20 can: {INSTALL}"
    if sys.platform != "linux":
        return ""
    absent = [name for name in SYSTEM_LIBRARIES if not _can_load(name)]
    return f"open3d needs missing system libraries ({', '.join(absent)}): {INSTALL_SYSTEM}" if absent else ""


def plane_missing() -> str:
    """Return what is missing for the methods with normals: Open3D, or the compiled core."""
    return open3d_missing() or compiled_missing()


def _make_loss(methods: Any, settings: Open3DPlaneSettings) -> Any:
    losses = {
        "none": methods.L2Loss,
        "tukey": lambda: methods.TukeyLoss(settings.kernel_width_m),
        "huber": lambda: methods.HuberLoss(settings.kernel_width_m),
        "cauchy": lambda: methods.CauchyLoss(settings.kernel_width_m),
    }
    return losses[settings.kernel]()


def _import_open3d() -> Any:
    _defer_drawing()
    try:
        import open3d  # noqa: PLC0415 - heavy: imported only for a run
    except (ImportError, OSError) as error:
        raise NotInstalled("open3d", f"does not load ({error})", open3d_missing() or INSTALL) from error
    open3d.utility.set_max_threads(1)
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)  # the Match reports what Open3D would print
    return open3d


def _defer_drawing() -> None:
    """Let Open3D import its drawing in a browser on first use: it loads plotly and dash, half of the time of all."""
    deferred: list[str] = []

    def load() -> ModuleType:
        if sys.modules.get(DRAWING) is placeholder:
            del sys.modules[DRAWING]
            drawing = importlib.import_module(DRAWING)
            vars(sys.modules[DRAWING.rpartition(".")[0]]).update({name: getattr(drawing, name) for name in deferred})
        return sys.modules[DRAWING]

    def defer(name: str) -> Callable[..., Any]:
        if name.startswith("__"):
            raise AttributeError(name)
        deferred.append(name)

        def draw(*arguments: Any, **keywords: Any) -> Any:
            return getattr(load(), name)(*arguments, **keywords)

        return draw

    placeholder = ModuleType(DRAWING)
    vars(placeholder)["__getattr__"] = defer
    if "open3d" not in sys.modules:
        sys.modules[DRAWING] = placeholder


def _read_version() -> tuple[int, ...]:
    """Return the major and minor version, () without package metadata (a custom build)."""
    for package in ("open3d-cpu", "open3d"):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            return tuple(int(part) for part in importlib.metadata.version(package).split(".")[:2])
    return ()


def _can_load(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


_OPEN3D = "Zhou, Park and Koltun, Open3D: a modern library for 3D data processing, arXiv:1801.09847, 2018"

POINT_TO_POINT = RegistrationSpec(
    make=point_to_point,
    summary="Open3D point-to-point ICP",
    citation=f"Besl and McKay, PAMI 1992; {_OPEN3D}",
    licence="MIT",
    role="peer",
    requires=("open3d",),
    parameters=declared_parameters(Open3DPointSettings),
    missing=open3d_missing,
)

POINT_TO_PLANE = replace(
    POINT_TO_POINT,
    make=point_to_plane,
    summary="Open3D point-to-plane ICP with normals computed in the plane",
    citation=f"Chen and Medioni, IVC 1992; {_OPEN3D}",
    parameters=declared_parameters(Open3DPlaneSettings),
    default=True,
    missing=plane_missing,
)

GENERALIZED = replace(
    POINT_TO_PLANE,
    make=generalized,
    summary="Open3D generalised ICP with covariances computed in the plane",
    citation=f"Segal, Haehnel and Thrun, RSS 2009; {_OPEN3D}",
    role="",  # one peer of each kind of ICP and library is enough
    parameters=declared_parameters(GeneralizedSettings),
    default=False,
)
