"""The catalogued recordings as data sets: each is a reader with its files and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.trajectory import Trajectory
from evalkit.io import map_server
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import DatasetSpec, Published
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
    """A bag with a map of the building floor, in a frame of its own."""

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


def _describe_missing(dataset: str, **_: object) -> str:
    return catalog.describe_missing(dataset, FILES[dataset])


def _topic(default: str, *others: str) -> Parameter:
    return Parameter("topic", default, "", "topic of the lidar", choices=(default, *others))


def _metadata(dataset: str, field: str) -> str:
    """Return a metadata field of the data set's recording."""
    return str(getattr(catalog.get_file(FILES[dataset][0]), field))


def _list_defects(dataset: str) -> tuple[str, ...]:
    return catalog.get_file(FILES[dataset][0]).defects


def _make_published(label: str, mean_m: float, sd_m: float) -> Published:
    return Published(label, mean_m, sd_m, KUEMMERLE, "relations_all_mean_m", "relations_all_sd_m")


FR079 = DatasetSpec(
    make=_fr079,
    summary="Freiburg building 079, full rate: 4,791 scans, 1,061 s, about 400 m",
    sensor=_metadata("fr079", "sensor"),
    truth=FR079_HOW,
    citation=_metadata("fr079", "citation"),
    licence=_metadata("fr079", "licence"),
    defects=_list_defects("fr079"),
    published=(
        _make_published("scan matching", 0.258, 0.427),
        _make_published("RBPF (GMapping)", 0.061, 0.044),
        _make_published("graph mapping", 0.056, 0.042),
    ),
    parameters=reader_common.SELECTION,
    missing=partial(_describe_missing, "fr079"),
    thinned_by="every",
    excerpts={"full": {"limit": 600}, "quick": {"limit": 90}},
)

INTEL = DatasetSpec(
    make=_intel,
    summary="Intel Research Lab, Seattle: 5,438 scans, 2,684 s, about 500 m, raw wheel odometry",
    sensor=_metadata("intel", "sensor"),
    truth=INTEL_HOW,
    citation=_metadata("intel", "citation"),
    licence=_metadata("intel", "licence"),
    defects=_list_defects("intel"),
    published=(
        _make_published("scan matching", 0.220, 0.296),
        _make_published("RBPF (GMapping)", 0.070, 0.083),
        _make_published("graph mapping", 0.031, 0.026),
    ),
    parameters=reader_common.SELECTION,
    missing=partial(_describe_missing, "intel"),
    thinned_by="every",
)

TURTLEBOT4 = DatasetSpec(
    make=_turtlebot4,
    summary="A TurtleBot 4 with an RPLIDAR on a university floor: 357 scans, 46 s, 8.4 m",
    sensor=_metadata("turtlebot4", "sensor"),
    truth="none; the floor map is 0.6 m and 4 deg off the odometry of the first scan, and no survey relates the two",
    citation=_metadata("turtlebot4", "citation"),
    licence=_metadata("turtlebot4", "licence"),
    defects=_list_defects("turtlebot4"),
    parameters=reader_common.SELECTION,
    missing=partial(_describe_missing, "turtlebot4"),
    thinned_by="every",
)

WHEELCHAIR = DatasetSpec(
    make=_wheelchair,
    summary="A robotic wheelchair around one closed loop: 435 scans, 58 s, about 36 m",
    sensor=_metadata("wheelchair", "sensor"),
    truth=_metadata("wheelchair", "truth"),
    citation=_metadata("wheelchair", "citation"),
    licence=_metadata("wheelchair", "licence"),
    defects=_list_defects("wheelchair"),
    parameters=(_topic("/right_scan", "/left_scan", "/rear_scan"), *reader_common.SELECTION),
    missing=partial(_describe_missing, "wheelchair"),
    thinned_by="every",
)

STATIC = DatasetSpec(
    make=_static,
    summary="A robot that does not move: 331 scans, 33 s",
    sensor=_metadata("static", "sensor"),
    truth=_metadata("static", "truth"),
    citation=_metadata("static", "citation"),
    licence=_metadata("static", "licence"),
    defects=_list_defects("static"),
    parameters=(_topic("/front_scan", "/rear_scan"), *reader_common.SELECTION),
    missing=partial(_describe_missing, "static"),
    thinned_by="every",
)

BACKPACK = DatasetSpec(
    make=_backpack,
    summary="A backpack carried through the Deutsches Museum: 345 scans, 10 s, no wheel odometry",
    sensor=_metadata("backpack", "sensor"),
    truth="none",
    citation=_metadata("backpack", "citation"),
    licence=_metadata("backpack", "licence"),
    defects=_list_defects("backpack"),
    parameters=reader_common.SELECTION,
    missing=partial(_describe_missing, "backpack"),
    thinned_by="every",
)
