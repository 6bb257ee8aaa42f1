"""What programs and libraries say of themselves, kept in a results folder: ``--collect`` reads it and starts none.

descriptions/<digest>.json     one program or library as it was when runs were executed, with a checksum
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from evalkit.io.output_files import create_folder, write_bytes
from evalkit.results.seal import read_sealed, seal

FOLDER = "descriptions"

UNKNOWN = "it was never started for this results folder, and --collect does not start it"

_asked: dict[tuple[str, str], dict[str, Any]] = {}
"""The descriptions that this process has asked for, by name and digest."""

_source: Path | None = None
"""The folder that descriptions are read from; None if programs and libraries are asked."""


@contextmanager
def only_stored_in(folder: Path) -> Iterator[None]:
    """Start no program and load no library in the block: ``describe`` reads what this results folder holds."""
    global _source  # noqa: PLW0603 - back ends are found by name, from everywhere in a command
    before, _source = _source, folder
    try:
        yield
    finally:
        _source = before


def describe(name: str, digest: str, ask: Callable[[], dict[str, Any]]) -> dict[str, Any] | None:
    """Return the description of a back end, asked for once in a process, or read: see ``only_stored_in``.

    ``digest``: of the command and its files, which distinguishes builds. None where no description is stored, or a
    damaged one.
    """
    if _source is not None:
        return _read(_source, name, digest)
    if (name, digest) not in _asked:
        _asked[name, digest] = ask()
    return _asked[name, digest]


def save(folder: Path, names: Collection[str]) -> None:
    """Write the descriptions that these back ends gave to this process; raises StoreError."""
    for (name, digest), content in list(_asked.items()):
        if name in names:
            create_folder(folder / FOLDER, folder)
            record = {"name": name, "digest": digest, "description": content}
            write_bytes(_file(folder, name, digest), seal(record, {}).encode(), folder)


def _read(folder: Path, name: str, digest: str) -> dict[str, Any] | None:
    try:
        record = read_sealed(_file(folder, name, digest))
    except (OSError, ValueError):
        return None
    content = record.get("description")
    return content if record.get("name") == name and isinstance(content, dict) else None


def _file(folder: Path, name: str, digest: str) -> Path:
    return folder / FOLDER / f"{hashlib.sha256(f'{name} {digest}'.encode()).hexdigest()[:16]}.json"
