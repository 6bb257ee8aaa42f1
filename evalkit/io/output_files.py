"""Write files whole or not at all, durably, and never through a symbolic link below a given folder."""

from __future__ import annotations

import errno
import json
import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from evalkit.core.errors import StoreError

ANOTHER_FOLDER = "name another folder"
REMEDY = f"free some space or {ANOTHER_FOLDER}"

_NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

_FOLDER = os.O_RDONLY | getattr(os, "O_DIRECTORY", 0) | getattr(os, "O_CLOEXEC", 0)
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)


def write_bytes(path: Path, content: bytes, root: Path | None = None) -> None:
    """Replace a file atomically and durably; a symbolic link at ``path`` is replaced, not followed.

    ``root``: a folder above it, which is created with all below it that are missing; none of these may be a symbolic
    link. Without it, the folder must exist. Raises StoreError.
    """
    with as_store_error(path), _open_folder(path.parent, root) as folder:
        part = f"{path.name[:100]}.{os.urandom(16).hex()}.part"
        file = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _NO_LINK, 0o666, dir_fd=folder)
        try:
            with open(file, "wb") as stream:  # noqa: PTH123 - a descriptor
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(part, path.name, src_dir_fd=folder, dst_dir_fd=folder)
        except BaseException:
            with suppress(OSError):
                os.unlink(part, dir_fd=folder)
            raise
        os.fsync(folder)


def write_text(path: Path, text: str, root: Path | None = None) -> None:
    """As ``write_bytes``, in UTF-8."""
    write_bytes(path, text.encode(), root)


def write_named_file(path: Path, content: bytes | str) -> None:
    """Write a file that the user named, with the folders above it. Raises StoreError where it is no plain file.

    A link is not followed, because it may lead to any file, and a device or a pipe is not replaced.
    """
    with as_store_error(path), suppress(FileNotFoundError):
        if not stat.S_ISREG(path.lstat().st_mode):
            what = "is a link, a device, a pipe or a folder, which is not replaced"
            raise StoreError(str(path), what, "name another file")
    write_bytes(path, content.encode() if isinstance(content, str) else content, path.parent)


def write_texts(folder: Path, texts: Mapping[str, str]) -> None:
    """Write files by name into a folder, which is created. Raises StoreError where that is not possible."""
    for name, text in texts.items():
        write_text(folder / name, text, folder)


@contextmanager
def staging_folder(target: Path, root: Path) -> Iterator[Path]:
    """A path for a library that writes files itself; after the block they replace those of the same name in ``target``.

    The path does not exist yet and ends like ``target``; nothing else in ``target`` is touched. ``root``: as above.
    """
    create_folder(target, root)
    with TemporaryDirectory(dir=root, prefix=".part-") as place:
        inside = Path(place) / target.name
        yield inside
        with as_store_error(target), _open_folder(target, root) as folder:
            for file in sorted(inside.iterdir()):
                os.replace(file, file.name, dst_dir_fd=folder)
            os.fsync(folder)


def create_folder(path: Path, root: Path) -> None:
    """Create a folder and all above it up to ``root``. Raises StoreError, also where one is a symbolic link."""
    with as_store_error(path), _open_folder(path, root):
        pass


@contextmanager
def as_store_error(path: Path) -> Iterator[None]:
    """Turn an OSError in the block into a StoreError that names the path."""
    try:
        yield
    except OSError as error:
        remedy = REMEDY if error.errno in _NO_SPACE else ANOTHER_FOLDER
        raise StoreError(str(path), f"cannot be written ({error.strerror or error})", remedy) from error


@contextmanager
def _open_folder(path: Path, root: Path | None) -> Iterator[int]:
    """The descriptor of a folder; folders from ``root`` on are created, and those below it are not symbolic links."""
    if root is not None:
        if not path.is_relative_to(root):
            raise StoreError(str(path), f"lies outside {root}", "use names without '/'")
        try:
            root.mkdir(parents=True, exist_ok=True)
        except FileExistsError as error:
            raise StoreError(str(root), "cannot be written (a file of this name exists)", ANOTHER_FOLDER) from error
    folder = os.open(root or path, _FOLDER)
    try:
        for name in path.relative_to(root or path).parts:
            if name == "..":
                raise StoreError(str(path), "leads out of its folder", "use names without '..'")
            with suppress(FileExistsError):
                os.mkdir(name, dir_fd=folder)
            try:
                inner = os.open(name, _FOLDER | _NO_LINK, dir_fd=folder)
            except OSError as error:
                if error.errno not in (errno.ELOOP, errno.ENOTDIR):
                    raise
                what = f"'{name}' is a link or a file, not a folder"
                raise StoreError(str(path), what, ANOTHER_FOLDER) from error
            os.close(folder)
            folder = inner
        yield folder
    finally:
        os.close(folder)


def format_json(value: Any, indent: int = 0) -> str:
    """Return JSON text in which containers without inner containers take one line."""
    parts = list(value.values() if isinstance(value, dict) else value) if isinstance(value, dict | list | tuple) else []
    if not any(isinstance(part, dict | list | tuple) for part in parts):
        return json.dumps(value)
    pad, end = " " * (indent + 1), "\n" + " " * indent
    if isinstance(value, dict):
        lines = [f"{pad}{json.dumps(name)}: {format_json(part, indent + 1)}" for name, part in value.items()]
        return "{\n" + ",\n".join(lines) + end + "}"
    return "[\n" + ",\n".join(pad + format_json(part, indent + 1) for part in parts) + end + "]"
