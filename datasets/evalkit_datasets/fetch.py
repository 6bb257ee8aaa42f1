"""Downloads catalogued files into the cache: resumed where it broke off, verified before anybody sees the file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

from evalkit.core.errors import BadData, DataMissing
from evalkit_datasets import catalog
from evalkit_datasets.catalog import CatalogFile

MAX_BYTES = 2**32
"""Of a file whose size the catalogue does not know."""

Progress = Callable[[int, int], None]
"""Hears the bytes so far and the bytes in all (0: not known)."""


def _silent(_so_far: int, _in_all: int) -> None:
    return None


def fetch(name: str, progress: Progress = _silent) -> Path:
    """Where the verified file is; downloaded into the cache unless it is already on this machine.

    DataMissing where it has no public address or the connection fails (what arrived stays for the next try), BadData
    where what arrived is not the catalogued file (it is deleted).
    """
    card = catalog.entry(name)
    target = catalog.cache_folder() / card.path
    present = catalog.found(card)
    if present is not None and not (present == target and _damaged(card, present)):
        catalog.verify(card, present)
        return present
    if not card.url:
        raise DataMissing(name, f"it has no public address ({card.derived})", catalog.without_address(card))
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(target.name + ".part")
    _download(card, part, progress)
    _accept(card, part)
    part.replace(target)
    return target


def _damaged(card: CatalogFile, path: Path) -> bool:
    try:
        catalog.verify(card, path)
    except BadData:
        return True
    return False


def _accept(card: CatalogFile, part: Path) -> None:
    """Deletes what is not the catalogued file and says so."""
    try:
        catalog.verify(card, part)
    except BadData as error:
        part.unlink()
        _, _, what, _ = error.args
        raise BadData(
            card.url, "", f"what arrived is not the catalogued file ({what}) and was deleted", "fetch it again"
        ) from None


def _download(card: CatalogFile, part: Path, progress: Progress) -> None:
    """Fills the part file up to the whole; a server that knows no ranges sends all of it again."""
    begun = part.stat().st_size if part.is_file() else 0
    if card.bytes and begun >= card.bytes:
        return
    try:
        with part.open("ab") as file:
            _request(card, file, begun, progress)
    except _TooMuch:
        part.unlink()
        what = f"sends more than the {card.bytes or MAX_BYTES} bytes the file may have; what arrived was deleted"
        raise BadData(card.url, "", what, "fetch it again later, or from somebody else") from None
    except OSError as error:  # requests' errors are OSErrors, too
        status = getattr(getattr(error, "response", None), "status_code", None)
        if begun and status == 416:  # nothing beyond: the part is whole, or not a part of this file
            return
        kept = part.stat().st_size
        raise DataMissing(
            card.name,
            f"{card.url} could not be downloaded ({' '.join(str(error).split())[:160]})",
            f"check the connection and fetch it again; {kept} bytes are kept" if kept else "check the connection",
        ) from error


def _request(card: CatalogFile, file: BinaryIO, begun: int, progress: Progress) -> None:
    import pooch  # noqa: PLC0415 - heavy, and only downloads need it

    sink = _Counted(file, card.bytes, progress)
    # identity: a range of a compressed answer could not be appended
    headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={begun}-"} if begun else {})
    hooks = {"response": sink.begins}
    pooch.HTTPDownloader(progressbar=False, chunk_size=1 << 16, headers=headers, hooks=hooks)(card.url, sink, None)


class _TooMuch(Exception):
    """A server sends more than the file has."""


class _Counted:
    """A file that reports how far it is, and starts over where the server sends the whole instead of the rest."""

    def __init__(self, file: BinaryIO, in_all: int, progress: Progress) -> None:
        self._file, self._in_all, self._progress = file, in_all, progress

    def begins(self, response: Any, **_: object) -> None:
        """Hears the server's answer before the content comes."""
        if response.status_code == 200:
            self._file.truncate(0)

    def write(self, chunk: bytes) -> int:
        """Appends and reports; _TooMuch before the disk is filled."""
        if self._file.tell() + len(chunk) > (self._in_all or MAX_BYTES):
            raise _TooMuch
        written = self._file.write(chunk)
        self._progress(self._file.tell(), self._in_all)
        return written

    def flush(self) -> None:
        """Hands everything to the operating system."""
        self._file.flush()
