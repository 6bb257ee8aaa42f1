"""The catalogue of recorded files (catalog.toml): find files on this machine and verify their content."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any

from platformdirs import user_cache_dir

from evalkit.core.errors import BadData, DataMissing, UnknownName
from evalkit.io.text_lines import iter_plain_blocks
from evalkit.io.toml import parse_toml

VARIABLE = "EVALKIT_DATA"
"""Environment variable with the path of the folder of recorded data."""

FETCH_COMMAND = "evalkit datasets fetch"
"""Command that downloads a file or all files of a data set."""


@dataclass(frozen=True, slots=True)
class CatalogFile:
    """Metadata of one file. ``path`` is relative to the data folder; ``bytes`` is 0 if unknown.

    The content is verified by ``sha256`` or, if only that is known, by the id of its git blob. A file without ``url``
    is built on this machine from its ``sources``, files of the catalogue (``build``: a builder, or a path in an
    archive), or cannot be had: ``derived`` describes how it was made, ``instead`` lists files to use in its place.
    """

    name: str
    path: str
    summary: str
    licence: str
    citation: str
    sha256: str = ""
    git_blob: str = ""
    bytes: int = 0
    url: str = ""
    sensor: str = ""
    truth: str = ""
    defects: tuple[str, ...] = ()
    derived: str = ""
    instead: tuple[str, ...] = ()
    build: str = ""
    sources: tuple[str, ...] = ()

    @property
    def is_public(self) -> bool:
        """Whether the file can be downloaded, or built from files that can."""
        return bool(self.url or self.build)

    def __post_init__(self) -> None:
        if Path(self.path).is_absolute() or not re.fullmatch(r"[\w-][\w.-]*(/[\w-][\w.-]*)*", self.path):
            raise ValueError(f"path: expected a path relative to the data folder, got {self.path!r}")


@cache
def load_catalog() -> Mapping[str, CatalogFile]:
    """Return all files by name."""
    return MappingProxyType({name: _parse_file(name, card) for name, card in _load_tables()["files"].items()})


def load_datasets() -> Mapping[str, Mapping[str, Any]]:
    """Return the tables of all data sets by name."""
    datasets: dict[str, Any] = _load_tables()["datasets"]
    return MappingProxyType(datasets)


@cache
def _load_tables() -> dict[str, Any]:
    file = resources.files("evalkit_datasets.recordings").joinpath("catalog.toml")
    return parse_toml(file.read_text(encoding="utf-8"))


def get_file(name: str) -> CatalogFile:
    """Return the metadata of a file; raises UnknownName with the known names."""
    if name not in load_catalog():
        raise UnknownName("recorded file", name, load_catalog())
    return load_catalog()[name]


def cache_folder() -> Path:
    """Return the folder of downloaded files: evalkit's cache folder on this platform."""
    return Path(user_cache_dir("evalkit"))


def find_local(card: CatalogFile) -> Path | None:
    """Return the path of a file on this machine, plain or gzip, not verified, or None if it is absent."""
    return next((path for path in _candidate_paths(card) if path.is_file()), None)


def locate(name: str) -> Path:
    """Return the path of a verified file; raises DataMissing with how to get it, or BadData for other content."""
    card = get_file(name)
    path = find_local(card)
    if path is None:
        what, remedy = _describe_absence(card)
        raise DataMissing(name, what, remedy)
    verify(card, path)
    return path


def describe_missing(dataset: str, names: Iterable[str]) -> str:
    """Return which of a data set's files are absent and the command to get them, "" if all are present."""
    absent = [card for card in map(get_file, names) if find_local(card) is None]
    if not absent:
        return ""
    private = [card for card in absent if not card.is_public]
    first = (private or absent)[0]
    what, remedy = _describe_absence(first)
    more = f" (and {len(absent) - 1} more)" if len(absent) > 1 else ""
    return f"{first.name}{more}: {what}; {remedy if private else f'fetch it: {FETCH_COMMAND} {dataset}'}"


def verify(card: CatalogFile, path: Path) -> None:
    """Raise BadData if the content of a file, unpacked if only this copy is compressed, is not the catalogued one."""
    packed = path.suffix == ".gz" and not card.path.endswith(".gz")
    content = _read_packed(card, path) if packed else path.read_bytes()
    size = len(content)
    if card.bytes and size != card.bytes:
        raise BadData(str(path), "", f"{size} bytes instead of {card.bytes}", _suggest_new_copy(card))
    if card.sha256:
        kind, known, actual = "sha256", card.sha256, hashlib.sha256(content).hexdigest()
    else:
        # git identifies a file by the SHA-1 of a header and its content: an identifier, not a protection
        blob = hashlib.sha1(b"blob %d\0" % size + content, usedforsecurity=False)
        kind, known, actual = "git blob", card.git_blob, blob.hexdigest()
    if actual != known:
        raise BadData(str(path), "", f"{kind} {actual[:12]}... instead of {known[:12]}...", _suggest_new_copy(card))


def _read_packed(card: CatalogFile, path: Path) -> bytes:
    """Return the plain content of a gzip file, one block beyond the catalogued size at most."""
    content = bytearray()
    for block in iter_plain_blocks(path, card.summary):
        content += block
        if len(content) > card.bytes:
            break
    return bytes(content)


def _parse_file(name: str, card: Mapping[str, object]) -> CatalogFile:
    lists = {key: tuple(value) for key, value in card.items() if isinstance(value, list)}
    return CatalogFile(name=name, **{**card, **lists})  # type: ignore[arg-type]  # types are checked by a test of the catalogue


def _candidate_paths(card: CatalogFile) -> list[Path]:
    folder = os.environ.get(VARIABLE)
    places = [Path(place) / card.path for place in (folder, cache_folder()) if place]
    return [each for path in places for each in (path, path.with_name(f"{path.name}.gz"))]


def _describe_absence(card: CatalogFile) -> tuple[str, str]:
    """Return what is absent and how to get it."""
    folder = os.environ.get(VARIABLE)
    searched = f"{VARIABLE}={folder}" if folder else f"{VARIABLE} (not set)"
    what = f"not found as {card.path} in {searched} or in the cache {cache_folder()}"
    if card.is_public:
        return what, f"fetch it: {FETCH_COMMAND} {card.name}"
    return f"{what}, and it has no public URL ({card.derived})", suggest_replacement(card)


def suggest_replacement(card: CatalogFile) -> str:
    """Return what to do about a file that cannot be downloaded."""
    own = f"set {VARIABLE} to a folder that contains {card.path}"
    if not card.instead:
        return own
    return f"{own}, or fetch a replacement: {FETCH_COMMAND} {' '.join(card.instead)}"


def _suggest_new_copy(card: CatalogFile) -> str:
    return (
        f"delete it and fetch it again: {FETCH_COMMAND} {card.name}"
        if card.is_public
        else "replace it with the catalogued file"
    )
