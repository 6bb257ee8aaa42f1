"""The reader of point clouds: PCD, or PLY for inputs that begin with "ply"."""

from __future__ import annotations

import struct
from pathlib import Path

from bounds import check_file_reader

from evalkit_datasets.parsing.cloud_files import read_cloud_file

PCD = b"VERSION 0.7\nFIELDS x y z i\nSIZE 4 4 8 1\nTYPE F F F U\nCOUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA "
PLY = b"element vertex 2\nproperty float x\nproperty float y\nproperty double z\nproperty uchar i\nend_header\n"
POINTS = b"".join(struct.pack("<ffdB", 1.0, 2.0, 0.0, 7) for _ in range(2))


def seeds() -> list[bytes]:
    """Return a cloud in every form."""
    columns = struct.pack("<4f2d2B", 1.0, 1.0, 2.0, 2.0, 0.0, 0.0, 7, 7)
    packed = b"".join(bytes([len(part) - 1]) + part for part in (columns[:32], columns[32:]))
    return [
        PCD + b"ascii\n1 2 0 7\n1 2 0 7\n",
        PCD + b"binary\n" + POINTS,
        PCD + b"binary_compressed\n" + struct.pack("<II", len(packed), len(columns)) + packed,
        b"ply\nformat ascii 1.0\n" + PLY + b"1 2 0 7\n1 2 0 7\n",
        b"ply\nformat binary_little_endian 1.0\n" + PLY + POINTS,
    ]


def swollen() -> list[bytes]:
    """Return clouds that claim more than they hold, and compressed data that repeat themselves."""
    lie = PCD.replace(b"POINTS 2", b"POINTS 200000000")
    again = b"\x00A" + b"\xe0\xff\x00" * 300_000
    return [
        lie + b"binary\n" + POINTS,
        lie + b"binary_compressed\n" + struct.pack("<II", len(again), 200_000_000 * 17) + again,
        PCD + b"binary_compressed\n" + struct.pack("<II", len(again), 34) + again,
        PCD.replace(b"COUNT 1", b"COUNT 99999999") + b"binary\n" + POINTS,
        PCD + b"ascii\n" + b"1 2 0 7\n" * 20_000,
        b"ply\nformat ascii 1.0\n" + b"property float x\n" * 5_000 + PLY,
    ]


def read_input(data: bytes) -> None:
    """Read a cloud."""
    check_file_reader(_read, data, "fuzz.ply" if data.startswith(b"ply") else "fuzz.pcd")


def _read(path: Path) -> None:
    read_cloud_file(path)
