"""Synthetic sequences with exact ground truth: a robot drives through a floor plan, with the paper's lidar."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cached_property, partial
from types import MappingProxyType

import numpy as np

from evalkit.core import se2
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.plugins.parameters import Parameter, Value, resolve_parameters, with_defaults
from evalkit.plugins.specs import DatasetSpec, Excerpt
from evalkit_datasets.worlds.disturbances import NEVER, Episodes
from evalkit_datasets.worlds.floorplans import FloorPlan, load_plan
from evalkit_datasets.worlds.lidar import LidarModel
from evalkit_datasets.worlds.pedestrians import Walk, plan_walks
from evalkit_datasets.worlds.random_home import draw_home
from evalkit_datasets.worlds.random_office import draw_office
from evalkit_datasets.worlds.random_warehouse import draw_warehouse
from evalkit_datasets.worlds.robot import Route, RouteDrive, WheelOdometryModel
from evalkit_datasets.worlds.true_map import build_true_grid

_SCANS_AT_ONCE = 32  # simulated together: bounds the memory
_MAX_KEPT_BYTES = 32 * 2**20  # the scans of a longer drive are simulated again for each pass
_VIEW_STEP_M = 0.2  # distance between the viewpoints of the true map
_MAX_VIEW_LAPS = 2.0  # further laps add nothing to the true map


class Synthetic:
    """A drive through a floor plan; the same parameters give bit-identical data, on every pass and in every process.

    Range noise, drop-outs, odometry and people use independent random streams, so that changing one does not change the
    others. Scans that begin during an episode of ``lost`` are dropped. Scans are simulated on demand; those of a short
    drive are cached.
    """

    def __init__(
        self,
        plan: FloorPlan,
        drive: RouteDrive,
        lidar: LidarModel,
        odometry: WheelOdometryModel,
        base_from_sensor: Pose,
        seed: int = 0,
        resolution_m: float = 0.05,
        lost: Episodes = NEVER,
        people: int = 0,
        walk_mps: float = 1.0,
    ) -> None:
        self.plan, self.drive, self.lidar, self.odometry = plan, drive, lidar, odometry
        self.base_from_sensor, self.seed, self.resolution_m = base_from_sensor, seed, resolution_m
        self.people, self.walk_mps = people, walk_mps
        self._swept_ns = lidar.stamps(drive.duration_ns)  # including lost scans
        self._arrived = ~lost.contains(self._swept_ns)
        self.stamps_ns = self._swept_ns[self._arrived]
        self._counted: tuple[int, int] | None = None
        if len(self.stamps_ns) == 0:
            raise ValueError(f"laps: {drive.laps:g} laps at {drive.speed_mps:g} m/s end before the first scan ends")

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def frames(self) -> Iterator[Frame]:
        """Return an iterator over the frames in order of time."""
        short = len(self) * 2 * 8 * self.lidar.beams <= _MAX_KEPT_BYTES  # ranges and angles
        return iter(self._cached_frames) if short else self._simulate()

    def truth(self) -> Truth:
        """Return exact poses ``world_from_base`` at the scans' stamps, and the grid of all that the path sees."""
        return self._truth

    def notes(self) -> Mapping[str, int]:
        """Return the number of beams without return, of invalid ranges and of lost scans."""
        return {"beams without return": self._range_counts[0], "invalid ranges": self._range_counts[1]} | (
            {"scans lost": lost} if (lost := int((~self._arrived).sum())) else {}
        )

    @property
    def _range_counts(self) -> tuple[int, int]:
        """Numbers of no-return and of invalid ranges; simulates all frames if that has not been done."""
        if self._counted is None:
            for _ in self.frames():
                pass
        if self._counted is None:
            raise RuntimeError("the frames were simulated but not counted")
        return self._counted

    def _make_generators(self) -> list[np.random.Generator]:
        """Return independent generators for range noise, drop-outs, odometry and people."""
        return [np.random.default_rng(child) for child in np.random.SeedSequence(self.seed).spawn(4)]

    @cached_property
    def walks(self) -> tuple[Walk, ...]:
        """Paths of the people."""
        *_, generator = self._make_generators()
        return plan_walks(self.people, self.plan.world, self.drive, self.walk_mps, generator)

    @cached_property
    def _cached_frames(self) -> tuple[Frame, ...]:
        return tuple(self._simulate())

    @cached_property
    def _odometry(self) -> tuple[Floats, Floats]:
        """Odometry poses (N, 3) at the first beam of every sweep, and motions to the last beam."""
        *_, errors, _ = self._make_generators()
        last_ns = self._swept_ns + (self.lidar.beams - 1) * self.lidar.time_increment_ns
        odometry = self.odometry.poses(self.drive, np.stack([self._swept_ns, last_ns], axis=1).ravel(), errors)
        return odometry[0::2], se2.between(odometry[0::2], odometry[1::2])

    def _simulate(self) -> Iterator[Frame]:
        noise, dropouts, *_ = self._make_generators()
        first, motions = self._odometry
        no_returns = invalid = 0
        for index, ranges in enumerate(self._simulate_ranges(noise, dropouts)):
            if self._arrived[index]:
                scan = self._make_scan(index, ranges)
                no_returns, invalid = (
                    no_returns + int(scan.no_returns.sum()),
                    invalid + int(np.isnan(scan.ranges).sum()),
                )
                yield Frame(scan, self.base_from_sensor, Pose.of(first[index]), Pose.of(motions[index]))
        self._counted = no_returns, invalid

    def _simulate_ranges(self, noise: np.random.Generator, dropouts: np.random.Generator) -> Iterator[Floats]:
        """Yield the ranges (B,) of each scan; every beam starts at the sensor's pose at its own time."""
        for begin in range(0, len(self._swept_ns), _SCANS_AT_ONCE):
            stamps = self.lidar.beam_stamps(self._swept_ns[begin : begin + _SCANS_AT_ONCE])
            world_from_sensor = se2.compose(self.drive.poses(stamps.ravel()), self.base_from_sensor.row)
            origins, bearings = (
                world_from_sensor[:, :2],
                world_from_sensor[:, 2] + np.tile(self.lidar.angles(), len(stamps)),
            )
            distances = self.plan.world.cast(origins, bearings)
            for walk in self.walks:
                distances = np.minimum(distances, walk.cast(origins, bearings, stamps.ravel()))
            yield from self.lidar.add_errors(distances.reshape(stamps.shape), noise, dropouts)

    def _make_scan(self, index: int, ranges: Floats) -> Scan:
        lidar = self.lidar
        return Scan(
            int(self._swept_ns[index]),
            ranges,
            lidar.angles(),
            lidar.range_min_m,
            lidar.range_max_m,
            lidar.time_increment_ns,
        )

    @cached_property
    def _truth(self) -> Truth:
        poses = self.drive.poses(self.stamps_ns)
        seen_m = min(self.drive.path_m, _MAX_VIEW_LAPS * self.drive.route.length_m)
        path = self.drive.route.poses_at(np.arange(0.0, seen_m, _VIEW_STEP_M))
        sensor = se2.compose(path, self.base_from_sensor.row)
        grid = build_true_grid(self.plan.world, self.resolution_m, sensor[:, :2], self.lidar.range_max_m)
        return Truth("exact: simulated", trajectory=Trajectory(self.stamps_ns, poses, "world", "base"), grid=grid)


