"""A stored run as bytes and back: results of a machine that shares no folder with ours."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from zipfile import ZIP_DEFLATED, BadZipFile, ZipFile

from evalkit.core.errors import StoreError
from evalkit.results.store import REMEDY, Store

LATER = ("scores.json", "run.json")
"""Written after all others, in this order: they vouch for them."""

MAX_OUTPUT = 2**20
"""So much of what a run said is sent, from its end."""


def packed(store: Store, key: str) -> bytes:
    """All a store keeps of a run, as a zip archive."""
    body = io.BytesIO()
    with ZipFile(body, "w", ZIP_DEFLATED, compresslevel=1) as archive:
        for name, path in _files(store, key):
            archive.writestr(name, path.read_bytes()[-MAX_OUTPUT if name == "run/output.txt" else 0 :])
    return body.getvalue()


def unpacked(store: Store, key: str, content: bytes) -> None:
    """Puts what was packed into a store in place of what is there, each file whole or not at all."""
    store.fresh(key)
    places = _places(store, key)
    try:
        with ZipFile(io.BytesIO(content)) as archive:
            names = [name for name in archive.namelist() if name.partition("/")[0] in places]
            for name in sorted(
                names, key=lambda name: LATER.index(Path(name).name) if Path(name).name in LATER else -1
            ):
                folder, _, file = name.partition("/")
                store.write_bytes(places[folder] / Path(file).name, archive.read(name))
    except BadZipFile as error:
        raise StoreError(str(store.run_folder(key)), f"what came for it is damaged ({error})", REMEDY) from error


def _files(store: Store, key: str) -> Iterator[tuple[str, Path]]:
    for place, folder in _places(store, key).items():
        if folder.is_dir():
            stem = "" if place == "run" else f"{key}."
            yield from (
                (f"{place}/{p.name}", p) for p in sorted(folder.iterdir()) if p.is_file() and p.name.startswith(stem)
            )


def _places(store: Store, key: str) -> dict[str, Path]:
    return {"run": store.run_folder(key), "trajectories": store.folder / "trajectories", "maps": store.folder / "maps"}
