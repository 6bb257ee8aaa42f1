"""Build the recording of Freiburg building 079: all scans of GMapping's log with the exact stamps of flirtlib.

GMapping's log contains all scans, but its stamps are those of the logger, with six digits, and its poses are corrected:
neither the stamps nor the poses are used. flirtlib's graph contains every third scan with its exact ipc stamp, to which
the relations refer. Between two such scans the difference of the two clocks is interpolated.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from evalkit_datasets.recordings.building.log_lines import SourceScan, format_scan, iter_log, source_scan


def build_log(corrected: Path, graph: Path) -> Iterator[str]:
    """Yield the lines of the log, from GMapping's log and flirtlib's graph."""
    scans = [source_scan(reading) for reading in iter_log(corrected)]
    exact = {scan.key: scan.stamp_ns for scan in map(source_scan, iter_log(graph))}
    known = {index: exact[scan.key] for index, scan in enumerate(scans) if scan.key in exact}
    stamps = interpolate_clock([scan.stamp_ns for scan in scans], known)
    yield "# derived: built by evalkit from GMapping's corrected log (scans) and flirtlib's graph (stamps)\n"
    yield f"# {len(known)} of {len(stamps)} stamps are exact, the others interpolated; no poses\n"
    yield "PARAM robot_frontlaser_offset -0.04 0 built 0\n"
    for scan, stamp_ns in zip(scans, stamps, strict=True):
        yield format_scan(SourceScan(stamp_ns, scan.ranges_cm))


def interpolate_clock(local_ns: Sequence[int], known_ns: Mapping[int, int]) -> list[int]:
    """Return stamps (N,) for local times (N,): those known by index, the others with the interpolated difference.

    Integer arithmetic: the same on every machine. Raises ValueError if none is known.
    """
    if not known_ns:
        raise ValueError("known_ns: no scan has a known stamp")
    indices = sorted(known_ns)
    stamps = []
    for index, local in enumerate(local_ns):
        right = bisect(indices, index)
        before, after = indices[max(right - 1, 0)], indices[min(right, len(indices) - 1)]
        shift, next_shift = known_ns[before] - local_ns[before], known_ns[after] - local_ns[after]
        if local_ns[after] > local_ns[before]:
            since, span = local - local_ns[before], local_ns[after] - local_ns[before]
            shift += (next_shift - shift) * min(max(since, 0), span) // span
        stamps.append(local + shift)
    return stamps
