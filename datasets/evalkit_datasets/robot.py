"""How a simulated robot moves, exactly and at any time, and what its wheels and gyroscope make of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core import se2
from evalkit.core.se2 import Floats, Stamps
from evalkit_datasets.disturbances import NEVER, Episodes

_TICK_NS = 10_000_000  # wheel encoders and gyroscope are read at 100 Hz
_TICKS_AT_ONCE = 6_000  # a minute of readings integrated together: a long drive takes no more memory for it
_GENTLE_M = 1.0  # a curve this round is no turn
_STEP_M = 0.005  # between two places at which a drive that slows down for its curves has a speed of its own


@dataclass(frozen=True, eq=False)
class Route:
    """A closed path of straight lines and arcs, smooth in position and heading.

    ``sections`` (K, 5): x, y (m) and heading (rad) where a section begins, its curvature (1/m), its length (m).
    ``corners`` (W, 3): what it was made of, x, y, radius (m).
    """

    sections: Floats
    corners: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    @classmethod
    def through(cls, corners: ArrayLike) -> Route:
        """The route along a closed polygon whose corners (W, 3), given as x, y, radius in m, are rounded.

        It starts half-way between the first two corners. ValueError where two arcs do not fit on the side they share.
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

    def tightened(self, radius_m: float) -> Route:
        """The same route with no turn rounder than a radius; gentle curves, rounder than 1 m, stay as they are."""
        corners = self.corners.copy()
        turns = corners[:, 2] <= _GENTLE_M
        corners[turns, 2] = np.minimum(corners[turns, 2], radius_m)
        return Route.through(corners)

    @property
    def length_m(self) -> float:
        """Metres once round."""
        return float(self.sections[:, 4].sum())

    def at(self, distance_m: ArrayLike) -> Floats:
        """The poses ``world_from_base`` (N, 3) after a distance (N,) from the start, which may be many laps."""
        distance = np.asarray(distance_m, dtype=np.float64) % self.length_m
        begins = np.concatenate([[0.0], np.cumsum(self.sections[:-1, 4])])
        section = np.searchsorted(begins, distance, side="right") - 1
        begin_from_base = _motion(
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
        """The curvatures (N,) in 1/m, positive to the left, after a distance (N,) from the start."""
        distance = np.asarray(distance_m, dtype=np.float64) % self.length_m
        section = np.searchsorted(np.cumsum(self.sections[:-1, 4]), distance, side="right")
        return np.asarray(self.sections[section, 3])


@dataclass(frozen=True)
class RouteDrive:
    """One drive along a route from rest to rest: steady acceleration, steady speed, steady braking.

    ``laps`` may be any share of a lap; time starts at 0. ``most_yaw_rate`` (rad/s): the drive slows down where a curve
    would turn it faster.
    """

    route: Route
    speed_mps: float
    laps: float = 1.0
    acceleration_mps2: float = 0.5
    most_yaw_rate: float = float("inf")

    def __post_init__(self) -> None:
        for name in ("speed_mps", "laps", "acceleration_mps2", "most_yaw_rate"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name}: expected a positive number, got {getattr(self, name)}")

    @classmethod
    def turning_at(cls, route: Route, speed_mps: float, laps: float, yaw_rate: float) -> RouteDrive:
        """The drive whose turns all go at ``yaw_rate`` (rad/s): turns are tightened to it, then slowed down to it."""
        return cls(route.tightened(speed_mps / yaw_rate), speed_mps, laps, most_yaw_rate=yaw_rate)

    @property
    def path_m(self) -> float:
        """Metres driven in all."""
        return self.laps * self.route.length_m

    @property
    def top_speed_mps(self) -> float:
        """The speed between the ramps: lower than asked for where the path is too short to reach it."""
        return min(self.speed_mps, float(np.sqrt(self.acceleration_mps2 * self.path_m)))

    @property
    def duration_ns(self) -> int:
        """Nanoseconds from rest to rest."""
        if self._slows_down:
            return int(self._places[0][-1] * 1e9)
        return int((self.path_m / self.top_speed_mps + self._ramp_s) * 1e9)

    @property
    def top_yaw_rate(self) -> float:
        """The fastest turn (rad/s) between the ramps."""
        return min(self.top_speed_mps * float(np.abs(self.route.sections[:, 3]).max()), self.most_yaw_rate)

    def distance(self, stamps_ns: ArrayLike) -> Floats:
        """Metres driven (N,) at times (N,)."""
        time = np.asarray(np.clip(np.asarray(stamps_ns, dtype=np.int64), 0, self.duration_ns) * 1e-9, np.float64)
        if self._slows_down:
            return self._slowed_distance(time)
        left = self.path_m / self.top_speed_mps + self._ramp_s - time
        a, v, ramp = self.acceleration_mps2, self.top_speed_mps, self._ramp_s
        steady = v * (time - 0.5 * ramp)
        return np.where(time < ramp, 0.5 * a * time**2, np.where(left < ramp, self.path_m - 0.5 * a * left**2, steady))

    def pose(self, stamps_ns: ArrayLike) -> Floats:
        """The exact ``world_from_base`` (N, 3) at times (N,)."""
        return self.route.at(self.distance(stamps_ns))

    @property
    def _ramp_s(self) -> float:
        return self.top_speed_mps / self.acceleration_mps2

    @cached_property
    def _slows_down(self) -> bool:
        sharpest = float(np.abs(self.route.sections[:, 3]).max())
        return self.speed_mps * sharpest > self.most_yaw_rate * (1.0 + 1e-9)

    @cached_property
    def _places(self) -> tuple[Floats, Floats, Floats]:
        """Seconds, metres and speeds (K,) all along the drive; between two places the acceleration is steady.

        The square of the speed is the lower envelope of cones of slope 2 a over the sections' limits, and over 0 at
        both ends of the drive.
        """
        ends = np.cumsum(self.route.sections[:, 4]) + self.route.length_m * np.arange(np.ceil(self.laps))[:, None]
        evenly = np.linspace(0.0, self.path_m, max(int(self.path_m / _STEP_M), 2) + 1)
        distance = np.union1d(evenly, ends[ends < self.path_m])
        curvature = np.abs(self.route.curvature(0.5 * (distance[:-1] + distance[1:])))
        between = np.minimum(self.speed_mps, self.most_yaw_rate / np.maximum(curvature, 1e-12))
        limits = np.minimum(np.append(0.0, between), np.append(between, 0.0))
        slope = 2.0 * self.acceleration_mps2 * distance
        ahead = np.minimum.accumulate(limits**2 - slope) + slope
        behind = (np.minimum.accumulate((limits**2 + slope)[::-1]))[::-1] - slope
        speed = np.sqrt(np.maximum(np.minimum(ahead, behind), 0.0))
        seconds = np.cumsum(np.diff(distance) * 2.0 / (speed[:-1] + speed[1:]))
        return np.append(0.0, seconds), distance, speed

    def _slowed_distance(self, time: Floats) -> Floats:
        seconds, distance, speed = self._places
        place = np.clip(np.searchsorted(seconds, time, side="right") - 1, 0, len(seconds) - 2)
        since = time - seconds[place]
        gained = (speed[place + 1] - speed[place]) / (seconds[place + 1] - seconds[place])
        return np.asarray(np.minimum(distance[place] + since * (speed[place] + 0.5 * gained * since), self.path_m))


@dataclass(frozen=True)
class WheelOdometryModel:
    """Wheel encoders and a gyroscope at 100 Hz: the paper names them without figures, so these are assumed.

    ``scale``: 1 sigma of the wheels' scale error, a share, drawn once a run. ``velocity_noise_mps``: of every reading.
    ``gyro_bias`` (rad/s): 1 sigma, drawn once a run. ``gyro_noise`` (rad/s): of every reading. ``slips``: when the
    wheels spin, ``slip_mps`` faster than the vehicle moves; the gyroscope does not feel it.
    """

    scale: float = 0.01
    velocity_noise_mps: float = 0.02
    gyro_bias: float = float(np.radians(0.2))
    gyro_noise: float = float(np.radians(0.5))
    slips: Episodes = NEVER
    slip_mps: float = 0.5

    def poses(self, drive: RouteDrive, stamps_ns: ArrayLike, generator: np.random.Generator) -> Floats:
        """What dead reckoning answers, ``odom_from_base`` (N, 3) at times (N,) of a drive: the identity at time 0.

        A reading holds until the next one; its velocities are integrated exactly on SE(2), also between readings.
        """
        asked, places = np.unique(np.asarray(stamps_ns, dtype=np.int64), return_inverse=True)
        ticks = int(asked.max(initial=0)) // _TICK_NS + 1
        scale, bias = generator.standard_normal(2) * [self.scale, self.gyro_bias]
        poses = np.zeros((len(asked), 3))
        odom_from_base = np.zeros(3)
        for begin in range(0, ticks, _TICKS_AT_ONCE):
            end = min(begin + _TICKS_AT_ONCE, ticks)
            noise = generator.standard_normal((end - begin, 2)) * [self.velocity_noise_mps, self.gyro_noise]
            some = slice(*np.searchsorted(asked, [begin * _TICK_NS, end * _TICK_NS]))
            times: Stamps = np.union1d(np.arange(begin, end + 1) * _TICK_NS, asked[some])
            travelled = self._travelled(drive, times, noise, scale, bias, odom_from_base)
            poses[some] = travelled[np.searchsorted(times, asked[some])]
            odom_from_base = travelled[-1]
        return np.column_stack([poses[:, :2], se2.wrap(poses[:, 2])])[places]

    def _travelled(
        self, drive: RouteDrive, times: Stamps, noise: Floats, scale: float, bias: float, start: Floats
    ) -> Floats:
        """``odom_from_base`` (N, 3) at times (N,) from its value at the first on, headings not wrapped.

        ``noise`` (T, 2): of the readings from the one at the first time on.
        """
        true = drive.pose(times)
        travelled = _twist(se2.between(true[:-1], true[1:]))
        lasted = np.diff(times) * 1e-9
        reading = noise[(times[:-1] - times[0]) // _TICK_NS] * lasted[:, None]
        travelled[:, :2] *= 1.0 + scale
        travelled[:, 0] += reading[:, 0]
        travelled[:, 0] += np.where(self.slips.at(times[:-1]), self.slip_mps * lasted, 0.0)
        travelled[:, 2] += reading[:, 1] + bias * lasted
        return _chained(start, _motion(travelled))


def _chained(start: Floats, steps: Floats) -> Floats:
    """The poses (N + 1, 3) from one on, one motion (N, 3) after the other; headings are not wrapped."""
    headings = np.cumsum(np.append(start[2], steps[:, 2]))
    cos, sin = np.cos(headings[:-1]), np.sin(headings[:-1])
    x = np.cumsum(np.append(start[0], cos * steps[:, 0] - sin * steps[:, 1]))
    y = np.cumsum(np.append(start[1], sin * steps[:, 0] + cos * steps[:, 1]))
    return np.column_stack([x, y, headings])


def _motion(twists: Floats) -> Floats:
    """The motions (N, 3) of unit-time velocities (N, 3): the exponential of SE(2), steady at zero rotation."""
    half = 0.5 * twists[:, 2]
    chord = np.sinc(half / np.pi)
    cos, sin = chord * np.cos(half), chord * np.sin(half)
    return np.column_stack(
        [cos * twists[:, 0] - sin * twists[:, 1], sin * twists[:, 0] + cos * twists[:, 1], twists[:, 2]]
    )


def _twist(motions: Floats) -> Floats:
    """The unit-time velocities (N, 3) of motions (N, 3): the logarithm of SE(2)."""
    half = 0.5 * motions[:, 2]
    chord = np.sinc(half / np.pi)
    cos, sin = np.cos(half) / chord, np.sin(half) / chord
    return np.column_stack(
        [cos * motions[:, 0] + sin * motions[:, 1], -sin * motions[:, 0] + cos * motions[:, 1], motions[:, 2]]
    )
