"""Bound what the bag reader unpacks: a small file cannot take gigabytes, nor hours.

rosbags unpacks every compressed chunk, message or file whole. ``bounded_unpacking`` replaces its decompressors (bz2,
lz4 and zstd) by ones that stop at a limit on the piece, and at a limit on all pieces of a file together. A database,
also one that was compressed, is checked before it is opened.
"""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

from evalkit.core.errors import BadData
from evalkit_datasets.parsing.bag_limits import check_tables, has_write_ahead_log, uri_of

MAX_PIECE_BYTES = 2**28
"""Unpacked size of one chunk or message. Recorders write chunks of 0.75 to 4 MiB."""

FREE_BYTES = 2**29
MAX_RATIO = 200
"""All pieces of a file together: at most ``FREE_BYTES`` plus this many times the size of the file. Scans compress to a
half or a tenth, and the reader unpacks a chunk once for each kind of message."""

_STEP_BYTES = 2**20


class UnpackedTooMuch(ValueError):
    """Raised where compressed data exceed a limit."""


class Budget:
    """The number of bytes that may still be unpacked from one file."""

    def __init__(self, file_bytes: int) -> None:
        self._total = self._left = FREE_BYTES + MAX_RATIO * file_bytes

    def spend(self, count: int) -> None:
        """Count unpacked bytes; raises UnpackedTooMuch beyond the limit of the file."""
        self._left -= count
        if self._left < 0:
            raise UnpackedTooMuch(f"its compressed data unpack to more than {self._total / 2**20:.0f} MiB")


_open: list[Budget] = []
"""Budgets of the files that are open; every unpacked byte counts in each, because rosbags does not say whose it is."""


@contextmanager
def bounded_unpacking(file_bytes: int) -> Iterator[None]:
    """Bound what rosbags unpacks from a file of this size while the context is open.

    The reader raises UnpackedTooMuch at the first piece that exceeds a limit.
    """
    _replace_in_rosbags()
    budget = Budget(file_bytes)
    _open.append(budget)
    try:
        yield
    finally:
        _open.remove(budget)


def unpack(make: Callable[[], Any], data: bytes) -> bytes:
    """Return unpacked data; ``make`` returns a decompressor with the interface of ``bz2.BZ2Decompressor``.

    Raises UnpackedTooMuch beyond a limit, and ValueError for data that are cut short.
    """
    decompressor = make()
    pieces: list[bytes] = []
    size = 0
    while not decompressor.eof:
        piece = decompressor.decompress(b"" if pieces else data, _STEP_BYTES)
        size += len(piece)
        if size > MAX_PIECE_BYTES:
            raise UnpackedTooMuch(f"a compressed piece unpacks to more than {MAX_PIECE_BYTES / 2**20:.0f} MiB")
        _spend(len(piece))
        if not piece and decompressor.needs_input:
            raise ValueError("compressed data are cut short")
        pieces.append(piece)
    return b"".join(pieces)


def _spend(count: int) -> None:
    for budget in _open:
        budget.spend(count)


@cache
def _replace_in_rosbags() -> None:
    """Replace the decompressors and the YAML reader of rosbags, once and for the whole process."""
    import lz4.frame  # noqa: PLC0415 - heavy, and used for bags only
    from rosbags.rosbag1 import reader as ros1  # noqa: PLC0415
    from rosbags.rosbag2 import metadata  # noqa: PLC0415
    from rosbags.rosbag2 import reader as ros2  # noqa: PLC0415
    from rosbags.rosbag2 import storage_mcap as mcap  # noqa: PLC0415
    from rosbags.rosbag2 import storage_sqlite3 as sqlite  # noqa: PLC0415

    from evalkit.io.plain_yaml import make_yaml  # noqa: PLC0415

    for module in (ros2, metadata):
        setattr(module, "YAML", make_yaml)  # noqa: B010 - not declared as an attribute
    zstd: Any = getattr(vars(ros2)["zstd"], "original", vars(ros2)["zstd"])  # not ours, if this module was loaded again
    unpack_lz4 = partial(unpack, lz4.frame.LZ4FrameDecompressor)
    unpack_zstd = partial(unpack, zstd.ZstdDecompressor)
    ros1.decompressors |= {"bz2": partial(unpack, bz2.BZ2Decompressor), "lz4": unpack_lz4}
    mcap.DECOMPRESSORS |= {
        "lz4": lambda data, _: unpack_lz4(data),
        "zstd": lambda data, _: unpack_zstd(data),
    }
    bounded = SimpleNamespace(
        original=zstd, decompress=unpack_zstd, open=lambda file, mode: _CountedFile(zstd.open(file, mode))
    )
    setattr(ros2, "zstd", bounded)  # noqa: B010 - not declared as an attribute
    for kind in vars(sqlite).values():
        if isinstance(kind, type) and "Reader" in kind.__name__ and hasattr(kind, "open"):
            setattr(kind, "open", _check_first(kind.open))  # noqa: B010 - as above


def _check_first(open_base: Callable[[Any], None]) -> Callable[[Any], None]:
    def open_checked(reader: Any) -> None:
        base = Path(reader.path)
        check_tables(base)
        reader.path = Path(f"{uri_of(base)}#")  # rosbags neither quotes a path nor reads a log: '#' ends its own URI
        try:
            open_base(reader)
        except Exception as error:
            if not has_write_ahead_log(base):
                raise
            what = f"its last messages lie in {base.name}-wal, and SQLite cannot read both ({error.__cause__ or error})"
            raise BadData(str(base), "", what, "copy both files to a folder that you can write to") from error
        finally:
            reader.path = base

    return open_checked


class _CountedFile:
    """A compressed file that counts what is read from it."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def __enter__(self) -> _CountedFile:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes; raises UnpackedTooMuch beyond the limit of the file."""
        data = self._file.read(size if 0 <= size <= _STEP_BYTES else _STEP_BYTES)
        _spend(len(data))
        return data
