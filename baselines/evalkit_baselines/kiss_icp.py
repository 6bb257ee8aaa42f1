"""KISS-ICP as an odometry for planar scans, with its own deskewing, voxel map, adaptive threshold and robust ICP.

What the adapter changes, and why (KISS-ICP is made for 3D lidars outdoors):

* Points get z = 0; point-to-point ICP then stays in the plane. Points are in the base frame, so the poses are those of
  the base. Points closer than ``min_range_m`` to the sensor are removed first.
* ``max_range_m`` is 12 for every lidar: the threshold grows with it, and indoors a longer range is measurably worse
  (intel: 0.054 m at 12 m, 0.060 m at 30 m, mean over the short relations).
* ``voxel_size_m`` is 0.12, a hundredth of 12 m as in KISS-ICP's own rule. It does not follow ``max_range_m``, because a
  coarser grid leaves too few points of a planar scan.
* KISS-ICP moves a scan's points to the scan's *end*; its poses are those of the end. The adapter moves the pose back to
  the first beam by the motion that was used for deskewing, so that points and pose stay consistent.
* KISS-ICP has no times: it uses the last motion between two scans for the next one, and for the motion from the first
  to the last point. The adapter computes both from the times of the beams: no-returns at either end do not stretch the
  motion, and after a dropped scan the prediction is doubled (never more). For evenly spaced scans both are the same;
  with the uneven stamps of fr079 KISS-ICP alone loses the track.
* With ``prior = "odometry"`` both come from wheel odometry, the same guess that every other back end gets. With
  ``"constant-velocity"`` they come from its own last two poses, as in the paper. In a recording without odometry the
  two settings are the same.
* A scan of fewer than ``min_points`` points is not registered, because KISS-ICP accepts any result; the prediction is
  returned.
* KISS-ICP does not report whether it found pairs. A result equal to the prediction to the last digit has none and is
  reported as not accepted.
* All settings are made here. KISS-ICP's own loader lets environment variables change them silently.
* One thread.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from typing import Any

import numpy as np

from evalkit.core import se2
from evalkit.core.errors import NotInstalled
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.core.timing import Cost, Stopwatch
from evalkit.odometry import planar3d
from evalkit.plugins.parameters import declared_parameters, parameter
from evalkit.plugins.specs import OdometrySpec

INSTALL = "pip install 'evalkit[kiss-icp]'"
UNMOVED = 1e-12  # m and rad: rounding of a pose converted to a matrix and back
MAX_STEPS = 2.0  # after a long gap the last speed has no meaning: as in evalkit's front end
BEYOND_M = 1e6  # beyond any max_range: KISS-ICP removes such points after it has read their times


@dataclass(frozen=True, slots=True)
class KissSettings:
    """Parameters of KISS-ICP."""

    prior: str = parameter(
        "odometry",
        "",
        "source of the prediction; without odometry: constant velocity",
        choices=("odometry", "constant-velocity"),
    )
    deskew: bool = parameter(True, "", "undo the motion within a scan by the prediction's velocity")
    max_range_m: float = parameter(12.0, "m", "longest range used; the lidar's own where that is shorter", low=0.1)
    min_range_m: float = parameter(0.15, "m", "shortest range used", low=0.0)
    voxel_size_m: float = parameter(0.12, "m", "cell of its map; scans are thinned to 1.5 of it", low=1e-3)
    max_points_per_voxel: int = parameter(20, "", "largest number of points that its map keeps in a cell", low=1)
    initial_threshold_m: float = parameter(
        2.0, "m", "three times this is the first largest distance of a pair", low=1e-3
    )
    min_motion_m: float = parameter(0.1, "m", "corrections below this do not adapt the threshold", low=0.0)
    max_iterations: int = parameter(500, "", "largest number of iterations", low=1)
    convergence_m: float = parameter(
        1e-4, "m", "stop where a step is smaller (norm of its metres and radians)", low=0.0
    )
    min_points: int = parameter(
        10, "", "a scan of fewer points is not registered; the prediction is kept", low=1
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class _LastScan:
    """State for the next prediction: poses in the start frame at the first and the last beam, time of the last beam."""

    first: Pose
    end: Pose
    end_ns: int
    odom_from_base: Pose | None


class KissIcpOdometry:
    """KISS-ICP on one sequence."""

    def __init__(self, settings: KissSettings) -> None:
        self._modules = _import_kiss_icp()
        self._settings = settings
        self._kiss: Any = None
        self._last: _LastScan | None = None
        self._step, self._step_ns = Pose(), 1

    def update(self, frame: Frame) -> OdometryEstimate:
        """Process one scan; ``accepted`` is reported from the second scan on."""
        conversion = Stopwatch()
        if self._kiss is None:
            self._kiss = self._make_kiss_icp(frame)
        first, first_from_end = self._predict(frame)
        with conversion:
            points, beams = self._points(frame)
        predicted = end = first @ first_from_end
        if len(points) >= self._settings.min_points:
            times = self._times(frame, beams, first_from_end)
            end = self._register(points, times, first, first_from_end, conversion)
        moved = max(abs(end.x - predicted.x), abs(end.y - predicted.y), abs(end.theta - predicted.theta)) > UNMOVED
        accepted = None if self._last is None else moved
        pose = Pose() if self._last is None else end @ first_from_end.inverse()
        self._remember(frame, pose, end)
        return OdometryEstimate(pose, accepted=accepted, cost=Cost(conversion.cpu_ns))

    def _make_kiss_icp(self, frame: Frame) -> Any:
        """Make KISS-ICP with all its settings, on the first scan, because that has the lidar's range."""
        pipeline, config = self._modules
        s = self._settings
        # range limits are the sensor's, but KISS-ICP measures from the base, where its points are
        reach = min(s.max_range_m, frame.scan.range_max_m) + float(np.hypot(*frame.base_from_sensor.row[:2]))
        own = config.config
        settings = config.KISSConfig.model_construct(  # unlike the constructor, this reads no environment variables
            data=own.DataConfig(max_range=reach, min_range=0.0, deskew=s.deskew),
            mapping=own.MappingConfig(voxel_size=s.voxel_size_m, max_points_per_voxel=s.max_points_per_voxel),
            registration=own.RegistrationConfig(
                max_num_iterations=s.max_iterations, convergence_criterion=s.convergence_m, max_num_threads=1
            ),
            adaptive_threshold=own.AdaptiveThresholdConfig(
                fixed_threshold=None, initial_threshold=s.initial_threshold_m, min_motion_th=s.min_motion_m
            ),
        )
        return pipeline.KissICP(settings)

    def _predict(self, frame: Frame) -> tuple[Pose, Pose]:
        """Return the prediction ``start_from_first`` and the motion ``first_from_end`` within the scan."""
        wheels = self._settings.prior == "odometry"
        within = frame.start_from_end if wheels else None
        if within is None:
            within = self._constant_velocity(frame.scan.duration_ns)
        if not self._settings.deskew:
            within = Pose()
        if self._last is None:
            return Pose(), within
        before, now = self._last.odom_from_base, frame.odom_from_base
        if wheels and before is not None and now is not None:
            return self._last.first @ before.inverse() @ now, within
        end = self._last.end @ self._constant_velocity(_end_ns(frame) - self._last.end_ns)
        return end @ within.inverse(), within

    def _constant_velocity(self, elapsed_ns: int) -> Pose:
        share = min(elapsed_ns / self._step_ns, MAX_STEPS)
        return Pose.of(se2.fraction(self._step.row, [share])[0])

    def _points(self, frame: Frame) -> tuple[Floats, Floats]:
        """Return the usable hits in the base frame (N, 3), and the number of each one's beam (N,)."""
        scan = frame.scan
        limit = min(self._settings.max_range_m, scan.range_max_m)
        used = scan.ranges[scan.hits]
        near = (used >= self._settings.min_range_m) & (used <= limit)
        beams = np.flatnonzero(scan.hits)[near].astype(np.float64)
        return planar3d.points_3d(frame.base_from_sensor.transform(scan.points()[near])), beams

    def _times(self, frame: Frame, beams: Floats, first_from_end: Pose) -> Floats:
        """Return the times (N,) as shares of the scan, empty without motion or without times.

        Equal times abort the process, because KISS-ICP divides by their span.
        """
        still = not np.any(first_from_end.row)
        return np.zeros(0) if still or frame.scan.duration_ns == 0 else beams / (len(frame.scan.ranges) - 1)

    def _register(
        self, points: Floats, times: Floats, first: Pose, first_from_end: Pose, conversion: Stopwatch
    ) -> Pose:
        """Return ``start_from_end`` after KISS-ICP's registration from the prediction."""
        with conversion:
            if len(times):  # KISS-ICP normalises times: these two are those of the first and the last beam
                times = np.concatenate([times, [0.0, 1.0]])
                points = np.concatenate([points, np.full((2, 3), BEYOND_M)])
            # it deskews with last_delta and starts from last_pose @ last_delta
            self._kiss.last_pose = planar3d.matrix_4x4(first)
            self._kiss.last_delta = planar3d.matrix_4x4(first_from_end)
        self._kiss.register_frame(points, times)
        with conversion:
            return planar3d.pose_2d(self._kiss.last_pose)

    def _remember(self, frame: Frame, answer: Pose, end: Pose) -> None:
        if self._last is not None:
            # from end to end: from first beam to first beam an error of the speed would not decay
            self._step = self._last.end.inverse() @ end
            self._step_ns = max(_end_ns(frame) - self._last.end_ns, 1)
        self._last = _LastScan(answer, end, _end_ns(frame), frame.odom_from_base)