PARAMETERS = (
    Parameter("seed", 0, "", "seed of noise, drop-outs and odometry errors", low=0),
    Parameter("rate_hz", 10.0, "Hz", "revolutions of the lidar per second", low=5.0, high=15.0),
    Parameter("speed_mps", 0.3, "m/s", "speed between the ramps", low=0.05, high=3.0),
    Parameter("turn_dps", 0.0, "deg/s", "yaw rate of all turns, tightened or slowed down to it; 0: not changed",
              low=0.0, high=360.0),
    Parameter("laps", 1.0, "", "number of laps, may be a fraction", low=0.02, high=1e5),
    Parameter("noise_m", 0.0483, "m", "standard deviation of a range", low=0.0, high=1.0),
    Parameter("dropout", 0.01, "", "share of beams without an answer", low=0.0, high=1.0),
    Parameter("odometry_scale", 0.01, "", "1 sigma of the wheels' scale error, drawn once per run", low=0.0, high=0.5),
    Parameter("velocity_noise_mps", 0.02, "m/s", "1 sigma of the noise of speed readings at 100 Hz", low=0.0, high=1.0),
    Parameter("gyro_bias_dps", 0.2, "deg/s", "1 sigma of the gyroscope's bias, drawn once per run", low=0.0, high=20.0),
    Parameter("gyro_noise_dps", 0.5, "deg/s", "1 sigma of the noise of yaw rates at 100 Hz", low=0.0, high=50.0),
    Parameter("slip_every_s", 0.0, "s", "period of wheel slip, the first after half a period; 0: no slip", low=0.0),
    Parameter("slip_s", 0.5, "s", "duration of a slip", low=0.0),
    Parameter("slip_mps", 0.5, "m/s", "excess speed of the wheels during a slip", low=-3.0, high=3.0),
    Parameter("drop_every_s", 0.0, "s", "period of scan loss, the first after half a period; 0: no loss", low=0.0),
    Parameter("drop_s", 0.5, "s", "duration of a scan loss", low=0.0),
    Parameter("people", 0, "", "number of walking people: discs of 0.25 m radius", low=0, high=50),
    Parameter("walk_mps", 1.0, "m/s", "walking speed of the people", low=0.05, high=3.0),
    Parameter("resolution_m", 0.05, "m", "cell size of the true map", low=0.01, high=1.0),
)  # fmt: skip


