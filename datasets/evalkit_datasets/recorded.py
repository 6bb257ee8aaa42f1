"""The recordings evalkit knows by name: the right reader with the right parameters, and how to get the files."""

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
"""A map of the TurtleBot's floor; the bag can be read without."""

FILES: Mapping[str, tuple[str, ...]] = {
    "fr079": ("fr079-fullrate.clf.gz", "fr079.relations", "fr079-reference-flirtlib.tum"),
    "intel": ("intel-merged.clf.gz", "intel.relations", "intel-reference-flirtlib.tum"),
    "turtlebot4": TURTLEBOT4_FILES,
    "wheelchair": ("wheelchair-3xhokuyo.bag",),
    "static": ("static-2xhokuyo.bag",),
    "backpack": ("cartographer-backpack-short.bag",),
}
"""The catalogued files each data set needs."""

KUEMMERLE = "Kuemmerle et al. 2009 (as quoted on a third party's page)"
RELATIONS_HOW = "1,685 relations of Kuemmerle et al. 2009 (their own noise: about 0.03 m, 0.4 deg)"
FR079_HOW = f"{RELATIONS_HOW}; 1,464 graph-optimised keyframe poses of flirtlib (0.043 m on the relations)"
INTEL_HOW = (
    f"{RELATIONS_HOW.replace('1,685', '2,984')}; 2,672 graph-optimised poses of flirtlib (0.029 m on the relations), "
    "from 700 s on"
)


def _files(dataset: str) -> list[str]:
    return [str(catalog.located(name)) for name in FILES[dataset]]


def _fr079(start: int = 0, every: int = 1, limit: int = 0) -> Carmen:
    """Odometry "none": the odometry columns of this file are pseudo odometry."""
    log, relations, reference = _files("fr079")
    return Carmen(log, relations, reference, odometry="none", how=FR079_HOW, start=start, every=every, limit=limit)


def _intel(start: int = 0, every: int = 1, limit: int = 0) -> Carmen:
    log, relations, reference = _files("intel")
    return Carmen(
        log, relations, reference, odometry="odom-lines", how=INTEL_HOW, start=start, every=every, limit=limit
    )


class OnKnownFloor(RosBag):
    """A bag from a floor whose map is shipped with it, in a frame of its own."""

    def truth(self) -> Truth:
        """The map of the floor where its files are here; nothing else is known."""
        return replace(super().truth(), plan=_floor())


def _floor() -> OccupancyGrid | None:
    if catalog.missing("turtlebot4", FLOOR_FILES):
        return None
    return map_server.read_map(catalog.located(FLOOR_FILES[1]))


def _turtlebot4(start: int = 0, every: int = 1, limit: int = 0) -> OnKnownFloor:
    bag, _ = _files("turtlebot4")
    return OnKnownFloor(bag, "/scan", base_frame="base_link", start=start, every=every, limit=limit)


def _wheelchair(topic: str = "/right_scan", start: int = 0, every: int = 1, limit: int = 0) -> RosBag:
    (bag,) = _files("wheelchair")
    how = "none; the path closes: end and start agree within 0.4 m after about 36 m and one full turn"
    return RosBag(bag, topic, odometry="none", start=start, every=every, limit=limit, how=how)


def _backpack(start: int = 0, every: int = 1, limit: int = 0) -> RosBag:
    (bag,) = _files("backpack")
    return RosBag(bag, "horizontal_laser_2d", odometry="none", start=start, every=every, limit=limit)


class Static(RosBag):
    """A bag of a robot that stands still: the true trajectory is the same pose at every scan."""

    def truth(self) -> Truth:
        """The identity at every scan."""
        return Truth("exact: the robot stands still", Trajectory(self.stamps_ns, np.zeros((len(self), 3))))


def _static(topic: str = "/front_scan", start: int = 0, every: int = 1, limit: int = 0) -> Static:
    (bag,) = _files("static")
    return Static(bag, topic, odometry="none", start=start, every=every, limit=limit)


def _missing(dataset: str, **_: object) -> str:
    return catalog.missing(dataset, FILES[dataset])


