"""Drive worlds with lidars of other kinds and print the ATE: ``python tests/baselines/slam/lidars.py 2``.

A row for each world and lidar: median and worst of all drives with each odometry, cm. Rates, beams, fields of view, and
ranges are those of the products; the noise of a range is assumed. ``good``: errors as the worlds have them; ``late``:
the odometry of the scan before; ``gyro``: a bias of 1.5 deg/s (1 sigma); ``none``: no odometry.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from false_loops import WORLDS, ate

from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.plugins import registry
from evalkit_datasets.worlds.lidar import LidarModel
from evalkit_datasets.worlds.synthetic import Synthetic


@dataclass(frozen=True)
class Lidar(LidarModel):
    """A lidar with a number of beams within a field of view, counter-clockwise from its right end."""

    count: int = 360
    view_deg: float = 360.0

    @property
    def beams(self) -> int:
        """Number of beams of a scan."""
        return self.count

    @property
    def time_increment_ns(self) -> int:
        """Nanoseconds between two beams."""
        return round(1e9 / self.rate_hz * self.view_deg / 360.0 / self.count)

    def angles(self) -> Floats:
        """Return the angles (B,) of the beams in the sensor frame (rad)."""
        half = np.radians(0.5 * self.view_deg)
        return np.linspace(-half, half, self.count, endpoint=self.view_deg < 360.0)


LIDARS: dict[str, LidarModel] = {
    "RPLIDAR A1": Lidar(5.5, 0.03, range_max_m=12.0),
    "RPLIDAR A2M8": LidarModel(),
    "LDS-01": Lidar(5.0, 0.02, range_min_m=0.12, range_max_m=3.5),
    "URG-04LX": Lidar(10.0, 0.03, range_min_m=0.06, range_max_m=5.6, count=682, view_deg=240.0),
    "UST-10LX": Lidar(40.0, 0.02, range_min_m=0.06, range_max_m=10.0, count=1081, view_deg=270.0),
    "LMS200": Lidar(37.5, 0.02, range_max_m=30.0, count=181, view_deg=180.0),
    "TiM571": Lidar(15.0, 0.02, range_min_m=0.05, range_max_m=25.0, count=811, view_deg=270.0),
    "RPLIDAR S2": Lidar(10.0, 0.02, range_min_m=0.05, range_max_m=30.0, count=3200),
}
ODOMETRIES: dict[str, dict[str, float]] = {"good": {}, "late": {}, "gyro": {"gyro_bias_dps": 1.5}, "none": {}}


def main() -> int:
    """Drive and print."""
    parser = argparse.ArgumentParser(description="ATE of a SLAM with other lidars.")
    parser.add_argument("drives", type=int, nargs="?", default=2, help="of each world, lidar and odometry")
    parser.add_argument("--method", default="embedded-slam")
    parser.add_argument("--first-seed", type=int, default=700)
    parser.add_argument("--worlds", nargs="*", default=["room", "lab", "office", "loop", "doors", "wings"])
    arguments = parser.parse_args()
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.drives)
    columns = [f"{odometry}: {part}" for odometry in ODOMETRIES for part in ("median", "worst")]
    sys.stdout.write(f"| world | lidar | {' | '.join(columns)} |\n|{'---|' * (2 + len(columns))}\n")
    with ProcessPoolExecutor() as pool:
        for world in arguments.worlds:
            for lidar in LIDARS:
                cells = []
                for odometry in ODOMETRIES:
                    errors = list(pool.map(partial(drive, arguments.method, world, lidar, odometry), seeds))
                    cells += [f"{100.0 * np.median(errors):.1f}", f"{100.0 * max(errors):.1f}"]
                sys.stdout.write(f"| {world} | {lidar} | {' | '.join(cells)} |\n")
                sys.stdout.flush()
    return 0


def drive(method: str, world: str, lidar: str, odometry: str, seed: int) -> float:
    """Drive once and return the ATE RMSE (m) of the corrected poses."""
    made = registry.dataset(world).make(seed=seed, **{**WORLDS.get(world, {}), **ODOMETRIES[odometry]})
    given = made.plan, made.drive, LIDARS[lidar], made.odometry, made.base_from_sensor, made.seed
    sequence = Synthetic(*given)
    spec = registry.backend(method)
    slam = spec.make(**{each.name: each.default for each in spec.parameters})
    for frame in frames_of(sequence, odometry):
        slam.update(frame)
    final = slam.trajectory()
    return ate(final.poses, sequence.truth().trajectory.at(final.stamps_ns))


def frames_of(sequence: Synthetic, odometry: str) -> Iterator[Frame]:
    """Yield the frames of a drive as the method gets them."""
    before: Frame | None = None
    for frame in sequence.frames():
        if odometry == "none":
            yield Frame(frame.scan, frame.base_from_sensor)
        elif odometry == "late":
            given = before or frame
            yield replace(frame, odom_from_base=given.odom_from_base, start_from_end=given.start_from_end)
            before = frame
        else:
            yield frame


if __name__ == "__main__":
    sys.exit(main())
