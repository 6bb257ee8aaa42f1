"""Decode the scans and odometry increments of an MRPT rawlog of 2008 that alternates frames and actions.

A record is a CSensoryFrame with one CObservation2DRangeScan (version 6), then a CActionCollection with one
CActionRobotMovement2D (version 6), as MRPT serialises them: the name of a class with its length and version, the
values in little endian, and a mark at the end. With the same number of beams, all records have the same layout, which
is checked by the names, versions, numbers of beams and marks at their places.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.core.errors import BadData
from evalkit.core.se2 import Floats
from evalkit.io.text_lines import iter_plain_blocks

BEAMS = 180
MAX_RECORDS = 100_000

_SCAN_AT = 214
_MARKS = (
    (0, b"\x8dCSensoryFrame\x02\x01\x00\x00\x00\x97CObservation2DRangeScan\x06"),
    (208, b"\x88\x88" + BEAMS.to_bytes(4, "little")),
    (1142, b"\x88\x88\x91CActionCollection\x00\x01\x00\x00\x00\x96CActionRobotMovement2D\x06"),
    (1195, b"\x87CPose2D\x01"),
    (1311, b"\x88\x88"),
)
_RECORD = np.dtype(
    {"names": ["ranges", "motion"], "formats": [("<f4", BEAMS), ("<f8", 3)], "offsets": [_SCAN_AT, 1204],
     "itemsize": 1313}
)  # fmt: skip


def read_rawlog(path: Path) -> tuple[Floats, Floats]:
    """Return the ranges (N, 180) in m and the odometry increments (N, 3) that follow each scan, in file order.

    Raises BadData, with the record, if the file is something else. Memory is bounded by ``MAX_RECORDS``.
    """
    content = bytearray()
    for block in iter_plain_blocks(path, "an MRPT rawlog"):
        content += block
        if len(content) > MAX_RECORDS * _RECORD.itemsize:
            raise BadData(str(path), "", f"more than {MAX_RECORDS} records", "give the catalogued rawlog")
    count, rest = divmod(len(content), _RECORD.itemsize)
    if rest:
        raise BadData(str(path), f"record {count + 1}", f"cut short after {rest} bytes", "fetch the rawlog again")
    rows: NDArray[np.uint8] = np.frombuffer(bytes(content), dtype=np.uint8).reshape(count, _RECORD.itemsize)
    for at, mark in _MARKS:
        wrong = np.flatnonzero((rows[:, at : at + len(mark)] != np.frombuffer(mark, dtype=np.uint8)).any(axis=1))
        if len(wrong):
            what = f"expected {mark!r} at byte {at} of the record"
            raise BadData(str(path), f"record {wrong[0] + 1}", what, "give the catalogued rawlog")
    records = np.frombuffer(bytes(content), dtype=_RECORD)
    ranges, motions = records["ranges"].astype(np.float64), records["motion"].astype(np.float64)
    if not (np.isfinite(ranges).all() and np.isfinite(motions).all()):
        raise BadData(str(path), "", "a value is not finite", "fetch the rawlog again")
    return ranges, motions
