"""The keys of a sequence whose methods track the robot in a known map: ``map``, ``map_start``, ``align_truth``."""

from __future__ import annotations

from collections.abc import Mapping

from evalkit.config.toml_tables import TomlTable
from evalkit.core.errors import BadData, DataMissing
from evalkit.io.map_server import find_map_image
from evalkit.plugins.known_map import parse_start
from evalkit.plugins.parameters import ALIGN_TRUTH, MAP, MAP_START, TRUE_MAP, Value
from evalkit.plugins.result_files import parse_address, read_map


def read_localisation(table: TomlTable) -> dict[str, Value]:
    """Return the reserved parameters of a known map, the file's path absolute; empty without the key ``map``.

    Raises BadExperiment, also where the map cannot be read.
    """
    name, start = table.text(MAP), table.text(MAP_START)
    align = table.flag(ALIGN_TRUTH)
    if not name:
        for key in (MAP_START, ALIGN_TRUTH):
            if key in table.content:
                raise table.error(f"'{key}': needs the key '{MAP}'")
        return {}
    with table.errors():
        parse_start(start)
    if name != TRUE_MAP:
        try:
            read_map(name)
        except (BadData, DataMissing) as error:
            raise table.error(str(error)) from error
        name = _make_absolute(name)
    found: dict[str, Value] = {MAP: name, MAP_START: start, ALIGN_TRUTH: align}
    return {key: value for key, value in found.items() if value}


def list_map_files(localisation: Mapping[str, Value]) -> list[str]:
    """Return the files that a known map is read from: its YAML file and image, or a bag; a true map has none."""
    name = str(localisation.get(MAP, TRUE_MAP))
    if name == TRUE_MAP:
        return []
    address = parse_address(name)
    image = None if address.is_map else find_map_image(address.path)
    return [str(address.path), *([str(image)] if image is not None else [])]


def _make_absolute(name: str) -> str:
    address = parse_address(name)
    return str(address.path.resolve()) + "".join(f"?{key}={value}" for key, value in address.query.items())
