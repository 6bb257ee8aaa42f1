"""Sequences with exact truth: a simulated robot drives through a floor plan and scans it with the paper's lidar."""

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
from evalkit_datasets import floorplans
from evalkit_datasets.disturbances import NEVER, Episodes
from evalkit_datasets.floorplans import FloorPlan
from evalkit_datasets.lidar import LidarModel
from evalkit_datasets.pedestrians import Walk, walks
from evalkit_datasets.robot import Route, RouteDrive, WheelOdometryModel
from evalkit_datasets.true_map import build_true_grid

_SCANS_AT_ONCE = 32  # simulated together: keeps the memory of a run small beside the back end's own
_MAX_KEPT_BYTES = 32 * 2**20  # a drive of more scans than this is simulated anew whenever they are asked for
_LOOK_EVERY_M = 0.2  # how far apart on the path the true map looks around
_LOOK_LAPS = 2.0  # whoever has gone round twice has seen it all


class Synthetic:
    """A drive through a floor plan: the same parameters give the same bits, on every pass and in every process.

    Range noise, drop-outs, odometry and people draw from streams of their own, so that changing one leaves the others
    alone. ``lost``: scans that begin meanwhile never arrive. Scans are simulated as they are asked for; those of a
    short drive are kept.
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
        self._swept_ns = lidar.stamps(drive.duration_ns)  # of the scans lost, too
        self._arrived = ~lost.at(self._swept_ns)
        self.stamps_ns = self._swept_ns[self._arrived]
        self._counted: tuple[int, int] | None = None
        if len(self.stamps_ns) == 0:
            raise ValueError(f"laps: {drive.laps:g} laps at {drive.speed_mps:g} m/s end before the first scan does")

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def frames(self) -> Iterator[Frame]:
        """The frames in the order of time."""
        short = len(self) * 2 * 8 * self.lidar.beams <= _MAX_KEPT_BYTES  # ranges and angles
        return iter(self._kept) if short else self._simulated()

    def truth(self) -> Truth:
        """The exact poses ``world_from_base`` at the scans' stamps, and the map of what can be seen from the path."""
        return self._truth

    def notes(self) -> Mapping[str, int]:
        """How many beams met nothing within range, and how many gave no valid answer."""
        return {"beams without return": self._met[0], "invalid ranges": self._met[1]} | (
            {"scans lost": lost} if (lost := int((~self._arrived).sum())) else {}
        )

    @property
    def _met(self) -> tuple[int, int]:
        """How many beams met nothing and how many are invalid: known once all frames have been simulated."""
        if self._counted is None:
            for _ in self.frames():
                pass
        if self._counted is None:
            raise RuntimeError("the frames have been simulated and not counted")
        return self._counted

    def _streams(self) -> list[np.random.Generator]:
        """Independent generators for range noise, drop-outs, odometry and people."""
        return [np.random.default_rng(child) for child in np.random.SeedSequence(self.seed).spawn(4)]

    @cached_property
    def walks(self) -> tuple[Walk, ...]:
        """Where the people walk."""
        *_, generator = self._streams()
        return walks(self.people, self.plan.world, self.drive, self.walk_mps, generator)

    @cached_property
    def _kept(self) -> tuple[Frame, ...]:
        return tuple(self._simulated())

    @cached_property
    def _wheels(self) -> tuple[Floats, Floats]:
        """The odometry's pose (N, 3) at the first beam of every sweep, and its motion to the last."""
        *_, errors, _ = self._streams()
        last_ns = self._swept_ns + (self.lidar.beams - 1) * self.lidar.time_increment_ns
        odometry = self.odometry.poses(self.drive, np.stack([self._swept_ns, last_ns], axis=1).ravel(), errors)
        return odometry[0::2], se2.between(odometry[0::2], odometry[1::2])

    def _simulated(self) -> Iterator[Frame]:
        noise, dropouts, *_ = self._streams()
        first, turned = self._wheels
        nothing = invalid = 0
        for index, ranges in enumerate(self._ranges(noise, dropouts)):
            if self._arrived[index]:
                scan = self._scan(index, ranges)
                nothing, invalid = nothing + int(scan.no_returns.sum()), invalid + int(np.isnan(scan.ranges).sum())
                yield Frame(scan, self.base_from_sensor, Pose.of(first[index]), Pose.of(turned[index]))
        self._counted = nothing, invalid

    def _ranges(self, noise: np.random.Generator, dropouts: np.random.Generator) -> Iterator[Floats]:
        """What the lidar reports (B,), scan by scan, every beam fired from where the sensor is at that moment."""
        for begin in range(0, len(self._swept_ns), _SCANS_AT_ONCE):
            stamps = self.lidar.beam_stamps(self._swept_ns[begin : begin + _SCANS_AT_ONCE])
            world_from_sensor = se2.compose(self.drive.pose(stamps.ravel()), self.base_from_sensor.row)
            origins, bearings = (
                world_from_sensor[:, :2],
                world_from_sensor[:, 2] + np.tile(self.lidar.angles(), len(stamps)),
            )
            distances = self.plan.world.cast(origins, bearings)
            for walk in self.walks:
                distances = np.minimum(distances, walk.met(origins, bearings, stamps.ravel()))
            yield from self.lidar.measured(distances.reshape(stamps.shape), noise, dropouts)

    def _scan(self, index: int, ranges: Floats) -> Scan:
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
        poses = self.drive.pose(self.stamps_ns)
        seen_m = min(self.drive.path_m, _LOOK_LAPS * self.drive.route.length_m)
        path = self.drive.route.at(np.arange(0.0, seen_m, _LOOK_EVERY_M))
        sensor = se2.compose(path, self.base_from_sensor.row)
        grid = build_true_grid(self.plan.world, self.resolution_m, sensor[:, :2], self.lidar.range_max_m)
        return Truth("exact: simulated", trajectory=Trajectory(self.stamps_ns, poses, "world", "base"), grid=grid)


