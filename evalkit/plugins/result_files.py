"""Results of other programs by address: a file, or what is meant in it (``run.mcap?topic=/pose``).

TUM trajectories are read here; readers of other files are plug-ins, found by the suffix of the file.
"""

from __future__ import annotations

import filecmp
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import parse_qsl

from evalkit.core.errors import BadData
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.io.map_server import read_rotated_map
from evalkit.io.tum import TumFile, read_tum
from evalkit.plugins import registry

KEYS = ("topic", "tf", "map")


@dataclass(frozen=True, slots=True)
class ResultReader:
    """A reader of files with results, registered under ``evalkit.result_readers``.

    ``trajectory(path, query)`` returns the poses that a query means: its ``topic`` or its chain of frames ``tf``
    ("map,base_link"). ``grid(path, topic)`` returns a grid with its corner at its own origin, and ``map_from_grid``.
    Both raise BadData with what the file holds.
    """

    suffixes: tuple[str, ...]
    trajectory: Callable[[Path, Mapping[str, str]], TumFile]
    grid: Callable[[Path, str], tuple[OccupancyGrid, Pose]]


@dataclass(frozen=True, slots=True)
class ResultAddress:
    """A path, and what is meant in the file: ``topic``, ``tf`` or ``map``; empty for the file itself.

    ``final``: the address of the corrected poses of the same run, "" for none.
    """

    path: Path
    query: Mapping[str, str] = field(default_factory=dict)
    final: str = ""

    @property
    def is_map(self) -> bool:
        """Whether a map is meant."""
        return "map" in self.query


def parse_address(text: str) -> ResultAddress:
    """Parse ``PATH`` or ``PATH?topic=...``, ``PATH?tf=PARENT,CHILD``, ``PATH?map=TOPIC``. Raises BadData.

    ``PATH?final=ADDRESS``, or ``&final=ADDRESS`` at the end, names the corrected poses of a SLAM. ADDRESS may have a
    question mark of its own.
    """
    name, mark, words = text.partition("?")
    if not mark or Path(text).exists():  # a file may have a question mark in its name
        return ResultAddress(Path(text))
    own, mark, final = ("", "final=", words[6:]) if words.startswith("final=") else words.partition("&final=")
    try:
        pairs = parse_qsl(own, keep_blank_values=True, strict_parsing=True, max_num_fields=1) if own else []
    except ValueError:
        pairs = []
    valid = (pairs and pairs[0][0] in KEYS and pairs[0][1]) or (not own and final)
    if not valid or (mark and not final) or (final and "map" in dict(pairs)):
        remedy = "write ?topic=/pose, ?tf=map,base_link or ?map=/map; ?final=FILE or &final=FILE for corrected poses"
        raise BadData(name, "", f"'?{words[:80]}' behind its name", remedy)
    return ResultAddress(Path(name), dict(pairs), final)


def is_same_result(one: str, other: str) -> bool:
    """Return whether two addresses mean the same poses: in the same file, or in files of the same content."""
    first, second = parse_address(one), parse_address(other)
    if first.query != second.query:
        return False
    if first.path.resolve() == second.path.resolve():
        return True
    return first.path.is_file() and second.path.is_file() and filecmp.cmp(first.path, second.path, shallow=False)


def read_trajectory(text: str) -> TumFile:
    """Read the trajectory at an address: a TUM file, or the poses of a topic or of a chain of frames.

    Raises DataMissing if there is no such file, BadData if it does not hold what is meant.
    """
    address = parse_address(text)
    if address.final:
        what = f"'final={address.final[:80]}' behind its name"
        raise BadData(str(address.path), "", what, "name corrected poses for a method only: file:ONLINE?final=FINAL")
    reader = find_reader(address.path)
    if reader is None and not address.query:
        return read_tum(address.path)
    return _require_reader(address, reader).trajectory(address.path, address.query)


def read_grid(text: str) -> tuple[OccupancyGrid, Pose]:
    """Read the map at an address ``PATH?map=TOPIC``: the grid with its corner at its origin, and ``map_from_grid``."""
    address = parse_address(text)
    return _require_reader(address, find_reader(address.path)).grid(address.path, address.query.get("map", ""))


def read_map(text: str) -> tuple[OccupancyGrid, Pose]:
    """Read the map at an address: a map_server YAML file, or ``BAG?map=TOPIC``; see ``read_grid``.

    Raises BadData or DataMissing.
    """
    address = parse_address(text)
    if address.is_map:
        return read_grid(text)
    if address.query or address.final:
        what = f"no map is meant by '{text[-80:]}'"
        raise BadData(str(address.path), "", what, "give a map_server file (.yaml), or a bag: run.mcap?map=/map")
    return read_rotated_map(address.path)


def find_reader(path: Path) -> ResultReader | None:
    """Return the reader of a file by its suffix, or by those of the files in a folder; None if there is none."""
    names = [path.name.lower()]
    if path.is_dir():
        names += [file.name.lower() for file in path.iterdir()]
    for name in registry.names("result_readers"):
        reader = registry.load("result_readers", name, ResultReader)
        if any(each.endswith(reader.suffixes) for each in names):
            return reader
    return None


def _require_reader(address: ResultAddress, reader: ResultReader | None) -> ResultReader:
    if reader is None:
        what = (
            f"'?{'&'.join(f'{key}={value}' for key, value in address.query.items())}' behind the name of a plain file"
        )
        raise BadData(str(address.path), "", what, "give a bag, or a TUM file without a question mark")
    return reader
