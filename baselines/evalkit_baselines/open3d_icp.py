"""Open3D's three legacy registrations on planar clouds: point-to-point, point-to-plane, generalised ICP.

What the adapters change, and why (Open3D is a 3D library, and z = 0 silently breaks part of it):

* Points get z = 0. Point-to-point then stays exactly in the plane.
* Open3D's ``estimate_normals`` makes every normal of such a cloud the z axis: the point-to-plane residual is zero, and
  the result is the guess with a perfect fitness. With its own covariances, generalised ICP is the same as
  point-to-point. Normals and covariances are therefore computed in the plane by ``evalkit.odometry.planar3d``.
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
import importlib.metadata
import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

from evalkit.core.errors import NotInstalled
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.timing import Cost, Stopwatch
from evalkit.odometry import planar3d
from evalkit.plugins.parameters import declared_parameters, parameter
from evalkit.plugins.specs import RegistrationSpec

INSTALL = "pip install 'evalkit[open3d]'"
SYSTEM_LIBRARIES = ("libGL.so.1", "libEGL.so.1", "libX11.so.6", "libusb-1.0.so.0")
INSTALL_SYSTEM = "apt-get install -y --no-install-recommends libgl1 libegl1 libx11-6 libusb-1.0-0"
OLDEST = (0, 20)
MIN_PAIRS = 3  # two pairs always fit a planar pose exactly

Describe = Callable[[Any, Any, Cloud, Stopwatch], None]
"""Adds normals or covariances to an Open3D cloud; arguments: library, its cloud, evalkit's cloud, conversion time."""


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

    normal_neighbours: int = parameter(20, "", "points that define a wall, the point itself included", low=3)
    normal_radius_m: float = parameter(0.5, "m", "largest distance of these points", low=1e-3)
    kernel: str = parameter("none", "", "robust loss on the residual", choices=("none", "tukey", "huber", "cauchy"))
    kernel_width_m: float = parameter(0.15, "m", "width of the robust loss", low=1e-4)


@dataclass(frozen=True)
class GeneralizedSettings(Open3DPlaneSettings):
    """Parameters of generalised ICP."""

    epsilon: float = parameter(1e-3, "", "variance across a wall, 1 along it", low=1e-9, high=1.0)


class Open3DRegistration:
    """A Registration by one of Open3D's legacy methods; the Open3D cloud of a target lives as long as the target."""

    def __init__(
        self,
        open3d: Any,
        method: Callable[..., Any],
        estimation: Any,
        describe_target: Describe,
        describe_source: Describe,
        settings: Open3DPointSettings,
    ) -> None:
        self._open3d = open3d
        self._method = method
        self._estimation = estimation
        self._describe_target = describe_target
        self._describe_source = describe_source
        self._max_correspondence_m = settings.max_correspondence_m
        self._criteria = open3d.pipelines.registration.ICPConvergenceCriteria(
            relative_fitness=settings.relative_fitness,
            relative_rmse=settings.relative_rmse,
            max_iteration=settings.max_iterations,
        )
        # by identity: clouds are frozen, so the normals of a local map stay valid
        self._targets: WeakKeyDictionary[Cloud, Any] = WeakKeyDictionary()

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``; ``error`` is the root mean square distance (m) of the final pairs.

        Not converged, with the guess as the answer, where fewer than three points have a partner or where the result
        left the plane: pairs on one line let a rotation by half a turn about that line fit as well.
        """
        conversion = Stopwatch()
        if min(len(target), len(source)) < MIN_PAIRS:
            return Match.not_converged(guess, 0, Cost(conversion.cpu_ns))
        fixed = self._targets.get(target)
        if fixed is None:
            fixed = self._targets[target] = self._to_open3d(target, self._describe_target, conversion)
        moving = self._to_open3d(source, self._describe_source, conversion)
        with conversion:
            initial = planar3d.matrix_4x4(guess)
        result = self._method(moving, fixed, self._max_correspondence_m, initial, self._estimation, self._criteria)
        with conversion:
            pairs = len(result.correspondence_set)
        if pairs < MIN_PAIRS:
            return Match.not_converged(guess, pairs, Cost(conversion.cpu_ns))
        try:
            with conversion:
                answer = planar3d.pose_2d(result.transformation)
        except ValueError:  # turned over
            return Match.not_converged(guess, 0, Cost(conversion.cpu_ns))
        cost = Cost(conversion.cpu_ns)
        return Match(answer, converged=True, iterations=0, error=float(result.inlier_rmse), inliers=pairs, cost=cost)

    def _to_open3d(self, cloud: Cloud, describe: Describe, conversion: Stopwatch) -> Any:
        with conversion:
            space = self._open3d.geometry.PointCloud(
                self._open3d.utility.Vector3dVector(planar3d.points_3d(cloud.points))
            )
        describe(self._open3d, space, cloud, conversion)
        return space


def point_to_point(**parameters: Any) -> Open3DRegistration:
    """Make Open3D's point-to-point ICP with the parameters of ``PointSettings``."""
    settings = Open3DPointSettings(**parameters)
    open3d = _import_open3d()
    methods = open3d.pipelines.registration
    estimation = methods.TransformationEstimationPointToPoint()
    return Open3DRegistration(open3d, methods.registration_icp, estimation, _add_nothing, _add_nothing, settings)


