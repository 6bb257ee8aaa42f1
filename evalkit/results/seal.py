"""Checksums of stored JSON objects and of the files that they vouch for: damage is noticed on reading."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from evalkit.io import untrusted_io

SHA256, FILES = "sha256", "files"
"""Keys of a sealed object: the checksum of all other keys, and the checksums of files by name."""


def seal(content: dict[str, Any], files: dict[str, bytes], *, allow_nan: bool = True) -> str:
    """The JSON text of an object with the checksums of its own values and of files."""
    named = {**content, FILES: {name: hashlib.sha256(raw).hexdigest() for name, raw in files.items()}}
    sealed = {**named, SHA256: _digest(json.loads(json.dumps(named)))}
    return json.dumps(sealed, indent=1, ensure_ascii=False, allow_nan=allow_nan)


def read_sealed(path: Path) -> dict[str, Any]:
    """The object in a file; raises ValueError if it is not exactly what ``seal`` wrote, OSError if it is not there."""
    content = untrusted_io.parse_json(untrusted_io.read_bytes(path))
    if not isinstance(content, dict):
        raise ValueError("holds no JSON object")
    check_seal(content)
    return content


def check_seal(content: dict[str, Any]) -> None:
    """Raise ValueError if the values of an object are not those that were sealed."""
    own = {name: value for name, value in content.items() if name != SHA256}
    if content.get(SHA256) != _digest(own) or not isinstance(content.get(FILES), dict):
        raise ValueError("damaged: its values do not agree with its checksum")


def read_vouched(path: Path, content: Mapping[str, Any]) -> bytes:
    """The bytes of a file that a sealed object vouches for; raises ValueError if they are others."""
    raw = untrusted_io.read_bytes(path)
    if content[FILES].get(path.name) != hashlib.sha256(raw).hexdigest():
        raise ValueError(f"{path.name} is damaged: its content does not agree with its checksum")
    return raw


def _digest(content: object) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
