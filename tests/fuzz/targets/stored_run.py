"""The folder of a run: JSON, records and arrays from another version or an unknown source."""

from __future__ import annotations

import io
import zipfile
from contextlib import suppress

import numpy as np
from bounds import check_call, folder

from evalkit.core.run_result import STEP
from evalkit.io import untrusted_io
from evalkit.results.seal import seal
from evalkit.results.store import RESULT, SCORES, STEPS, Store

FILES = (RESULT, STEPS, SCORES, "grid.npz", "errors.npy")
"""The files; the first byte of an input selects the one it replaces, the others are valid."""


def _sound() -> dict[str, bytes]:
    run = {"status": "complete", "cause": "completed", "reason": "", "expected": 2, "peak_memory_bytes": 0,
           "warm_up_scans": 0, "notes": {}, "every": 1, "provenance": {}, "conditions": None,
           "answered": 2}  # fmt: skip
    steps = np.zeros(2, dtype=STEP)
    steps["stamp_ns"] = [0, 1]
    scores = {"scores": {"ate": {"value": 1.0, "support": 2, "reason": ""}}, "world_from_start": [0, 0, 0],
              "alignment": "", "lost_at_s": None, "lost_reason": "", "recovered_at_s": None}  # fmt: skip
    grid, errors = io.BytesIO(), io.BytesIO()
    cells = np.zeros((3, 2), dtype=np.float32)
    np.savez_compressed(grid, log_odds=cells, observed=cells > 0, frame=[0.05, 0.0, 0.0])
    np.save(errors, np.zeros(2))
    raw = {STEPS: steps.tobytes(), "grid.npz": grid.getvalue(), "errors.npy": errors.getvalue()}
    texts = {RESULT: run, SCORES: scores}
    return {name: _seal(texts[name], raw) if name in texts else raw[name] for name in FILES}


def _seal(content: dict[str, object], files: dict[str, bytes]) -> bytes:
    return seal(content, files).encode()


def seeds() -> list[bytes]:
    """Return valid files."""
    return [bytes([number]) + content for number, content in enumerate(_sound().values())]


def _npy(header: str) -> bytes:
    text = header.encode() + b" " * 20 + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


def swollen() -> list[bytes]:
    """Return arrays with too large shapes, pickled objects, archives of gigabytes, and deep nesting."""
    huge = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"
    objects = "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }"
    zipped = []
    for content in (_npy(huge), _npy(objects) + b"\x80\x04N.", b"\0" * 30_000_000):
        body = io.BytesIO()
        with zipfile.ZipFile(body, "w", zipfile.ZIP_DEFLATED) as file:
            for name in ("log_odds", "observed", "frame"):
                file.writestr(f"{name}.npy", content)
        zipped.append(b"\x03" + body.getvalue())
    return [
        *zipped,
        b"\x04" + _npy(huge),
        b"\x04" + _npy(objects) + b"\x80\x04N.",
        b"\x04" + _npy("{" * 5_000),
        *(bytes([number]) + b"[" * 100_000 for number in (0, 2)),
        *(bytes([number]) + b'{"a":' * 100_000 for number in (0, 2)),
        b"\x00" + b"9" * 100_000,
        b'\x02{"scores": {"a": {"value": 1e999}}, "world_from_start": [NaN, 0, 0]}',
        b'\x02{"scores": {}, "world_from_start": [1' + b"0" * 400 + b", 0, 0]}",
        b'\x02{"scores": [], "world_from_start": [0, 0, 0]}',
        b"\x02[]",
        b"\x00[]",
        b'\x00{"steps": 1}',
    ]


def read_input(data: bytes) -> None:
    """Load a run and its scores; damaged ones count as absent. Half of the inputs get matching checksums."""
    place = folder() / "runs" / "key"
    place.mkdir(parents=True, exist_ok=True)
    name = FILES[data[0] % len(FILES)] if data else FILES[0]
    files = {**_sound(), name: data[1:]}
    if len(data) % 2:
        for sealed in (RESULT, SCORES):
            with suppress(ValueError):
                content = untrusted_io.parse_json(files[sealed])
                if isinstance(content, dict):
                    files[sealed] = _seal(content, {one: files[one] for one in FILES if one not in (RESULT, SCORES)})
    for one, content in files.items():
        (place / one).write_bytes(content)
    untrusted_io.MAX_BYTES = 2**24  # the memory of a valid archive of that size is not a finding
    store = Store.existing(folder())
    check_call(lambda: (store.load_result("key"), store.load_scores("key")), len(data), "")