def point_to_plane(**parameters: Any) -> Open3DRegistration:
    """Make Open3D's point-to-plane ICP on normals computed in the plane, with the parameters of ``PlaneSettings``."""
    settings = Open3DPlaneSettings(**parameters)
    open3d = _import_open3d()
    methods = open3d.pipelines.registration

    def with_normals(library: Any, space: Any, cloud: Cloud, conversion: Stopwatch) -> None:
        normals = planar3d.normals(cloud.points, settings.normal_neighbours, settings.normal_radius_m)
        with conversion:
            space.normals = library.utility.Vector3dVector(planar3d.points_3d(normals))

    estimation = methods.TransformationEstimationPointToPlane(_make_loss(methods, settings))
    return Open3DRegistration(open3d, methods.registration_icp, estimation, with_normals, _add_nothing, settings)


def generalized(**parameters: Any) -> Open3DRegistration:
    """Make Open3D's generalised ICP on covariances computed in the plane; parameters as in ``GeneralizedSettings``."""
    settings = GeneralizedSettings(**parameters)
    open3d = _import_open3d()
    methods = open3d.pipelines.registration

    def with_covariances(library: Any, space: Any, cloud: Cloud, conversion: Stopwatch) -> None:
        normals = planar3d.normals(cloud.points, settings.normal_neighbours, settings.normal_radius_m)
        covariances = planar3d.covariances_3d(normals, settings.epsilon)
        with conversion:
            space.covariances = library.utility.Matrix3dVector(covariances)

    estimation = methods.TransformationEstimationForGeneralizedICP(settings.epsilon, _make_loss(methods, settings))
    return Open3DRegistration(
        open3d, methods.registration_generalized_icp, estimation, with_covariances, with_covariances, settings
    )


def open3d_missing() -> str:
    """Return why Open3D cannot be imported and how to install it, or ""; does not import it (1.3 s)."""
    if importlib.util.find_spec("open3d") is None:
        return f"not installed: {INSTALL}"
    if (found := _read_version()) and found < OLDEST:
        return f"open3d {found[0]}.{found[1]} cannot be limited to one thread, 0.20 can: {INSTALL} --upgrade"
    if sys.platform != "linux":
        return ""
    absent = [name for name in SYSTEM_LIBRARIES if not _can_load(name)]
    return f"open3d needs missing system libraries ({', '.join(absent)}): {INSTALL_SYSTEM}" if absent else ""


def _add_nothing(_library: Any, _space: Any, _cloud: Cloud, _conversion: Stopwatch) -> None:
    """Add nothing: point-to-point needs only points."""


def _make_loss(methods: Any, settings: Open3DPlaneSettings) -> Any:
    losses = {
        "none": methods.L2Loss,
        "tukey": lambda: methods.TukeyLoss(settings.kernel_width_m),
        "huber": lambda: methods.HuberLoss(settings.kernel_width_m),
        "cauchy": lambda: methods.CauchyLoss(settings.kernel_width_m),
    }
    return losses[settings.kernel]()


def _import_open3d() -> Any:
    try:
        import open3d  # noqa: PLC0415 - heavy: imported only for a run
    except (ImportError, OSError) as error:
        raise NotInstalled("open3d", f"does not load ({error})", open3d_missing() or INSTALL) from error
    open3d.utility.set_max_threads(1)
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)  # the Match reports what Open3D would print
    return open3d


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
    role="",
    parameters=declared_parameters(Open3DPlaneSettings),
    default=True,
)

GENERALIZED = replace(
    POINT_TO_PLANE,
    make=generalized,
    summary="Open3D generalised ICP with covariances computed in the plane",
    citation=f"Segal, Haehnel and Thrun, RSS 2009; {_OPEN3D}",
    parameters=declared_parameters(GeneralizedSettings),
    default=False,
)