DRAWN_WORLDS: Mapping[str, Callable[[int], FloorPlan]] = {
    "random-office": draw_office,
    "random-home": draw_home,
    "random-warehouse": draw_warehouse,
}
"""Worlds with another plan for each seed. No settings may be chosen on them: all methods are compared there."""


def make_sequence(name: str, base_from_sensor: Pose, **parameters: object) -> Synthetic:
    """Return the sequence of a floor plan by its name; ``parameters`` not given have the defaults of ``PARAMETERS``.

    The plan of a name in ``DRAWN_WORLDS`` is drawn from the seed.
    """
    value = resolve_parameters(name, PARAMETERS, parameters)
    number = {key: float(setting) for key, setting in value.items()}
    floor_plan = DRAWN_WORLDS[name](int(value["seed"])) if name in DRAWN_WORLDS else load_plan(name)
    return Synthetic(
        floor_plan,
        _make_drive(floor_plan.route, number["speed_mps"], number["laps"], float(np.radians(number["turn_dps"]))),
        LidarModel(number["rate_hz"], number["noise_m"], number["dropout"]),
        WheelOdometryModel(
            number["odometry_scale"],
            number["velocity_noise_mps"],
            float(np.radians(number["gyro_bias_dps"])),
            float(np.radians(number["gyro_noise_dps"])),
            Episodes(number["slip_every_s"], number["slip_s"]),
            number["slip_mps"],
        ),
        base_from_sensor,
        int(value["seed"]),
        number["resolution_m"],
        Episodes(number["drop_every_s"], number["drop_s"]),
        int(value["people"]),
        number["walk_mps"],
    )


def _make_drive(route: Route, speed_mps: float, laps: float, yaw_rate: float) -> RouteDrive:
    return RouteDrive.turning_at(route, speed_mps, laps, yaw_rate) if yaw_rate else RouteDrive(route, speed_mps, laps)


