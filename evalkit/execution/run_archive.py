"""Pack a stored run into bytes and unpack it, for results from a machine without a shared folder."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from zipfile import ZIP_DEFLATED, BadZipFile, ZipFile

from evalkit.core.errors import StoreError
from evalkit.io.output_files import REMEDY
from evalkit.results.store import RESULT, SCORES, Store

WRITTEN_LAST = (SCORES, RESULT)
"""Files that are unpacked after all others, in this order, because they vouch for them."""

MAX_OUTPUT_BYTES = 2**20
"""Maximum size of a run's output in an archive; the beginning of a longer output is left out."""


def pack_run(store: Store, key: str) -> bytes:
    """All files of a stored run as a zip archive."""
    body = io.BytesIO()
    with ZipFile(body, "w", ZIP_DEFLATED, compresslevel=1) as archive:
        for name, path in _list_files(store, key):
            archive.writestr(name, path.read_bytes()[-MAX_OUTPUT_BYTES if name == "run/output.txt" else 0 :])
    return body.getvalue()


def unpack_run(store: Store, key: str, content: bytes) -> None:
    """Replace a stored run by an unpacked one, each file atomically. Raises StoreError if the archive is damaged."""
    store.create_run_folder(key)
    folders = _list_folders(store, key)
    try:
        with ZipFile(io.BytesIO(content)) as archive:
            names = [name for name in archive.namelist() if name.partition("/")[0] in folders]
            for name in sorted(names, key=_order_for_unpacking):
                folder, _, file = name.partition("/")
                store.write(folders[folder] / Path(file).name, archive.read(name))
    except BadZipFile as error:
        raise StoreError(
            str(store.run_folder(key)), f"the archive sent by the worker is damaged ({error})", REMEDY
        ) from error
    store.clear_attempts(key)


def _order_for_unpacking(name: str) -> int:
    file = Path(name).name
    return WRITTEN_LAST.index(file) if file in WRITTEN_LAST else -1


def _list_files(store: Store, key: str) -> Iterator[tuple[str, Path]]:
    for name, folder in _list_folders(store, key).items():
        if folder.is_dir():
            stem = "" if name == "run" else f"{key}."
            yield from (
                (f"{name}/{p.name}", p) for p in sorted(folder.iterdir()) if p.is_file() and p.name.startswith(stem)
            )


def _list_folders(store: Store, key: str) -> dict[str, Path]:
    return {"run": store.run_folder(key), "trajectories": store.folder / "trajectories", "maps": store.folder / "maps"}
