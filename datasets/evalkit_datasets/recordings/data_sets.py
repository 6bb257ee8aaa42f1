"""The catalogued recordings as data sets: each is a reader with its files and parameters (catalog.toml)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from evalkit.core.ground_truth import Truth
from evalkit.core.trajectory import Trajectory
from evalkit.io import map_server
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.protocols import Sequence
from evalkit.plugins.specs import DatasetSpec, Published
from evalkit_datasets.readers import reader_common
from evalkit_datasets.readers.carmen import Carmen
from evalkit_datasets.readers.columns import Columns
from evalkit_datasets.readers.rosbag import RosBag
from evalkit_datasets.recordings import catalog

FLOOR_FILES = ("mac_1st_floor_final.pgm", "mac_1st_floor_final.yaml")
"""Map of the building floor of the TurtleBot recording; optional."""

KUEMMERLE = "Kuemmerle et al. 2009 (as quoted on a third party's page)"


class RosBagWithFloorMap(RosBag):
    """A bag with a map of the building floor; the map has a separate frame."""

    def truth(self) -> Truth:
        """Return the map of the floor if its files are present; no other truth exists."""
        if catalog.describe_missing("turtlebot4", FLOOR_FILES):
            return super().truth()
        return replace(super().truth(), plan=map_server.read_map(catalog.locate(FLOOR_FILES[1])))


class StaticRosBag(RosBag):
    """A bag of a robot that does not move: the true pose is the identity at every scan."""

    def truth(self) -> Truth:
        """Return the identity at every scan."""
        return Truth("exact: the robot does not move", Trajectory(self.stamps_ns, np.zeros((len(self), 3))))


class RawCarmen(Carmen):
    """The raw log of a recording, used in place of the built one; its notes say so."""

    def notes(self) -> Mapping[str, int]:
        """Return the number of defects handled, by name, and that the log is the raw one."""
        return {**super().notes(), "raw log, with its own odometry and stamps, in place of the built recording": 1}


READERS: Mapping[str, Callable[..., Sequence]] = {
    "carmen": Carmen,
    "raw carmen": RawCarmen,
    "columns": Columns,
    "rosbag": RosBag,
    "rosbag with a floor map": RosBagWithFloorMap,
    "rosbag of a robot at rest": StaticRosBag,
}

DATASETS = catalog.load_datasets()

FILES: Mapping[str, tuple[str, ...]] = {
    name: tuple(dict.fromkeys((*card["files"].values(), *card.get("beside", ()), *card.get("drives", {}).values())))
    for name, card in DATASETS.items()
}
"""Files of the catalogue that each data set needs; the first is the recording."""


def find_raw(name: str) -> Mapping[str, Value]:
    """Return the path (a file of the catalogue) and parameters of the raw log, empty if it is not on this machine."""
    raw: Mapping[str, Value] = DATASETS[name].get("raw", {})
    return raw if raw and catalog.find_local(catalog.get_file(str(raw["path"]))) is not None else {}


def needed_files(name: str, drive: str = "") -> tuple[str, ...]:
    """Return the files of the catalogue that a data set (one of its drives) needs here; the first is the recording."""
    first, *others = FILES[name]
    drives = DATASETS[name].get("drives", {})
    recording = drives.get(drive, first)
    raw = find_raw(name) if recording == first else {}
    return (str(raw["path"]) if raw else recording, *(file for file in others if file not in drives.values()))


def recordings_of(name: str) -> tuple[str, ...]:
    """Return the files of the catalogue that are recordings of a data set: one, or one for each of its drives."""
    return tuple(DATASETS[name].get("drives", {}).values()) or FILES[name][:1]


def files_of(name: str) -> tuple[str, ...]:
    """Return the files to fetch for a data set, with all its drives, or for a file of the catalogue."""
    if name not in DATASETS:
        return (name,)
    drives = DATASETS[name].get("drives", {"": ""})
    return tuple(dict.fromkeys(file for drive in drives for file in needed_files(name, drive)))


def _open(name: str, drive: str = "", **selection: Value) -> Sequence:
    """Return the sequence of a data set; ``selection``: the parameters of its spec."""
    card, raw, needed = DATASETS[name], find_raw(name), needed_files(name, drive)
    raw = raw if needed[0] == raw.get("path") else {}
    located = [str(catalog.locate(file)) for file in needed]
    files = dict(zip(card["files"], located, strict=False))  # those beside have no parameter
    how = {"how": card["truth"]} if "relations" in files else {}
    topic = {"topic": card["topics"][0]} if "topics" in card else {}
    own = {**card.get("parameters", {}), **{key: value for key, value in raw.items() if key != "path"}}
    reader = READERS[f"raw {card['reader']}" if raw else card["reader"]]
    return reader(**{**files, **how, **topic, **own, **selection})


def _describe_missing(name: str, drive: str = "", **_: object) -> str:
    return catalog.describe_missing(name, needed_files(name, drive))


def _make_spec(name: str) -> DatasetSpec:
    """Return the spec of a data set with the metadata of its recording."""
    card, file = DATASETS[name], catalog.get_file(FILES[name][0])
    choices = {"topic": ("topic of the lidar", card.get("topics")), "drive": ("recording", card.get("drives"))}
    chosen = [
        Parameter(key, next(iter(known)), "", meaning, choices=tuple(known))
        for key, (meaning, known) in choices.items()
        if known
    ]
    return DatasetSpec(
        make=partial(_open, name),
        summary=card["summary"],
        sensor=file.sensor,
        truth=card.get("truth", file.truth),
        citation=file.citation,
        licence=file.licence,
        defects=file.defects,
        published=tuple(
            Published(label, mean_m, sd_m, KUEMMERLE, "relations_all_mean_m", "relations_all_sd_m")
            for label, mean_m, sd_m in card.get("published", ())
        ),
        parameters=(*chosen, *reader_common.SELECTION),
        missing=partial(_describe_missing, name),
        thinned_by="every",
        excerpts=card.get("excerpts", {}),
    )


FR079 = _make_spec("fr079")
INTEL = _make_spec("intel")
TURTLEBOT4 = _make_spec("turtlebot4")
WHEELCHAIR = _make_spec("wheelchair")
STATIC = _make_spec("static")
BACKPACK = _make_spec("backpack")
RPLIDAR_SLAMBOT = _make_spec("rplidar-slambot")
