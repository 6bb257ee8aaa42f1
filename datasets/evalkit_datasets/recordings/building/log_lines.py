"""What the builders share: scans of a source as whole centimetres, and lines of the CARMEN log to write."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evalkit.core.errors import BadData
from evalkit.core.se2 import Floats
from evalkit.io.timestamps import format_stamp
from evalkit_datasets.parsing.carmen_parser import Log, Reading, iter_readings

Centimetres = NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class SourceScan:
    """A scan of a source: its time and its ranges (B,) in cm, the resolution of the recording."""

    stamp_ns: int
    ranges_cm: Centimetres

    @property
    def key(self) -> bytes:
        """The ranges as bytes: the same scan has the same ranges in all sources."""
        return self.ranges_cm.tobytes()


def centimetres(ranges_m: Floats) -> Centimetres:
    """Return ranges in whole centimetres."""
    return np.asarray(np.round(np.asarray(ranges_m) * 100.0), dtype=np.int32)


def iter_log(path: Path) -> Iterator[Reading]:
    """Yield the scans of a CARMEN log or a graph; raises BadData, with the line, if a line is damaged."""
    log = Log()
    for _, reading in iter_readings(path, log):
        yield reading
    if log.damaged:
        line, what = log.damage
        raise BadData(str(path), f"line {line}", what, "fetch the source again")


def source_scan(reading: Reading) -> SourceScan:
    """Return a scan of a log with its ranges in cm."""
    return SourceScan(reading.stamp_ns, centimetres(reading.ranges))


def format_scan(scan: SourceScan) -> str:
    """Return the FLASER line of a scan; the poses in it are zero, because the sources contain corrected ones."""
    ranges = " ".join(f"{cm // 100}.{cm % 100:02d}" for cm in scan.ranges_cm.tolist())
    stamp = format_stamp(scan.stamp_ns)[:-3]  # microseconds
    return f"FLASER {len(scan.ranges_cm)} {ranges} 0 0 0 0 0 0 {stamp} built {stamp}\n"
