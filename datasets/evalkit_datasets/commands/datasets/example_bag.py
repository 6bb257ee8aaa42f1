"""Write a simulated drive as a ROS 2 bag, with its true trajectory and map, to try evalkit without a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from evalkit.core.errors import StoreError, UnknownName
from evalkit.core.trajectory import Trajectory
from evalkit.io.map_server import write_map
from evalkit.io.output_files import as_store_error
from evalkit.io.tum import format_tum
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit_datasets.worlds import synthetic
from evalkit_datasets.worlds.synthetic import Synthetic

WORLDS = {
    "room": synthetic.ROOM,
    "lab": synthetic.LAB,
    "loop": synthetic.LOOP,
    "corridor": synthetic.CORRIDOR,
    "office": synthetic.OFFICE,
    "doors": synthetic.DOORS,
    "wings": synthetic.WINGS,
    "symmetric-office": synthetic.SYMMETRIC_OFFICE,
    "long-loop": synthetic.LONG_LOOP,
    "random-office": synthetic.RANDOM_OFFICE,
    "random-home": synthetic.RANDOM_HOME,
    "random-warehouse": synthetic.RANDOM_WAREHOUSE,
}
DEFAULTS: Mapping[str, Value] = {"laps": 0.25}
"""Defaults of an example: long enough to contain a turn, short enough to compare in seconds."""


@dataclass(frozen=True)
class Example:
    """The files written, the folder of the bag, the true trajectory and the true map, and the size of the drive."""

    bag: Path
    truth: Path
    map: Path
    scans: int
    duration_s: float
    path_m: float


def write_example(bag: Path, world: str, given: Mapping[str, object]) -> Example:
    """Write a bag (/scan, /odom, /tf_static) of a drive through a synthetic world, ``<bag>.tum`` and ``<bag>.yaml``.

    Raises StoreError if a file exists already, UnknownName for an unknown world, BadParameter for a wrong parameter.
    """
    if world not in WORLDS:
        raise UnknownName("synthetic data set", world, WORLDS)
    true, plan, image = (bag.with_name(f"{bag.name}.{suffix}") for suffix in ("tum", "yaml", "pgm"))
    for path in (bag, true, plan, image):
        if path.exists():
            raise StoreError(str(path), "exists already", "delete it, or give another name")
    spec = WORLDS[world]
    parameters = resolve_parameters(world, spec.parameters, {**DEFAULTS, **given})
    drive = cast(Synthetic, spec.make(**parameters))  # all WORLDS make one
    with as_store_error(bag):
        return _write_files(bag, true, plan, drive)


def _write_files(bag: Path, true: Path, plan: Path, drive: Synthetic) -> Example:
    from evalkit.commands.export import mcap  # noqa: PLC0415 - heavy, and used for bags only

    begin = mcap.MIN_STAMP_NS
    shift = begin - int(drive.stamps_ns[0])
    bag.parent.mkdir(parents=True, exist_ok=True)
    builder = mcap.MessageBuilder()
    mcap.write_bag(bag, builder, mcap.sequence_messages(builder, drive, shift, begin))
    poses = drive.drive.poses(drive.stamps_ns)
    true.write_text(format_tum(Trajectory(drive.stamps_ns + shift, poses), "exact: simulated"), encoding="utf-8")
    grid = drive.truth().grid
    assert grid is not None  # every simulated world has a map
    write_map(plan.with_suffix(""), grid)
    path_m = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    return Example(bag, true, plan, len(drive), 1e-9 * float(drive.stamps_ns[-1] - drive.stamps_ns[0]), path_m)
