"""The inspection of a log, from its bytes to the suggested command, with stamps of every kind."""

from __future__ import annotations

from pathlib import Path

from bounds import check_file_reader

from evalkit_datasets.commands.inspect.command import inspection_to_json
from evalkit_datasets.commands.inspect.inspector import inspect_recording
from evalkit_datasets.commands.inspect.layout_proposal import propose_layout
from evalkit_datasets.commands.inspect.suggested_config import suggest_config


def seeds() -> list[bytes]:
    """Return logs with usual stamps, and with stamps that collide, decrease, or lie a century apart."""
    beams = " ".join(["2.0"] * 8)
    stamps = ["1.5 2.5 3.5", "0 0 0", "3 2 1", "-208.1 1e9 4.29e9", "1 1.0000001 1.0000002"]
    return [
        "".join(
            f"ROBOTLASER1 0 -1.5 3.0 0.4 30 0.01 0 8 {beams} 0 {k} 0 0.1 {k} 0 0.1 0 0 1 1 0 {stamp} h {stamp}\n"
            f"ODOM {k} 0 0 0 0 0 {stamp} h {stamp}\n"
            for k, stamp in enumerate(row.split())
        ).encode()
        for row in stamps
    ]


def swollen() -> list[bytes]:
    """Return inputs of 100 kB and more whose cost could grow faster than their size."""
    return [b"".join(b"ODOM %d 0 0 0 0 0 %d h 1\n" % (k, k * 500_000) for k in range(9_000)) + seeds()[3]]


def read_input(data: bytes) -> None:
    """Inspect a log."""
    check_file_reader(_read, data, "fuzz.log")


def _read(path: Path) -> None:
    propose_layout(path)
    found = inspect_recording(path)
    inspection_to_json(found, suggest_config(found))
