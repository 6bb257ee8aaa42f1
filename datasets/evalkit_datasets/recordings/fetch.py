"""Download or build catalogued files into the cache; downloads resume, and content is verified before use."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import urlsplit

from evalkit.core.errors import BadData, DataMissing
from evalkit_datasets.recordings import catalog
from evalkit_datasets.recordings.catalog import CatalogFile

MAX_BYTES = 2**32
"""Limit for a file of unknown size."""

OFFLINE = "EVALKIT_OFFLINE"
"""Environment variable that keeps evalkit from the network."""

ANSWER_S = 5.0
"""A server that does not answer within this time is not waited for."""

ReportProgress = Callable[[int, int], None]
"""Called with the bytes received and the total (0: unknown)."""


def _ignore_progress(_received: int, _total: int) -> None:
    return None


def fetch(name: str, progress: ReportProgress = _ignore_progress) -> Path:
    """Return the path of the verified file, downloaded or built into the cache unless it is on this machine already.

    Raises DataMissing if it has no public URL or the connection fails (the received part is kept for the next call),
    and BadData if the received content is not the catalogued file (it is deleted).
    """
    card = catalog.get_file(name)
    target = catalog.cache_folder() / card.path
    present = catalog.find_local(card)
    if present is not None and not (present == target and _is_damaged(card, present)):
        catalog.verify(card, present)
        return present
    if card.build:
        return _build(card, target, progress)
    if not card.url:
        raise DataMissing(name, f"it has no public URL ({card.derived})", catalog.suggest_replacement(card))
    if os.environ.get(OFFLINE, "0") not in {"", "0"}:
        raise DataMissing(name, f"not on this machine, and {OFFLINE} is set", f"unset {OFFLINE}")
    _create_folder(card, target.parent)
    part = target.with_name(target.name + ".part")
    _download(card, part, progress)
    _verify_or_delete(card, part)
    part.replace(target)
    return target


def why_offline(url: str) -> str:
    """Return why nothing can be downloaded, "" if the server answers within ``ANSWER_S``."""
    if os.environ.get(OFFLINE, "0") not in {"", "0"}:
        return f"offline ({OFFLINE} is set)"
    answers: list[int] = []
    thread = threading.Thread(target=_ask, args=(url, answers), daemon=True)
    thread.start()
    thread.join(ANSWER_S)
    return "" if answers else f"no answer from {urlsplit(url).hostname} within {ANSWER_S:g} s"


def _ask(url: str, answers: list[int]) -> None:
    import requests  # noqa: PLC0415 - heavy, and used for downloads only

    with contextlib.suppress(requests.RequestException):
        answers.append(requests.head(url, timeout=ANSWER_S).status_code)


def list_downloads(names: Iterable[str]) -> list[CatalogFile]:
    """Return the files to download for files of the catalogue: those absent, and the absent sources of others."""
    absent = [card for card in map(catalog.get_file, dict.fromkeys(names)) if catalog.find_local(card) is None]
    found = {card.name: card for card in absent if card.url}
    for card in absent:
        found |= {source.name: source for source in list_downloads(card.sources)}
    return list(found.values())


def _create_folder(card: CatalogFile, folder: Path) -> None:
    """Create a folder of the cache. Raises DataMissing where that is not possible, as with a home that is read-only."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        what = f"cannot be kept in {folder} ({error.strerror})"
        raise DataMissing(card.name, what, "set XDG_CACHE_HOME to a folder that can be written") from error


def _build(card: CatalogFile, target: Path, progress: ReportProgress) -> Path:
    """Build a file from its sources, fetched first; raises BadData if the result is not the catalogued file."""
    from evalkit_datasets.recordings.building.builders import iter_built  # noqa: PLC0415 - used for building only

    sources = [fetch(source, progress) for source in card.sources]
    _create_folder(card, target.parent)
    part = target.with_name(f"{target.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            for block in iter_built(card.build, sources):
                file.write(block)
                if file.tell() > card.bytes:
                    raise BadData(str(part), "", f"more than {card.bytes} bytes", "report it with the sources' names")
        catalog.verify(card, part)
        part.replace(target)
    except BadData as error:
        if error.args[0] != str(part):
            raise
        what = f"the file built from {', '.join(card.sources)} differs from the catalogued one ({error.args[2]})"
        raise BadData(card.name, "", what, "report it with the versions of Python and NumPy") from None
    finally:
        part.unlink(missing_ok=True)
    return target


def _is_damaged(card: CatalogFile, path: Path) -> bool:
    try:
        catalog.verify(card, path)
    except BadData:
        return True
    return False


def _verify_or_delete(card: CatalogFile, part: Path) -> None:
    """Raise BadData and delete the download if it is not the catalogued file."""
    try:
        catalog.verify(card, part)
    except BadData as error:
        part.unlink()
        _, _, found, _ = error.args
        raise BadData(
            card.url, "", f"the download is not the catalogued file ({found}) and was deleted", "fetch it again"
        ) from None


def _download(card: CatalogFile, part: Path, progress: ReportProgress) -> None:
    """Complete the partial file; a server without range requests sends the whole file again."""
    received = part.stat().st_size if part.is_file() else 0
    if card.bytes and received >= card.bytes:
        return
    try:
        with part.open("ab") as file:
            _request(card, file, received, progress)
    except _TooLarge:
        part.unlink()
        found = f"the server sends more than {card.bytes or MAX_BYTES} bytes; the download was deleted"
        raise BadData(card.url, "", found, "fetch it again later, or get it from another source") from None
    except OSError as error:  # includes the errors of requests
        status = getattr(getattr(error, "response", None), "status_code", None)
        if received and status == 416:  # no bytes left: the part is complete, or belongs to another file
            return
        kept = part.stat().st_size
        raise DataMissing(
            card.name,
            f"{card.url} could not be downloaded ({' '.join(str(error).split())[:160]})",
            f"check the connection and fetch it again; {kept} bytes are kept" if kept else "check the connection",
        ) from error


def _request(card: CatalogFile, file: BinaryIO, received: int, progress: ReportProgress) -> None:
    import pooch  # noqa: PLC0415 - heavy, and used for downloads only

    sink = _ProgressFile(file, card.bytes, progress)
    # identity: a range of a compressed response could not be appended
    headers = {"Accept-Encoding": "identity"} | ({"Range": f"bytes={received}-"} if received else {})
    hooks = {"response": sink.handle_response}
    pooch.HTTPDownloader(progressbar=False, chunk_size=1 << 16, headers=headers, hooks=hooks)(card.url, sink, None)


class _TooLarge(Exception):
    """The server sends more bytes than the file has."""


class _ProgressFile:
    """A file that reports progress, and starts over if the server sends the whole file instead of the rest."""

    def __init__(self, file: BinaryIO, total: int, progress: ReportProgress) -> None:
        self._file, self._total, self._progress = file, total, progress

    def handle_response(self, response: Any, **_: object) -> None:
        """Truncate the file if the response contains the whole content."""
        if response.status_code == 200:
            self._file.truncate(0)

    def write(self, chunk: bytes) -> int:
        """Append a block and report progress; raises _TooLarge beyond the size limit."""
        if self._file.tell() + len(chunk) > (self._total or MAX_BYTES):
            raise _TooLarge
        written = self._file.write(chunk)
        self._progress(self._file.tell(), self._total)
        return written

    def flush(self) -> None:
        """Flush the file."""
        self._file.flush()
