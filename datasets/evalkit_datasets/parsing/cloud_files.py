"""Read the points of a PCD or PLY file: text or binary, PCD also compressed. Only x, y and z are kept."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.core.errors import BadData
from evalkit.core.se2 import Floats
from evalkit.io.input_files import read_bytes
from evalkit.io.timestamps import MAX_NS
from evalkit_datasets.parsing.cloud_slice import read_packed_points

SUFFIXES = (".pcd", ".ply")
MAX_FILE_BYTES = 2**28
MAX_HEADER_BYTES = 2**16
EXPECTED = "a point cloud (.pcd or .ply) with fields x, y, z of 32 or 64 bits"
REMEDY = f"write {EXPECTED}"

PCD_KINDS = {("F", "4"): "f4", ("F", "8"): "f8", ("U", "1"): "u1", ("U", "2"): "u2", ("U", "4"): "u4", ("U", "8"): "u8",
             ("I", "1"): "i1", ("I", "2"): "i2", ("I", "4"): "i4", ("I", "8"): "i8"}  # fmt: skip
PLY_KINDS = {"float": "f4", "float32": "f4", "double": "f8", "float64": "f8", "char": "i1", "int8": "i1", "uchar": "u1",
             "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4",
             "uint": "u4", "uint32": "u4"}  # fmt: skip


def read_cloud_file(path: Path) -> Floats:
    """Return the points (N, 3) of a file in m; may hold nan. Raises BadData or DataMissing."""
    if path.is_file() and path.stat().st_size > MAX_FILE_BYTES:
        raise BadData(str(path), "", f"more than {MAX_FILE_BYTES / 2**20:.0f} MiB for one cloud", REMEDY)
    content = read_bytes(path, EXPECTED)
    try:
        points = _read_pcd(content) if path.suffix.lower() == ".pcd" else _read_ply(content)
    except (ValueError, IndexError, OverflowError) as error:
        raise BadData(str(path), "", f"not a readable point cloud ({str(error)[:160]})", REMEDY) from None
    return points


def _read_pcd(content: bytes) -> Floats:
    """Read a PCD file of version 0.7 (Point Cloud Library)."""
    match = re.search(rb"^DATA (\w+)\r?\n", content[:MAX_HEADER_BYTES], re.MULTILINE)
    if match is None:
        raise ValueError("no line 'DATA ascii', 'DATA binary' or 'DATA binary_compressed'")
    lines = [line.split() for line in content[: match.start()].decode("latin-1").splitlines()]
    header = {words[0]: words[1:] for words in lines if words and not words[0].startswith("#")}
    missing = [key for key in ("FIELDS", "SIZE", "TYPE", "POINTS") if not header.get(key)]
    if missing:
        raise ValueError(f"no {missing[0]} in its header")
    names, sizes = header["FIELDS"], header["SIZE"]
    counts = [_whole(word) for word in header.get("COUNT", ["1"] * len(names))]
    if not len(names) == len(sizes) == len(header["TYPE"]) == len(counts):
        raise ValueError("FIELDS, SIZE, TYPE and COUNT of different lengths")
    kinds = [PCD_KINDS.get(each, "") for each in zip(header["TYPE"], sizes, strict=True)]
    points, body, form = _whole(header["POINTS"][0]), content[match.end() :], match[1].decode()
    if form == "ascii":
        starts = np.concatenate([[0], np.cumsum(counts)])
        return _read_table(body, [int(starts[names.index(axis)]) for axis in "xyz"], points)
    widths = [_whole(size) * count for size, count in zip(sizes, counts, strict=True)]
    if form == "binary":
        return _read_rows(body, names, kinds, widths, points)
    packed, unpacked = (int(value) for value in np.frombuffer(body[:8], "<u4"))
    if unpacked != points * sum(widths) or unpacked > MAX_FILE_BYTES:
        raise ValueError(f"{unpacked} bytes for {points} points of {sum(widths)} bytes")
    data = unpack_lzf(body[8 : 8 + packed], unpacked)  # one field after the other
    begins = np.concatenate([[0], np.cumsum(widths)]) * points
    columns = [np.frombuffer(data, f"<{_float_kind(kinds, names, axis)}", points, int(begins[names.index(axis)]))
               for axis in "xyz"]  # fmt: skip
    return np.stack([column.astype(np.float64) for column in columns], axis=-1)


def _read_ply(content: bytes) -> Floats:
    """Read the vertices of a PLY file (Turk 1994); they must be its first element."""
    match = re.search(rb"end_header\r?\n", content[:MAX_HEADER_BYTES])
    if match is None or not content.startswith(b"ply"):
        raise ValueError("no header from 'ply' to 'end_header'")
    lines = [line.split() for line in content[: match.start()].decode("latin-1").splitlines()]
    form = [words[1] for words in lines if words[:1] == ["format"]][0]  # noqa: RUF015 - an IndexError becomes a message
    elements = [at for at, words in enumerate(lines) if words[:1] == ["element"]]
    if not elements or lines[elements[0]][1] != "vertex":
        raise ValueError("its first element is not 'vertex'")
    end = elements[1] if len(elements) > 1 else len(lines)
    properties = [words for words in lines[elements[0] + 1 : end] if words[:1] == ["property"]]
    if any(words[1] == "list" for words in properties):
        raise ValueError("a list in its vertices")
    points, names = _whole(lines[elements[0]][2]), [words[2] for words in properties]
    kinds = [PLY_KINDS.get(words[1], "") for words in properties]
    body = content[match.end() :]
    if form == "ascii":
        return _read_table(body, [names.index(axis) for axis in "xyz"], points)
    if form not in ("binary_little_endian", "binary_big_endian") or "" in kinds:
        raise ValueError(f"format '{form}', or a type of a property, is unknown")
    return _read_rows(body, names, kinds, [int(kind[1:]) for kind in kinds], points, form == "binary_big_endian")


def _read_table(body: bytes, columns: Sequence[int], points: int) -> Floats:
    rows = [line.split() for line in body.splitlines()[:points] if line.strip()]
    if len(rows) < points:
        raise ValueError(f"{len(rows)} of {points} points")
    return np.array([[row[column] for column in columns] for row in rows], dtype=np.float64).reshape(-1, 3)


def _read_rows(
    body: bytes, names: Sequence[str], kinds: Sequence[str], widths: Sequence[int], points: int, big: bool = False
) -> Floats:
    offsets = np.concatenate([[0], np.cumsum(widths)]).tolist()
    if points == 0:
        return np.zeros((0, 3))
    fields = {name: (kind, at) for name, kind, at in zip(names, kinds, offsets, strict=False)}
    found = read_packed_points(np.frombuffer(body, np.uint8), fields, (1, points, 0, offsets[-1]), big)
    if found is None:
        raise ValueError(f"{len(body)} bytes for {points} points of {offsets[-1]} bytes, or x, y, z are no floats")
    return found


def unpack_lzf(data: bytes, size: int) -> bytes:
    """Return data compressed by LibLZF. Raises ValueError if they do not unpack to ``size`` bytes."""
    packed, out, at = memoryview(data), bytearray(), 0
    while at < len(packed) and len(out) <= size:
        control = packed[at]
        at += 1
        if control < 32:  # the next control + 1 bytes as they are
            out += packed[at : at + control + 1]
            at += control + 1
            continue
        length = control >> 5
        if length == 7:
            length += packed[at]
            at += 1
        begin = len(out) - ((control & 31) << 8) - packed[at] - 1
        at += 1
        if begin < 0:
            raise ValueError("compressed data refer to what lies before their beginning")
        for place in range(begin, begin + length + 2):  # the copy may overlap what it writes
            out.append(out[place])
    if len(out) != size:
        raise ValueError(f"compressed data unpack to {len(out)} of {size} bytes")
    return bytes(out)


def _float_kind(kinds: Sequence[str], names: Sequence[str], axis: str) -> str:
    kind = kinds[names.index(axis)]
    if kind not in ("f4", "f8"):
        raise ValueError(f"field {axis} is no float")
    return kind


def _whole(word: str) -> int:
    value = int(word)
    if not 0 <= value <= MAX_FILE_BYTES:
        raise ValueError(f"a number of {word[:20]}")
    return value


def stamps_of(names: Sequence[str], period_ns: int) -> NDArray[np.int64]:
    """Return the times (N,) in ns of files, from the numbers in their names: of seconds, ms, us or ns, or counts.

    Names are taken as times if all contain a number of at least ten digits, or with decimals. The unit is the one in
    which they are 5 ms to 5 s apart; of a single file, the one of the magnitude of a present-day time. Otherwise, and
    where the numbers are too large for times, such as dates (20240131120000), the files are ``period_ns`` apart in the
    given order.
    """
    counted = np.arange(len(names), dtype=np.int64) * period_ns
    found = [re.findall(r"\d+(?:[._]\d+)?", name.rpartition(".")[0]) or [""] for name in names]
    numbers = [each[-1].replace("_", ".") for each in found]
    if not all(len(text.partition(".")[0]) >= len("1000000000") or "." in text for text in numbers):
        return counted
    step = float(np.median(np.diff([float(text) for text in numbers]))) if len(names) > 1 else 0.0
    digits = len(numbers[0].partition(".")[0])
    usual = next((power for limit, power in ((11, 9), (14, 6), (17, 3)) if digits < limit), 0)
    power = next((power for power in (9, 6, 3, 0) if 5e6 <= step * 10**power <= 5e9), usual)
    stamps = [_scale_decimal(text, power) for text in numbers]
    return counted if max(stamps, default=0) > MAX_NS else np.array(stamps, dtype=np.int64)


def _scale_decimal(text: str, power: int) -> int:
    whole, _, rest = text.partition(".")
    return int(whole + rest[:power].ljust(power, "0"))