def make(**parameters: Any) -> KissIcpOdometry:
    """Make a new KISS-ICP with the parameters of ``KissSettings``."""
    return KissIcpOdometry(KissSettings(**parameters))


def kiss_icp_missing() -> str:
    """Return why KISS-ICP cannot be imported and how to install it, or ""; does not import it (1 s)."""
    return f"not installed: {INSTALL}" if importlib.util.find_spec("kiss_icp") is None else ""


def _import_kiss_icp() -> tuple[Any, Any]:
    """Import the modules of the pipeline and of its settings; raises NotInstalled."""
    try:
        from kiss_icp import config, kiss_icp  # noqa: PLC0415 - heavy: imported only for a run
    except (ImportError, OSError) as error:
        raise NotInstalled("kiss-icp", f"does not load ({error})", INSTALL) from error
    return kiss_icp, config


def _end_ns(frame: Frame) -> int:
    return frame.scan.stamp_ns + frame.scan.duration_ns


SPEC = OdometrySpec(
    make=make,
    summary="KISS-ICP: adaptive point-to-point odometry on a voxel map",
    citation="Vizzo, Guadagnino, Mersch, Wiesmann, Behley and Stachniss, KISS-ICP, RA-L 2023",
    licence="MIT",
    role="peer",
    guess="wheel odometry where recorded, else constant velocity",
    requires=("kiss-icp",),
    parameters=declared_parameters(KissSettings),
    missing=kiss_icp_missing,
    default=True,
)
