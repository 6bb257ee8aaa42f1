"""Read JSON and NumPy arrays from a results folder without trusting their content: no code, bounded memory."""

from __future__ import annotations

import json
import math
import os
import re
import stat
import zipfile
import zlib
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

MAX_BYTES = 2**30
"""Uncompressed size of an archive: a map of 14,000 x 14,000 cells."""

_NPY = re.compile(
    rb"\x93NUMPY\x01\x00.."
    rb"\{'descr': '([<>|=]?[?biufcUSV]\d*)', 'fortran_order': (True|False), 'shape': \(([\d, ]{0,80})\), \}[ ]*\n",
    re.DOTALL,
)
"""The header that NumPy writes for arrays of numbers and strings; matched, never evaluated."""


def read_bytes(path: Path, limit: int = MAX_BYTES) -> bytes:
    """Return the content of a regular file; raises ValueError for another kind and for one that is too large.

    A pipe would block and a device never end. A symbolic link is not followed. Raises OSError if it cannot be read.
    """
    file = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOFOLLOW", 0))
    with open(file, "rb") as stream:  # noqa: PTH123 - a descriptor
        state = os.fstat(file)
        if not stat.S_ISREG(state.st_mode) or state.st_size > limit:
            raise ValueError(f"{path.name} is no file, or larger than {limit} bytes")
        return stream.read(state.st_size)  # not the limit: that much would be allocated


def parse_json(text: str | bytes) -> Any:
    r"""Return the value of a JSON text; raises ValueError for invalid JSON and for nesting that is too deep.

    Also for an escape such as \ud800 without its other half, which no file can hold.
    """
    try:
        value = json.loads(text)
        if (b"\\ud" in text.lower()) if isinstance(text, bytes) else ("\\ud" in text.lower()):
            json.dumps(value, ensure_ascii=False).encode()  # UnicodeEncodeError is a ValueError
    except RecursionError:
        raise ValueError("nested too deeply") from None
    return value


def read_arrays(file: Path | BinaryIO) -> dict[str, NDArray[Any]]:
    """Return the arrays of an ``np.savez`` file by name; raises ValueError if it is not one, OSError if unreadable."""
    try:
        with zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            if sum(member.file_size for member in members) > MAX_BYTES:
                raise ValueError(f"holds more than {MAX_BYTES} bytes")
            return {
                member.filename.removesuffix(".npy"): parse_array(_decompress(archive, member)) for member in members
            }
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, OverflowError) as error:
        raise ValueError(f"damaged archive ({error})") from None


def _decompress(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"compression method {member.compress_type} is not supported")
    with archive.open(member) as file:
        return file.read(member.file_size)


def parse_array(content: bytes) -> NDArray[Any]:
    """Return the array of an ``np.save`` file if its header describes exactly the bytes that follow it."""
    header = _NPY.match(content)
    if header is None:
        raise ValueError("not an array of numbers or strings")
    try:
        dtype = np.dtype(header[1].decode("ascii"))
    except TypeError:
        raise ValueError(f"not a data type: {header[1]!r}") from None
    shape = tuple(int(size) for size in header[3].split(b",") if size.strip())
    if dtype.itemsize == 0 or math.prod(shape) * dtype.itemsize != len(content) - header.end():
        raise ValueError(f"{len(content) - header.end()} bytes for an array {shape} of {dtype}")
    values = np.frombuffer(content, dtype, offset=header.end())
    return values.reshape(shape, order="F" if header[2] == b"True" else "C")


def parse_floats(content: bytes, dimensions: int) -> NDArray[np.float64]:
    """As ``parse_array``; raises ValueError too where it holds no 64-bit floats, or has other dimensions."""
    values = parse_array(content)
    if values.dtype != np.float64 or values.ndim != dimensions:
        raise ValueError(f"found {values.dtype} {values.shape}, expected float64 of {dimensions} dimensions")
    return values
