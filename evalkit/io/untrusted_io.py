"""JSON and arrays that an earlier run, another version or anybody has left in a folder, read without trust in them."""

from __future__ import annotations

import json
import math
import re
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_BYTES = 2**30
"""Of what an archive may hold when it is unpacked: a map of 14 000 x 14 000 cells."""

_NPY = re.compile(
    rb"\x93NUMPY\x01\x00.."
    rb"\{'descr': '([<>|=]?[?biufcUSV]\d*)', 'fortran_order': (True|False), 'shape': \(([\d, ]{0,80})\), \}[ ]*\n",
    re.DOTALL,
)
"""The header as NumPy writes it: of plain numbers and texts, and never evaluated."""


def values(text: str | bytes) -> Any:
    """What JSON says; ValueError where it is none, and where it nests without end."""
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def array(path: Path) -> NDArray[Any]:
    """The array of a file of ``np.save``; ValueError where it is none, OSError where there is none."""
    return _array(path.read_bytes())


def arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a file of ``np.savez``; ValueError where it is none, OSError where there is none."""
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if sum(member.file_size for member in members) > MAX_BYTES:
                raise ValueError(f"holds more than {MAX_BYTES} bytes")
            return {member.filename.removesuffix(".npy"): _array(_unpacked(archive, member)) for member in members}
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, OverflowError) as error:
        raise ValueError(f"damaged archive ({error})") from None


def _unpacked(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"packed in way {member.compress_type}")
    with archive.open(member) as file:
        return file.read(member.file_size)


def _array(content: bytes) -> NDArray[Any]:
    """The array whose header claims exactly what follows it."""
    header = _NPY.match(content)
    if header is None:
        raise ValueError("no array of numbers or texts")
    try:
        kind = np.dtype(header[1].decode("ascii"))
    except TypeError:
        raise ValueError(f"no kind of array: {header[1]!r}") from None
    shape = tuple(int(size) for size in header[3].split(b",") if size.strip())
    if kind.itemsize == 0 or math.prod(shape) * kind.itemsize != len(content) - header.end():
        raise ValueError(f"{len(content) - header.end()} bytes for an array {shape} of {kind}")
    found = np.frombuffer(content, kind, offset=header.end())
    return found.reshape(shape, order="F" if header[2] == b"True" else "C")
