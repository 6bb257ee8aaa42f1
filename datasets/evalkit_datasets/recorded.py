"""The catalogued recordings as data sets: each is a reader with its files and parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np

from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.trajectory import Trajectory
from evalkit.io import map_server
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.protocols import Sequence
from evalkit.plugins.specs import DatasetSpec, Excerpt, Published
from evalkit_datasets import catalog, reader_common
from evalkit_datasets.carmen import Carmen
from evalkit_datasets.rosbag import RosBag

TURTLEBOT4_FILES = ("macfirst_floor_take_2_0.db3", "macfirst_floor_take_2-metadata.yaml")

FLOOR_FILES = ("mac_1st_floor_final.pgm", "mac_1st_floor_final.yaml")
"""Map of the building floor of the TurtleBot recording; optional."""

FILES: Mapping[str, tuple[str, ...]] = {
    "fr079": ("fr079-fullrate.clf.gz", "fr079.relations", "fr079-reference-flirtlib.tum"),
    "intel": ("intel-merged.clf.gz", "intel.relations", "intel-reference-flirtlib.tum"),
    "turtlebot4": TURTLEBOT4_FILES,
    "wheelchair": ("wheelchair-3xhokuyo.bag",),
    "static": ("static-2xhokuyo.bag",),
    "backpack": ("cartographer-backpack-short.bag",),
}
"""Files of the catalogue that each data set needs; the first is the recording."""

KUEMMERLE = "Kuemmerle et al. 2009 (as quoted on a third party's page)"
RELATIONS_HOW = "1,685 relations of Kuemmerle et al. 2009 (their own noise: about 0.03 m, 0.4 deg)"
FR079_HOW = f"{RELATIONS_HOW}; 1,464 graph-optimised keyframe poses of flirtlib (0.043 m on the relations)"
INTEL_HOW = (
    f"{RELATIONS_HOW.replace('1,685', '2,984')}; 2,672 graph-optimised poses of flirtlib (0.029 m on the relations), "
    "from 700 s on"
)


def _locate_files(dataset: str) -> list[str]:
    return [str(catalog.locate(name)) for name in FILES[dataset]]


def _fr079(start: int = 0, every: int = 1, limit: int = 0) -> Carmen:
    """Read fr079 without odometry: the odometry columns of the file are pseudo odometry."""
    log, relations, reference = _locate_files("fr079")
    return Carmen(log, relations, reference, odometry="none", how=FR079_HOW, start=start, every=every, limit=limit)


def _intel(start: int = 0, every: int = 1, limit: int = 0) -> Carmen:
    log, relations, reference = _locate_files("intel")
    return Carmen(
        log, relations, reference, odometry="odom-lines", how=INTEL_HOW, start=start, every=every, limit=limit
    )


class RosBagWithFloorMap(RosBag):
    """A bag with a map of the building floor; the map has a separate frame."""

    def truth(self) -> Truth:
        """Return the map of the floor if its files are present; no other truth exists."""
        return replace(super().truth(), plan=_load_floor_map())


def _load_floor_map() -> OccupancyGrid | None:
    if catalog.describe_missing("turtlebot4", FLOOR_FILES):
        return None
    return map_server.read_map(catalog.locate(FLOOR_FILES[1]))


def _turtlebot4(start: int = 0, every: int = 1, limit: int = 0) -> RosBagWithFloorMap:
    bag, _ = _locate_files("turtlebot4")
    return RosBagWithFloorMap(bag, "/scan", base_frame="base_link", start=start, every=every, limit=limit)


def _wheelchair(topic: str = "/right_scan", start: int = 0, every: int = 1, limit: int = 0) -> RosBag:
    (bag,) = _locate_files("wheelchair")
    how = "none; closed path: end and start agree within 0.4 m after about 36 m and one full turn"
    return RosBag(bag, topic, odometry="none", start=start, every=every, limit=limit, how=how)


def _backpack(start: int = 0, every: int = 1, limit: int = 0) -> RosBag:
    (bag,) = _locate_files("backpack")
    return RosBag(bag, "horizontal_laser_2d", odometry="none", start=start, every=every, limit=limit)


class StaticRosBag(RosBag):
    """A bag of a robot that does not move: the true pose is the identity at every scan."""

    def truth(self) -> Truth:
        """Return the identity at every scan."""
        return Truth("exact: the robot does not move", Trajectory(self.stamps_ns, np.zeros((len(self), 3))))


def _static(topic: str = "/front_scan", start: int = 0, every: int = 1, limit: int = 0) -> StaticRosBag:
    (bag,) = _locate_files("static")
    return StaticRosBag(bag, topic, odometry="none", start=start, every=every, limit=limit)


def _make_published(label: str, mean_m: float, sd_m: float) -> Published:
    return Published(label, mean_m, sd_m, KUEMMERLE, "relations_all_mean_m", "relations_all_sd_m")


def _describe_missing(dataset: str, **_: object) -> str:
    return catalog.describe_missing(dataset, FILES[dataset])


def _make_spec(
    dataset: str,
    make: Callable[..., Sequence],
    summary: str,
    truth: str = "",
    topics: tuple[str, ...] = (),
    published: tuple[Published, ...] = (),
    excerpts: Mapping[Excerpt, Mapping[str, Value]] = MappingProxyType({}),
) -> DatasetSpec:
    """Return the spec of a recording with the metadata of the catalogue; ``topics``: its lidars, the default first."""
    card = catalog.get_file(FILES[dataset][0])
    topic = [Parameter("topic", topics[0], "", "topic of the lidar", choices=topics)] if topics else []
    return DatasetSpec(
        make=make,
        summary=summary,
        sensor=card.sensor,
        truth=truth or card.truth,
        citation=card.citation,
        licence=card.licence,
        defects=card.defects,
        published=published,
        parameters=(*topic, *reader_common.SELECTION),
        missing=partial(_describe_missing, dataset),
        thinned_by="every",
        excerpts=excerpts,
    )


FR079 = _make_spec(
    "fr079",
    _fr079,
    "Freiburg building 079, full rate: 4,791 scans, 1,061 s, about 400 m",
    FR079_HOW,
    published=(
        _make_published("scan matching", 0.258, 0.427),
        _make_published("RBPF (GMapping)", 0.061, 0.044),
        _make_published("graph mapping", 0.056, 0.042),
    ),
    excerpts={"full": {"limit": 600}, "quick": {"limit": 90}},
)

INTEL = _make_spec(
    "intel",
    _intel,
    "Intel Research Lab, Seattle: 5,438 scans, 2,684 s, about 500 m, raw wheel odometry",
    INTEL_HOW,
    published=(
        _make_published("scan matching", 0.220, 0.296),
        _make_published("RBPF (GMapping)", 0.070, 0.083),
        _make_published("graph mapping", 0.031, 0.026),
    ),
)

TURTLEBOT4 = _make_spec(
    "turtlebot4",
    _turtlebot4,
    "A TurtleBot 4 with an RPLIDAR on a university floor: 357 scans, 46 s, 8.4 m",
    "none; the floor map is 0.6 m and 4 deg off the odometry of the first scan, and no survey relates the two",
)

WHEELCHAIR = _make_spec(
    "wheelchair",
    _wheelchair,
    "A robotic wheelchair around one closed loop: 435 scans, 58 s, about 36 m",
    topics=("/right_scan", "/left_scan", "/rear_scan"),
)

STATIC = _make_spec(
    "static", _static, "A robot that does not move: 331 scans, 33 s", topics=("/front_scan", "/rear_scan")
)

BACKPACK = _make_spec(
    "backpack",
    _backpack,
    "A backpack carried through the Deutsches Museum: 345 scans, 10 s, no wheel odometry",
    "none",
)
