"""Run archives: an unpacked run is unchanged, and no archive can write outside its run."""

import io
import os
from zipfile import ZipFile

import numpy as np
import pytest

from evalkit.config.experiment import Method, RunSpec, SequenceSpec
from evalkit.core.errors import StoreError
from evalkit.core.grid import OccupancyGrid
from evalkit.core.run_result import STEP, RunResult, Scores
from evalkit.execution import run_archive
from evalkit.results.store import Store

KEY = "room-s0-icp-0123456789"


@pytest.fixture
def saved_run(tmp_path):
    store = Store(tmp_path / "one")
    steps = np.zeros(3, dtype=STEP)
    steps["stamp_ns"] = [0, 1, 2]
    (store.create_run_folder(KEY) / "output.txt").write_bytes(b"x" * (run_archive.MAX_OUTPUT_BYTES + 5) + b"last words")
    spec = RunSpec(KEY, Method("icp", "icp", {}), SequenceSpec("room", "room", {}, (0,)), 0)
    store.save_result(spec, RunResult(steps, 3, provenance={"executed_at": "2024-05-01T12:00:00+00:00"}))
    grid = OccupancyGrid(np.ones((4, 5), dtype=np.float32), np.ones((4, 5), dtype=bool), 0.05, 0.0, 0.0)
    store.save_scores(KEY, Scores(grid=grid, errors_m=np.arange(3.0)), "f")
    store.write(store.run_folder("room-s0-icp-01234567890") / "result.json", "another's")
    return store


def files(store):
    return {p.relative_to(store.folder): p.read_bytes() for p in store.folder.rglob(f"*{KEY}*/*") if p.is_file()} | {
        p.relative_to(store.folder): p.read_bytes() for p in store.folder.rglob(f"{KEY}.*")
    }


def test_an_unpacked_run_is_unchanged_except_for_the_start_of_its_output(saved_run, tmp_path):
    other = Store(tmp_path / "other")
    (other.create_run_folder(KEY) / "stale").touch()
    run_archive.unpack_run(other, KEY, run_archive.pack_run(saved_run, KEY))
    sent = {path: content for path, content in files(saved_run).items() if KEY + "0" not in str(path)}
    arrived = files(other)
    assert sent.keys() == arrived.keys()
    output = next(path for path in sent if path.name == "output.txt")
    assert len(arrived[output]) == run_archive.MAX_OUTPUT_BYTES
    assert arrived.pop(output).endswith(b"last words")
    assert {path: content for path, content in sent.items() if path != output} == arrived


def test_what_a_back_end_leaves_in_its_folder_stays_there(saved_run, tmp_path):
    """Among it a link to a file of the user, and files of more bytes than there is memory."""
    secret = tmp_path / "secret"
    secret.write_text("of the user")
    folder = saved_run.run_folder(KEY)
    (folder / "grid.npz").unlink()
    (folder / "grid.npz").symlink_to(secret)
    (folder / "link").symlink_to(secret)
    os.mkfifo(folder / "started.json")
    for name in ("junk", "outcome.json"):
        with (folder / name).open("wb") as file:
            file.truncate(2**40)
    with (folder / "output.txt").open("r+b") as file:
        file.truncate(2**40)
        file.seek(0, os.SEEK_END)
        file.write(b"last words")
    other = Store(tmp_path / "other")
    run_archive.unpack_run(other, KEY, run_archive.pack_run(saved_run, KEY))
    arrived = {path.name: path.read_bytes() for path in other.run_folder(KEY).iterdir()}
    assert arrived.keys() == {"result.json", "steps.bin", "scores.json", "errors.npy", "output.txt"}
    assert len(arrived["output.txt"]) == run_archive.MAX_OUTPUT_BYTES
    assert arrived["output.txt"].endswith(b"last words")


def test_an_archive_writes_nothing_outside_its_run(tmp_path):
    body = io.BytesIO()
    with ZipFile(body, "w") as archive:
        for name in ("run/../../../evil", "/evil", "../evil", "elsewhere/evil", "run/fine"):
            archive.writestr(name, b"")
    store = Store(tmp_path / "out")
    run_archive.unpack_run(store, KEY, body.getvalue())
    assert {path.parent for path in tmp_path.rglob("*") if path.is_file()} == {store.run_folder(KEY)}
    with pytest.raises(StoreError, match="the archive sent by the worker is damaged"):
        run_archive.unpack_run(store, KEY, b"no zip")
