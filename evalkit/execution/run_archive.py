"""Pack a stored run into bytes and unpack it, for results from a machine without a shared folder.

Only files that evalkit itself writes travel: what a back end leaves in the folder of its run stays where it is.
"""

from __future__ import annotations

import io
import os
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from zipfile import ZIP_DEFLATED, BadZipFile, ZipFile

from evalkit.core.errors import StoreError
from evalkit.execution.one_run import OUTCOME, REQUEST, STARTED
from evalkit.execution.subprocesses import OUTPUT
from evalkit.io import untrusted_io
from evalkit.io.output_files import REMEDY
from evalkit.results.final_files import CLOSURES, FINAL, PATHS
from evalkit.results.store import ERRORS, FINAL_ERRORS, FIT, GRID, RESULT, SCORES, STEPS, Store

FILES = (
    REQUEST, STARTED, OUTCOME, OUTPUT, STEPS, FINAL, CLOSURES, PATHS, GRID, ERRORS, FINAL_ERRORS, FIT, SCORES, RESULT,
)  # fmt: skip
"""Names of the files in the folder of a run that travel."""

WRITTEN_LAST = (SCORES, RESULT)
"""Files that are unpacked after all others, in this order, because they vouch for them."""

MAX_OUTPUT_BYTES = 2**20
"""Maximum size of a run's output in an archive; the beginning of a longer output is left out."""


def pack_run(store: Store, key: str) -> bytes:
    """The files of a stored run as a zip archive; without links and files above ``untrusted_io.MAX_BYTES``."""
    body = io.BytesIO()
    with ZipFile(body, "w", ZIP_DEFLATED, compresslevel=1) as archive:
        for name, path in _list_files(store, key):
            with suppress(OSError, ValueError):  # not written, or a back end has put something else in its place
                archive.writestr(name, _read_end(path) if path.name == OUTPUT else untrusted_io.read_bytes(path))
    return body.getvalue()


def _read_end(path: Path) -> bytes:
    """The last ``MAX_OUTPUT_BYTES`` of a file; raises OSError for a link."""
    with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW), "rb") as file:  # noqa: PTH123 - a descriptor
        file.seek(max(file.seek(0, os.SEEK_END) - MAX_OUTPUT_BYTES, 0))
        return file.read(MAX_OUTPUT_BYTES)


def unpack_run(store: Store, key: str, content: bytes) -> None:
    """Replace a stored run by an unpacked one, each file atomically. Raises StoreError if the archive is damaged."""
    store.create_run_folder(key)
    folders = _list_folders(store, key)
    try:
        with ZipFile(io.BytesIO(content)) as archive:
            names = [name for name in archive.namelist() if name.partition("/")[0] in folders]
            for name in sorted(names, key=_order_for_unpacking):
                folder, _, file = name.partition("/")
                with archive.open(name) as packed:
                    store.write(folders[folder] / Path(file).name, packed.read(untrusted_io.MAX_BYTES))
    except (BadZipFile, zlib.error, EOFError, RuntimeError) as error:
        raise StoreError(
            str(store.run_folder(key)), f"the archive sent by the worker is damaged ({error})", REMEDY
        ) from error
    store.clear_attempts(key)


def _order_for_unpacking(name: str) -> int:
    file = Path(name).name
    return WRITTEN_LAST.index(file) if file in WRITTEN_LAST else -1


def _list_files(store: Store, key: str) -> Iterator[tuple[str, Path]]:
    """Where the files of a run may lie, by their names in the archive."""
    for name, folder in _list_folders(store, key).items():
        if name == "run":
            yield from ((f"{name}/{file}", folder / file) for file in FILES)
        elif folder.is_dir():
            yield from ((f"{name}/{p.name}", p) for p in sorted(folder.iterdir()) if p.name.startswith(f"{key}."))


def _list_folders(store: Store, key: str) -> dict[str, Path]:
    return {"run": store.run_folder(key), "trajectories": store.folder / "trajectories", "maps": store.folder / "maps"}
