"""What evalkit knows of each recorded file (catalog.toml), where it is on this machine, and whether it is that one."""

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

from evalkit.core.errors import BadData, DataMissing, UnknownName
from evalkit.io.toml import parse_toml

VARIABLE = "EVALKIT_DATA"
"""The environment variable that names the folder of recorded data."""

FETCH = "evalkit datasets fetch"
"""The command that downloads a file or all files of a data set."""


@dataclass(frozen=True, slots=True)
class CatalogFile:
    """The card of one file. ``path``: below the data folder. ``bytes``: 0 where not known.

    Checked by ``sha256`` or, where only that is known, by the id of its git blob. Without ``url`` it cannot be
    downloaded: ``derived`` says what it was made of and ``instead`` what can be fetched in its place.
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

    def __post_init__(self) -> None:
        if Path(self.path).is_absolute() or not re.fullmatch(r"[\w-][\w.-]*(/[\w-][\w.-]*)*", self.path):
            raise ValueError(f"path: expected one below the data folder, got {self.path!r}")


@cache
def entries() -> Mapping[str, CatalogFile]:
    """All files by name."""
    text = resources.files("evalkit_datasets").joinpath("catalog.toml").read_text(encoding="utf-8")
    return MappingProxyType({name: _entry(name, card) for name, card in parse_toml(text)["files"].items()})


def entry(name: str) -> CatalogFile:
    """The card of a file; UnknownName lists the known ones."""
    if name not in entries():
        raise UnknownName("recorded file", name, entries())
    return entries()[name]


def cache_folder() -> Path:
    """Where downloaded files live: the platform's cache folder of evalkit."""
    import pooch  # noqa: PLC0415 - heavy, and only recordings need it

    return Path(pooch.os_cache("evalkit"))


def found(card: CatalogFile) -> Path | None:
    """Where the file is on this machine, not yet verified; None where it is not."""
    return next((path for path in _places(card) if path.is_file()), None)


def located(name: str) -> Path:
    """The verified file; DataMissing says how to get it, BadData that it is not the one it should be."""
    card = entry(name)
    path = found(card)
    if path is None:
        what, remedy = _absence(card)
        raise DataMissing(name, what, remedy)
    verify(card, path)
    return path


def missing(dataset: str, names: Iterable[str]) -> str:
    """Which of a data set's files are not here and the exact way to get them; "" where all are."""
    absent = [card for card in map(entry, names) if found(card) is None]
    if not absent:
        return ""
    underived = [card for card in absent if not card.url]
    what, remedy = _absence((underived or absent)[0])
    more = f" (and {len(absent) - 1} more)" if len(absent) > 1 else ""
    return f"{(underived or absent)[0].name}{more}: {what}; {remedy if underived else f'fetch it: {FETCH} {dataset}'}"


def verify(card: CatalogFile, path: Path) -> None:
    """Nothing where the file's content is the catalogued one, BadData otherwise."""
    size = path.stat().st_size
    if card.bytes and size != card.bytes:
        raise BadData(str(path), "", f"{size} bytes instead of {card.bytes}", _other_copy(card))
    content = path.read_bytes()
    if card.sha256:
        kind, known, seen = "sha256", card.sha256, hashlib.sha256(content).hexdigest()
    else:
        # git names a file by the sha1 of a header and its content; it identifies, it protects nothing
        blob = hashlib.sha1(b"blob %d\0" % size + content, usedforsecurity=False)
        kind, known, seen = "git blob", card.git_blob, blob.hexdigest()
    if seen != known:
        raise BadData(str(path), "", f"{kind} {seen[:12]}... instead of {known[:12]}...", _other_copy(card))


def _entry(name: str, card: Mapping[str, object]) -> CatalogFile:
    lists = {key: tuple(value) for key, value in card.items() if isinstance(value, list)}
    return CatalogFile(name=name, **{**card, **lists})  # type: ignore[arg-type]  # the test of the catalogue checks the types


def _places(card: CatalogFile) -> list[Path]:
    folder = os.environ.get(VARIABLE)
    return [Path(place) / card.path for place in (folder, cache_folder()) if place]


def _absence(card: CatalogFile) -> tuple[str, str]:
    """What is absent, and the exact way to get it."""
    folder = os.environ.get(VARIABLE)
    searched = f"{VARIABLE}={folder}" if folder else f"{VARIABLE} (not set)"
    what = f"not found as {card.path} in {searched} or in the cache {cache_folder()}"
    if card.url:
        return what, f"fetch it: {FETCH} {card.name}"
    return f"{what}, and it has no public address ({card.derived})", without_address(card)


def without_address(card: CatalogFile) -> str:
    """What to do about a file that cannot be downloaded."""
    own = f"set {VARIABLE} to a folder that holds {card.path}"
    if not card.instead:
        return own
    return f"{own}, or fetch in its place: {FETCH} {' '.join(card.instead)}"


def _other_copy(card: CatalogFile) -> str:
    return f"remove it and fetch it again: {FETCH} {card.name}" if card.url else "replace it by a good copy"
