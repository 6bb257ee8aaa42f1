"""The folder of a run: JSON, records and arrays from another version or an unknown source."""

from __future__ import annotations

import io
import tempfile
import zipfile
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np
from bounds import check_call, folder

from evalkit.config.experiment import Method, RunSpec, SequenceSpec
from evalkit.core.grid import OccupancyGrid
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.path_correction import PathCorrection
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, RunResult, Score, Scores
from evalkit.core.trajectory import Trajectory
from evalkit.io import untrusted_io
from evalkit.results.final_files import CLOSURES, FINAL, PATHS
from evalkit.results.seal import seal
from evalkit.results.store import RESULT, SCORES, STEPS, Store

FILES = (RESULT, STEPS, SCORES, "grid.npz", "errors.npy", FINAL, CLOSURES, PATHS)
"""The files; the first byte of an input selects the one it replaces, the others are valid."""


@cache
def _sound() -> dict[str, bytes]:
    """Return the files of a run of a SLAM as they are stored, which load."""
    steps = np.zeros(2, dtype=STEP)
    steps["stamp_ns"] = [0, 1]
    final, loop = (
        Trajectory(steps["stamp_ns"], np.zeros((2, 3)), "start", "base"),
        LoopClosure(1, 0, Pose(), True, "near"),
    )
    path = PathCorrection(1, steps["stamp_ns"][:1], np.zeros((1, 3)), np.ones((1, 3)))
    run = RunResult(steps, 2, remarks=("full",), final=final, loop_closures=(loop,), path_corrections=(path,))
    cells = np.zeros((3, 2), dtype=np.float32)
    grid = OccupancyGrid(cells, cells > 0, 0.05, 0.0, 0.0)
    scores = Scores({"ate": Score(1.0, 2)}, grid=grid, errors_m=np.zeros(2))
    spec = RunSpec("key", Method("icp", "icp", {}), SequenceSpec("room", "room", {}, (0,)), 0)
    with tempfile.TemporaryDirectory() as place:
        store = Store(Path(place))
        store.create_run_folder("key")
        store.save_result(spec, run)
        store.save_scores("key", scores, "")
        if store.load_result("key") is None or store.load_scores("key") is None:
            raise AssertionError("a run that was just stored does not load")
        return {name: (store.run_folder("key") / name).read_bytes() for name in FILES}


def _seal(content: dict[str, object], files: dict[str, bytes]) -> bytes:
    values = {key: value for key, value in content.items() if key not in ("sha256", "files")}
    return seal(values, files).encode()


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
