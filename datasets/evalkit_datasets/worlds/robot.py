"""The exact motion of a simulated robot, and its wheel odometry with errors."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core import se2
from evalkit.core.se2 import Floats, Stamps
from evalkit_datasets.worlds.disturbances import NEVER, Episodes

_TICK_NS = 10_000_000  # wheel encoders and gyroscope are read at 100 Hz
_TICKS_AT_ONCE = 6_000  # readings integrated together (one minute): bounds the memory
_MAX_TURN_RADIUS_M = 1.0  # a curve of a larger radius is not a turn
_STEP_M = 0.005  # step of the speed profile of a drive that slows down in turns


@dataclass(frozen=True, eq=False)
class Route:
    """A closed path of straight lines and arcs, smooth in position and heading.

    ``sections`` (K, 5): x, y (m) and heading (rad) at the start of a section, its curvature (1/m) and length (m).
    ``corners`` (W, 3): the rounded polygon it was made from, x, y, radius (m).
    """

    sections: Floats
    corners: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    @classmethod
    def from_corners(cls, corners: ArrayLike) -> Route:
        """Return the route along a closed polygon with rounded corners (W, 3), given as x, y, radius in m.

        It starts half-way between the first two corners. Raises ValueError if two arcs overlap on their common side.
        """
        rows = np.asarray(corners, dtype=np.float64)
        points, radii = rows[:, :2], rows[:, 2]
        sides = np.roll(points, -1, axis=0) - points
        lengths, headings = np.linalg.norm(sides, axis=1), np.arctan2(sides[:, 1], sides[:, 0])
        turns = se2.wrap(headings - np.roll(headings, 1))
        cut = radii * np.tan(0.5 * np.abs(turns))
        straights = lengths - cut - np.roll(cut, -1)
        if (straights < -1e-9).any():
            side = int(np.argmin(straights))
            raise ValueError(f"corners: arcs overlap by {-straights[side]:.3f} m between corners {side} and {side + 1}")
        forward = sides / lengths[:, None]
        lines = np.column_stack(
            [points + cut[:, None] * forward, headings, np.zeros(len(rows)), np.maximum(straights, 0.0)]
        )
        arcs = np.column_stack(
            [
                points - cut[:, None] * np.roll(forward, 1, axis=0),
                np.roll(headings, 1),
                np.sign(turns) / radii,
                radii * np.abs(turns),
            ]
        )
        sections = np.stack([arcs, lines], axis=1).reshape(-1, 5)[1:]  # from the first line on
        half = 0.5 * sections[0, 4]
        second_half = sections[0] + [*(half * forward[0]), 0.0, 0.0, -half]
        first_half = [*sections[0, :4], half]
        return cls(np.concatenate([[second_half], sections[1:], arcs[:1], [first_half]]), rows)

    def tighten(self, radius_m: float) -> Route:
        """Return the route with the radius of all turns limited; curves of more than 1 m radius are not changed."""
        corners = self.corners.copy()
        turns = corners[:, 2] <= _MAX_TURN_RADIUS_M
        corners[turns, 2] = np.minimum(corners[turns, 2], radius_m)
        return Route.from_corners(corners)

    @property
    def length_m(self) -> float:
        """Length of one lap in m."""
        return float(self.sections[:, 4].sum())

    def poses_at(self, distance_m: ArrayLike) -> Floats:
        """Return the poses ``world_from_base`` (N, 3) at distances (N,) from the start, over any number of laps."""
        distance = np.asarray(distance_m, dtype=np.float64) % self.length_m
        begins = np.concatenate([[0.0], np.cumsum(self.sections[:-1, 4])])
        section = np.searchsorted(begins, distance, side="right") - 1
        begin_from_base = _motion_from_twist(
            np.stack(
                [
                    distance - begins[section],
                    np.zeros_like(distance),
                    (distance - begins[section]) * self.sections[section, 3],
                ],
                axis=-1,
            )
        )
        return se2.compose(self.sections[section, :3], begin_from_base)

    def curvature(self, distance_m: ArrayLike) -> Floats:
        """Return the curvatures (N,) in 1/m, positive to the left, at distances (N,) from the start."""
        distance = np.asarray(distance_m, dtype=np.float64) % self.length_m
        section = np.searchsorted(np.cumsum(self.sections[:-1, 4]), distance, side="right")
        return np.asarray(self.sections[section, 3])


@dataclass(frozen=True)
class RouteDrive:
    """A drive along a route from rest to rest: constant acceleration, constant speed, constant braking.

    ``laps`` may be a fraction; time starts at 0. The drive slows down in curves to stay below ``max_yaw_rate`` (rad/s).
    """

    route: Route
    speed_mps: float
    laps: float = 1.0
    acceleration_mps2: float = 0.5
    max_yaw_rate: float = float("inf")

    def __post_init__(self) -> None:
        for name in ("speed_mps", "laps", "acceleration_mps2", "max_yaw_rate"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name}: expected a positive number, got {getattr(self, name)}")

    @classmethod
    def turning_at(cls, route: Route, speed_mps: float, laps: float, yaw_rate: float) -> RouteDrive:
        """Return the drive with one ``yaw_rate`` (rad/s) in all turns: they are tightened, or the drive slows down."""
        return cls(route.tighten(speed_mps / yaw_rate), speed_mps, laps, max_yaw_rate=yaw_rate)

    @property
    def path_m(self) -> float:
        """Distance driven in m."""
        return self.laps * self.route.length_m

    @property
    def top_speed_mps(self) -> float:
        """Speed between the ramps: below ``speed_mps`` if the path is too short to reach it."""
        return min(self.speed_mps, float(np.sqrt(self.acceleration_mps2 * self.path_m)))

    @property
    def duration_ns(self) -> int:
        """Duration from rest to rest in ns."""
        if self._is_slowed:
            return int(self._profile[0][-1] * 1e9)
        return int((self.path_m / self.top_speed_mps + self._ramp_s) * 1e9)

    def distance(self, stamps_ns: ArrayLike) -> Floats:
        """Return the distances driven (N,) in m at times (N,)."""
        time = np.asarray(np.clip(np.asarray(stamps_ns, dtype=np.int64), 0, self.duration_ns) * 1e-9, np.float64)
        if self._is_slowed:
            return self._distance_on_profile(time)
        left = self.path_m / self.top_speed_mps + self._ramp_s - time
        a, v, ramp = self.acceleration_mps2, self.top_speed_mps, self._ramp_s
        steady = v * (time - 0.5 * ramp)
        return np.where(time < ramp, 0.5 * a * time**2, np.where(left < ramp, self.path_m - 0.5 * a * left**2, steady))

    def poses(self, stamps_ns: ArrayLike) -> Floats:
        """Return the exact poses ``world_from_base`` (N, 3) at times (N,)."""
        return self.route.poses_at(self.distance(stamps_ns))

    @property
    def _ramp_s(self) -> float:
        return self.top_speed_mps / self.acceleration_mps2

    @cached_property
    def _is_slowed(self) -> bool:
        sharpest = float(np.abs(self.route.sections[:, 3]).max())
        return self.speed_mps * sharpest > self.max_yaw_rate * (1.0 + 1e-9)

    @cached_property
    def _profile(self) -> tuple[Floats, Floats, Floats]:
        """Times (s), distances (m) and speeds (m/s), (K,) each; the acceleration is constant in between.

        The square of the speed is the lower envelope of cones of slope 2 a over the limits of the sections, and over 0
        at both ends of the drive.
        """
        ends = np.cumsum(self.route.sections[:, 4]) + self.route.length_m * np.arange(np.ceil(self.laps))[:, None]
        evenly = np.linspace(0.0, self.path_m, max(int(self.path_m / _STEP_M), 2) + 1)
        distance = np.union1d(evenly, ends[ends < self.path_m])
        curvature = np.abs(self.route.curvature(0.5 * (distance[:-1] + distance[1:])))
        between = np.minimum(self.speed_mps, self.max_yaw_rate / np.maximum(curvature, 1e-12))
        limits = np.minimum(np.append(0.0, between), np.append(between, 0.0))
        slope = 2.0 * self.acceleration_mps2 * distance
        ahead = np.minimum.accumulate(limits**2 - slope) + slope
        behind = (np.minimum.accumulate((limits**2 + slope)[::-1]))[::-1] - slope
        speed = np.sqrt(np.maximum(np.minimum(ahead, behind), 0.0))
        seconds = np.cumsum(np.diff(distance) * 2.0 / (speed[:-1] + speed[1:]))
        return np.append(0.0, seconds), distance, speed

    def _distance_on_profile(self, time: Floats) -> Floats:
        seconds, distance, speed = self._profile
        place = np.clip(np.searchsorted(seconds, time, side="right") - 1, 0, len(seconds) - 2)
        since = time - seconds[place]
        gained = (speed[place + 1] - speed[place]) / (seconds[place + 1] - seconds[place])
        return np.asarray(np.minimum(distance[place] + since * (speed[place] + 0.5 * gained * since), self.path_m))


@dataclass(frozen=True)
class WheelOdometryModel:
    """Errors of wheel encoders and a gyroscope at 100 Hz. The paper gives no figures, so the defaults are assumed.

    ``scale`` (a share) and ``gyro_bias`` (rad/s): 1 sigma of errors that are constant during a run.
    ``velocity_noise_mps`` and ``gyro_noise`` (rad/s): 1 sigma of the noise of each reading. During ``slips`` the wheels
    turn faster than the vehicle moves by ``slip_mps``; the gyroscope is not affected.
    """

    scale: float = 0.01
    velocity_noise_mps: float = 0.02
    gyro_bias: float = float(np.radians(0.2))
    gyro_noise: float = float(np.radians(0.5))
    slips: Episodes = NEVER
    slip_mps: float = 0.5

    def poses(self, drive: RouteDrive, stamps_ns: ArrayLike, generator: np.random.Generator) -> Floats:
        """Return the poses by dead reckoning ``odom_from_base`` (N, 3) at times (N,) of a drive; identity at time 0.

        A reading is valid until the next one; its velocities are integrated exactly on SE(2), also between readings.
        """
        wanted, places = np.unique(np.asarray(stamps_ns, dtype=np.int64), return_inverse=True)
        ticks = int(wanted.max(initial=0)) // _TICK_NS + 1
        scale, bias = generator.standard_normal(2) * [self.scale, self.gyro_bias]
        poses = np.zeros((len(wanted), 3))
        odom_from_base = np.zeros(3)
        for begin in range(0, ticks, _TICKS_AT_ONCE):
            end = min(begin + _TICKS_AT_ONCE, ticks)
            noise = generator.standard_normal((end - begin, 2)) * [self.velocity_noise_mps, self.gyro_noise]
            rows = slice(*np.searchsorted(wanted, [begin * _TICK_NS, end * _TICK_NS]))
            times = _merge_sorted(np.arange(begin, end + 1) * _TICK_NS, wanted[rows])
            travelled = self._integrate(drive, times, noise, scale, bias, odom_from_base)
            poses[rows] = travelled[np.searchsorted(times, wanted[rows])]
            odom_from_base = travelled[-1]
        return np.column_stack([poses[:, :2], se2.wrap(poses[:, 2])])[places]

    def _integrate(
        self, drive: RouteDrive, times: Stamps, noise: Floats, scale: float, bias: float, start: Floats
    ) -> Floats:
        """Return ``odom_from_base`` (N, 3) at times (N,), headings not wrapped, from its value at the first time.

        ``noise`` (T, 2): noise of the readings, beginning with the one at the first time.
        """
        true = drive.poses(times)
        travelled = _twist_from_motion(se2.between(true[:-1], true[1:]))
        lasted = np.diff(times) * 1e-9
        reading = noise[(times[:-1] - times[0]) // _TICK_NS] * lasted[:, None]
        travelled[:, :2] *= 1.0 + scale
        travelled[:, 0] += reading[:, 0]
        travelled[:, 0] += np.where(self.slips.contains(times[:-1]), self.slip_mps * lasted, 0.0)
        travelled[:, 2] += reading[:, 1] + bias * lasted
        return _chain_motions(start, _motion_from_twist(travelled))


def _chain_motions(start: Floats, steps: Floats) -> Floats:
    """Return the poses (N + 1, 3) after motions (N, 3) from a start pose; headings are not wrapped."""
    headings = np.cumsum(np.append(start[2], steps[:, 2]))
    cos, sin = np.cos(headings[:-1]), np.sin(headings[:-1])
    x = np.cumsum(np.append(start[0], cos * steps[:, 0] - sin * steps[:, 1]))
    y = np.cumsum(np.append(start[1], sin * steps[:, 0] + cos * steps[:, 1]))
    return np.column_stack([x, y, headings])


def _motion_from_twist(twists: Floats) -> Floats:
    """Return the motions (N, 3) of unit-time velocities (N, 3): the exponential of SE(2), continuous at 0 rad."""
    half = 0.5 * twists[:, 2]
    chord = np.sinc(half / np.pi)
    cos, sin = chord * np.cos(half), chord * np.sin(half)
    return np.column_stack(
        [cos * twists[:, 0] - sin * twists[:, 1], sin * twists[:, 0] + cos * twists[:, 1], twists[:, 2]]
    )


def _twist_from_motion(motions: Floats) -> Floats:
    """Return the unit-time velocities (N, 3) of motions (N, 3): the logarithm of SE(2)."""
    half = 0.5 * motions[:, 2]
    chord = np.sinc(half / np.pi)
    cos, sin = np.cos(half) / chord, np.sin(half) / chord
    return np.column_stack(
        [cos * motions[:, 0] + sin * motions[:, 1], -sin * motions[:, 0] + cos * motions[:, 1], motions[:, 2]]
    )


def _merge_sorted(one: Stamps, other: Stamps) -> Stamps:
    """Return the different times of two arrays (N,), (M,), ascending; ``np.union1d`` would load ``numpy.ma``."""
    every = np.sort(np.concatenate([one, other]))
    return np.asarray(every[np.concatenate([[True], np.diff(every) > 0])], dtype=np.int64)