PARAMETERS = (
    Parameter("seed", 0, "", "draws noise, drop-outs and odometry errors", low=0),
    Parameter("rate_hz", 10.0, "Hz", "revolutions of the lidar a second", low=5.0, high=15.0),
    Parameter("speed_mps", 0.3, "m/s", "speed between the ramps", low=0.05, high=3.0),
    Parameter("turn_dps", 0.0, "deg/s", "yaw rate of every turn: tightened, then slowed down to it; 0: as drawn",
              low=0.0, high=360.0),
    Parameter("laps", 1.0, "", "laps driven, may be a share of one", low=0.02, high=1e5),
    Parameter("noise_m", 0.0483, "m", "standard deviation of a range", low=0.0, high=1.0),
    Parameter("dropout", 0.01, "", "share of beams without an answer", low=0.0, high=1.0),
    Parameter("odometry_scale", 0.01, "", "1 sigma of the wheels' scale error, drawn once a run", low=0.0, high=0.5),
    Parameter("velocity_noise_mps", 0.02, "m/s", "1 sigma of every speed reading at 100 Hz", low=0.0, high=1.0),
    Parameter("gyro_bias_dps", 0.2, "deg/s", "1 sigma of the gyroscope's bias, drawn once a run", low=0.0, high=20.0),
    Parameter("gyro_noise_dps", 0.5, "deg/s", "1 sigma of every yaw rate reading at 100 Hz", low=0.0, high=50.0),
    Parameter("slip_every_s", 0.0, "s", "the wheels slip once in so long, first after half of it; 0: never", low=0.0),
    Parameter("slip_s", 0.5, "s", "how long they slip", low=0.0),
    Parameter("slip_mps", 0.5, "m/s", "by how much they turn too fast meanwhile", low=-3.0, high=3.0),
    Parameter("drop_every_s", 0.0, "s", "scans are lost once in so long, first after half of it; 0: never", low=0.0),
    Parameter("drop_s", 0.5, "s", "for how long scans are lost", low=0.0),
    Parameter("people", 0, "", "people who walk about: discs of 0.25 m radius", low=0, high=50),
    Parameter("walk_mps", 1.0, "m/s", "how fast people walk", low=0.05, high=3.0),
    Parameter("resolution_m", 0.05, "m", "cell size of the true map", low=0.01, high=1.0),
)  # fmt: skip


def sequence(plan: Callable[[], FloorPlan], base_from_sensor: Pose, **parameters: object) -> Synthetic:
    """The sequence of a floor plan with given ``PARAMETERS``; the rest keep their defaults."""
    value = resolve_parameters(plan.__name__, PARAMETERS, parameters)
    number = {name: float(setting) for name, setting in value.items()}
    drawn = plan()
    return Synthetic(
        drawn,
        _drive(drawn.route, number["speed_mps"], number["laps"], float(np.radians(number["turn_dps"]))),
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


def _drive(route: Route, speed_mps: float, laps: float, yaw_rate: float) -> RouteDrive:
    return RouteDrive.turning_at(route, speed_mps, laps, yaw_rate) if yaw_rate else RouteDrive(route, speed_mps, laps)


def _spec(
    plan: Callable[[], FloorPlan],
    summary: str,
    base_from_sensor: Pose,
    degenerate: str = "",
    excerpts: Mapping[Excerpt, Mapping[str, Value]] = MappingProxyType({}),
    **defaults: Value,
) -> DatasetSpec:
    parameters = with_defaults(PARAMETERS, **defaults)
    return DatasetSpec(
        make=partial(sequence, plan, base_from_sensor, **defaults),
        summary=summary,
        sensor="simulated RPLIDAR A2M8: 8,000 beams/s clockwise, 5-15 Hz, 0.15-12 m, 4.83 cm noise, motion in the scan",
        truth="exact: simulated poses at every scan's first beam; map cells cut exactly by the boundaries in view",
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

ROOM = _spec(
    floorplans.room,
    "the paper's 10 x 10 m room with a round obstacle, 23 m, turns up to 69 deg/s at 0.3 m/s",
    _AHEAD,
    excerpts=_EXCERPTS,
)
LAB = _spec(
    floorplans.lab,
    "a laboratory of 10.5 x 8 m with furniture, 24 m around an island, turns up to 69 deg/s at 0.3 m/s; lidar askew",
    Pose(0.08, 0.02, float(np.radians(-30.0))),
    excerpts=_EXCERPTS,
)
LOOP = _spec(
    floorplans.loop,
    "a ring of corridors 41 m around, driven until 2 m are seen again, turns up to 69 deg/s at 0.3 m/s",
    _AHEAD,
    laps=1.05,
)
CORRIDOR = _spec(
    floorplans.corridor,
    "a bare corridor longer than the lidar sees, 21 m there and back, turns up to 43 deg/s at 0.3 m/s",
    _AHEAD,
    degenerate="two bare parallel walls longer than the lidar's range: nothing shows the position along them",
)
OFFICE = _spec(
    floorplans.office,
    "four furnished rooms on a hallway, 35 m through doors, turns up to 69 deg/s at 0.3 m/s; lidar turned by 90 deg",
    Pose(-0.04, 0.0, float(np.radians(90.0))),
)
