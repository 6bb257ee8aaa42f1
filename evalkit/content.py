"""A file a user names, read whole, or an error that says what to do."""

from __future__ import annotations

from pathlib import Path

from evalkit.errors import BadData, DataMissing


def bytes_of(path: Path, what: str) -> bytes:
    """The whole file; DataMissing where there is none, BadData where it is empty or cannot be read."""
    if not path.is_file():
        found = "it is a folder" if path.is_dir() else "no such file"
        raise DataMissing(str(path), found, f"give the path of {what}")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadData(str(path), "", f"cannot be read ({error.strerror})", "check its permissions") from error
    if not content:
        raise BadData(str(path), "", "the file is empty", f"give {what}")
    return content