def _make_spec(
    name: str,
    summary: str,
    base_from_sensor: Pose,
    degenerate: str = "",
    excerpts: Mapping[Excerpt, Mapping[str, Value]] = MappingProxyType({}),
    **defaults: Value,
) -> DatasetSpec:
    parameters = with_defaults(PARAMETERS, **defaults)
    return DatasetSpec(
        make=partial(make_sequence, name, base_from_sensor, **defaults),
        summary=summary,
        sensor="simulated RPLIDAR A2M8: 8,000 beams/s clockwise, 5-15 Hz, 0.15-12 m, 4.83 cm noise, motion in the scan",
        truth="exact: simulated poses at every scan's first beam; map cells crossed by visible boundaries",
        citation="simulated after 'Occupancy grid mapping based on ICP for indoor autonomous vehicles'",
        licence="MIT",
        defects=("wheel and gyroscope errors are assumed: the paper gives none",),
        degenerate=degenerate,
        seeded=True,
        parameters=parameters,
        excerpts=excerpts,
    )


_AHEAD = Pose(0.08, 0.0, 0.0)
_EXCERPTS: dict[Excerpt, dict[str, Value]] = {"full": {"laps": 0.6}, "quick": {"laps": 0.15}}

ROOM = _make_spec(
    "room",
    "the paper's 10 x 10 m room with a round obstacle, 23 m, turns up to 69 deg/s at 0.3 m/s",
    _AHEAD,
    excerpts=_EXCERPTS,
)
LAB = _make_spec(
    "lab",
    "a laboratory of 10.5 x 8 m with furniture, 24 m around an island, turns up to 69 deg/s at 0.3 m/s; lidar turned",
    Pose(0.08, 0.02, float(np.radians(-30.0))),
    excerpts=_EXCERPTS,
)
LOOP = _make_spec(
    "loop",
    "a ring of corridors 41 m around, driven until it overlaps by 2 m, turns up to 69 deg/s at 0.3 m/s",
    _AHEAD,
    laps=1.05,
)
CORRIDOR = _make_spec(
    "corridor",
    "a bare corridor longer than the lidar sees, 21 m back and forth, turns up to 43 deg/s at 0.3 m/s",
    _AHEAD,
    degenerate="two bare parallel walls longer than the lidar's range: the position along them is not observable",
)
OFFICE = _make_spec(
    "office",
    "four furnished rooms on a hallway, 35 m through doors, turns up to 69 deg/s at 0.3 m/s; lidar rotated by 90 deg",
    Pose(-0.04, 0.0, float(np.radians(90.0))),
)


DOORS = _make_spec(
    "doors",
    "a corridor with equal doors every 3 m, 85 m there and back: many places look the same",
    _AHEAD,
    degenerate="between its ends the corridor repeats itself every 3 m",
    speed_mps=0.8,
    rate_hz=5.0,
)
WINGS = _make_spec(
    "wings",
    "two equal furnished wings 34 m apart, 102 m through both: each room of one looks like that of the other",
    _AHEAD,
    laps=1.3,
    speed_mps=0.8,
    rate_hz=5.0,
)
SYMMETRIC_OFFICE = _make_spec(
    "symmetric-office",
    "a ring of corridors 47 m around that looks the same after half a turn, driven one and a half times",
    _AHEAD,
    laps=1.5,
    speed_mps=0.8,
    rate_hz=5.0,
)
LONG_LOOP = _make_spec(
    "long-loop",
    "a ring of corridors 299 m around, driven until it overlaps by 15 m",
    _AHEAD,
    laps=1.05,
    speed_mps=0.8,
    rate_hz=5.0,
)
RANDOM_OFFICE = _make_spec(
    "random-office",
    "another office for each seed, 25 to 46 m, turns up to 43 deg/s at 0.3 m/s; no settings are chosen on it",
    _AHEAD,
)
RANDOM_HOME = _make_spec(
    "random-home",
    "another furnished flat for each seed, 24 to 58 m through all rooms, turns up to 43 deg/s at 0.3 m/s; "
    "no settings are chosen on it",
    _AHEAD,
)
RANDOM_WAREHOUSE = _make_spec(
    "random-warehouse",
    "another warehouse for each seed, 39 to 80 m, many walls out of range, turns up to 43 deg/s at 0.3 m/s; "
    "no settings are chosen on it",
    _AHEAD,
)