def _topic(default: str, *others: str) -> Parameter:
    return Parameter("topic", default, "", "which of the lidars", choices=(default, *others))


def _card(dataset: str, field: str) -> str:
    """A field of the card of the data set's recording."""
    return str(getattr(catalog.entry(FILES[dataset][0]), field))


def _defects(dataset: str) -> tuple[str, ...]:
    return catalog.entry(FILES[dataset][0]).defects


def _published(label: str, mean_m: float, sd_m: float) -> Published:
    return Published(label, mean_m, sd_m, KUEMMERLE, "relations_all_mean_m", "relations_all_sd_m")


FR079 = DatasetSpec(
    make=_fr079,
    summary="Freiburg building 079, full rate: 4,791 scans, 1,061 s, about 400 m",
    sensor=_card("fr079", "sensor"),
    truth=FR079_HOW,
    citation=_card("fr079", "citation"),
    licence=_card("fr079", "licence"),
    defects=_defects("fr079"),
    published=(
        _published("scan matching", 0.258, 0.427),
        _published("RBPF (GMapping)", 0.061, 0.044),
        _published("graph mapping", 0.056, 0.042),
    ),
    parameters=reader_common.SELECTION,
    missing=partial(_missing, "fr079"),
    thinned_by="every",
    excerpts={"full": {"limit": 600}, "quick": {"limit": 90}},
)

INTEL = DatasetSpec(
    make=_intel,
    summary="Intel Research Lab, Seattle: 5,438 scans, 2,684 s, about 500 m, raw wheel odometry",
    sensor=_card("intel", "sensor"),
    truth=INTEL_HOW,
    citation=_card("intel", "citation"),
    licence=_card("intel", "licence"),
    defects=_defects("intel"),
    published=(
        _published("scan matching", 0.220, 0.296),
        _published("RBPF (GMapping)", 0.070, 0.083),
        _published("graph mapping", 0.031, 0.026),
    ),
    parameters=reader_common.SELECTION,
    missing=partial(_missing, "intel"),
    thinned_by="every",
)

TURTLEBOT4 = DatasetSpec(
    make=_turtlebot4,
    summary="A TurtleBot 4 with an RPLIDAR on a university floor: 357 scans, 46 s, 8.4 m",
    sensor=_card("turtlebot4", "sensor"),
    truth="none; the first scan fits the floor's map 0.6 m and 4 deg from its odometry, and no survey ties the two",
    citation=_card("turtlebot4", "citation"),
    licence=_card("turtlebot4", "licence"),
    defects=_defects("turtlebot4"),
    parameters=reader_common.SELECTION,
    missing=partial(_missing, "turtlebot4"),
    thinned_by="every",
)

WHEELCHAIR = DatasetSpec(
    make=_wheelchair,
    summary="A robotic wheelchair around one closed loop: 435 scans, 58 s, about 36 m",
    sensor=_card("wheelchair", "sensor"),
    truth=_card("wheelchair", "truth"),
    citation=_card("wheelchair", "citation"),
    licence=_card("wheelchair", "licence"),
    defects=_defects("wheelchair"),
    parameters=(_topic("/right_scan", "/left_scan", "/rear_scan"), *reader_common.SELECTION),
    missing=partial(_missing, "wheelchair"),
    thinned_by="every",
)

STATIC = DatasetSpec(
    make=_static,
    summary="A robot that stands still: 331 scans, 33 s",
    sensor=_card("static", "sensor"),
    truth=_card("static", "truth"),
    citation=_card("static", "citation"),
    licence=_card("static", "licence"),
    defects=_defects("static"),
    parameters=(_topic("/front_scan", "/rear_scan"), *reader_common.SELECTION),
    missing=partial(_missing, "static"),
    thinned_by="every",
)

BACKPACK = DatasetSpec(
    make=_backpack,
    summary="A backpack carried through the Deutsches Museum: 345 scans, 10 s, no wheels",
    sensor=_card("backpack", "sensor"),
    truth="none",
    citation=_card("backpack", "citation"),
    licence=_card("backpack", "licence"),
    defects=_defects("backpack"),
    parameters=reader_common.SELECTION,
    missing=partial(_missing, "backpack"),
    thinned_by="every",
)
