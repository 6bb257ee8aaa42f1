"""Stored results: read back unchanged, completely or not at all."""

import errno
import json
import os
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from evalkit.config.experiment import Method, RunSpec, SequenceSpec
from evalkit.core.errors import StoreError
from evalkit.core.grid import OccupancyGrid
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.path_correction import PathCorrection
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, LostTrack, RunResult, Score, Scores
from evalkit.core.run_status import Cause
from evalkit.core.trajectory import Trajectory
from evalkit.io import map_server
from evalkit.io.tum import format_tum, read_tum
from evalkit.results.seal import seal
from evalkit.results.store import Store, whole_records

KEY = "room-s0-icp-0123456789"


@pytest.fixture
def store(tmp_path):
    return Store(tmp_path / "out")


def steps(count=5):
    rng = np.random.default_rng(3)
    made = np.frombuffer(rng.bytes(count * STEP.itemsize), dtype=STEP).copy()
    made["stamp_ns"] = 1_700_000_000_123_456_789 + np.cumsum(rng.integers(1, 10**9, count))
    made["x"], made["y"], made["theta"] = rng.uniform(-3, 3, (3, count))
    return made


SPEC = RunSpec(KEY, Method("icp", "icp", {}), SequenceSpec("room <1>", "room", {}, (0,)), 0)


def saved_run(store, cause=Cause.COMPLETED, reason=""):
    provenance = {"executed_at": "2024-05-01T12:00:00+00:00"}
    run = RunResult(steps(), 9, cause, reason, 123, 5, {"invalid ranges": 2}, 2, provenance, remarks=("full",))
    (store.create_run_folder(KEY) / "steps.bin").write_bytes(run.steps.tobytes())
    store.save_result(SPEC, run)
    return run


def grid(**changes):
    rng = np.random.default_rng(4)
    place = {"resolution_m": 0.05, "origin_x": -1.0 / 3.0, "origin_y": 2.0 / 7.0, **changes}
    log_odds = rng.uniform(-5, 5, (7, 11)).astype(np.float32)
    return OccupancyGrid(log_odds, rng.random((7, 11)) < 0.8, **place)


def same_grid(a, b):
    assert a.log_odds.tobytes() == b.log_odds.tobytes()
    assert a.observed.tolist() == b.observed.tolist()
    assert (a.resolution_m, a.origin_x, a.origin_y) == (b.resolution_m, b.origin_x, b.origin_y)


ERRORS = np.array([0.1, np.nan, 1.0 / 3.0])
BY_METRIC = {"ate": Score(1.0 / 3.0, 60), "f1": Score(None, 0, "no truth")}


def scores(**changes):
    lost = LostTrack(212.0 / 3.0, "away")
    kept = Scores(BY_METRIC, Pose(0.1, 1.0 / 3.0, -2.0), "least squares", grid(), ERRORS, lost)
    return replace(kept, **changes)


# runs


@pytest.mark.parametrize("ended", [(Cause.COMPLETED, ""), (Cause.SIGNAL, "ended by SIGSEGV")])
def test_a_stored_result_is_loaded_to_the_bit(store, ended):
    kept = saved_run(store, *ended)
    again = Store(store.folder).load_result(KEY)
    assert again is not None
    assert again.steps.tobytes() == kept.steps.tobytes()
    for field in fields(RunResult):
        if field.name != "steps":  # without corrected poses here
            assert getattr(again, field.name) == getattr(kept, field.name)
    path = store.run_folder(KEY) / "result.json"
    record = json.loads(path.read_text())
    assert (record["method"], record["sequence"], record["status"]) == ("icp", "room <1>", kept.status)
    later = ("remarks", "paths_left_out", "sha256", "files")
    earlier = {key: value for key, value in record.items() if key not in later}
    path.write_text(seal(earlier, {"steps.bin": kept.steps.tobytes()}))
    again = Store(store.folder).load_result(KEY)
    assert (again.remarks, again.path_corrections, again.paths_left_out) == ((), (), "")


@pytest.mark.parametrize("found_again", [None, False, True])
def test_corrected_poses_and_loop_closures_are_loaded_to_the_bit(store, found_again):
    kept = saved_run(store)
    poses = np.random.default_rng(5).uniform(-3.0, 3.0, (5, 3))
    closure = LoopClosure(
        int(kept.steps["stamp_ns"][4]), int(kept.steps["stamp_ns"][0]), Pose(0.1, 1 / 3), False, "far", found_again
    )
    final = Trajectory(kept.steps["stamp_ns"], poses, "start", "base")
    stamps = kept.steps["stamp_ns"]
    path = PathCorrection(int(stamps[3]), stamps[[0, 2]], poses[:2], poses[2:4])
    ended = {"final": final, "loop_closures": (closure,), "path_corrections": (path,), "paths_left_out": "too many"}
    store.save_result(SPEC, replace(kept, **ended, final_cpu_ns=7))
    again = Store(store.folder).load_result(KEY)
    assert again.final.poses.tobytes() == poses.tobytes()
    assert (again.loop_closures, again.final_cpu_ns) == ((closure,), 7)
    (found,) = again.path_corrections
    assert (found.stamp_ns, found.stamps_ns.tolist()) == (stamps[3], stamps[[0, 2]].tolist())
    assert again.paths_left_out == "too many"
    assert np.concatenate([found.before, found.after]).tobytes() == poses[:4].tobytes()
    assert again.with_final_answers.estimate.poses.tobytes() == poses.tobytes()
    assert again.with_final_answers.steps["cpu_ns"].tolist() == kept.steps["cpu_ns"].tolist()
    assert np.allclose(read_tum(store.folder / "trajectories" / f"{KEY}.final.tum").trajectory.poses, poses, atol=1e-8)
    assert kept.with_final_answers is None


def test_an_incomplete_record_is_ignored():
    whole = steps(3)
    for cut in (1, STEP.itemsize - 1, STEP.itemsize):
        assert whole_records(whole.tobytes()[:-cut]).tobytes() == whole[:2].tobytes()
    assert whole_records(b"").shape == (0,)


@pytest.mark.parametrize("keep", [0, 1, 40, -1])
def test_a_half_written_result_is_not_loaded(store, keep):
    saved_run(store)
    path = store.run_folder(KEY) / "result.json"
    path.write_bytes(path.read_bytes()[:keep])
    assert store.load_result(KEY) is None


def test_a_result_with_truncated_answers_is_not_loaded(store):
    saved_run(store)
    path = store.run_folder(KEY) / "steps.bin"
    path.write_bytes(path.read_bytes()[: -STEP.itemsize])
    assert store.load_result(KEY) is None


@pytest.mark.parametrize("record", [[], {"method": "icp"}, {"unheard": 1}])
def test_a_result_file_with_other_content_is_not_loaded(store, record):
    saved_run(store)
    (store.run_folder(KEY) / "result.json").write_text(json.dumps(record))
    assert store.load_result(KEY) is None


def test_a_missing_run_is_not_loaded_and_a_new_folder_is_empty(store):
    assert store.load_result(KEY) is None
    saved_run(store)
    assert list(store.create_run_folder(KEY).iterdir()) == []
    assert store.load_result(KEY) is None


# scores


def test_scores_map_and_errors_are_loaded_to_the_bit(store):
    saved_run(store)
    store.save_scores(KEY, scores(), "f")
    again = Store(store.folder).load_scores(KEY)
    assert again is not None
    assert again.by_metric == BY_METRIC
    assert again.world_from_start == Pose(0.1, 1.0 / 3.0, -2.0)
    assert again.alignment == "least squares"
    assert again.lost == LostTrack(212.0 / 3.0, "away")
    assert store.load_scores(KEY, "f") is not None
    assert store.load_scores(KEY, "other code") is None
    assert again.errors_m.tobytes() == ERRORS.tobytes()
    same_grid(again.grid, grid())


def test_new_scores_without_a_map_delete_the_old_map(store):
    saved_run(store)
    store.save_scores(KEY, scores(), "f")
    store.save_scores(KEY, scores(grid=None, errors_m=None), "f")
    again = store.load_scores(KEY)
    assert (again.grid, again.errors_m) == (None, None)
    assert not list((store.folder / "maps").glob(f"{KEY}.*"))


@pytest.mark.parametrize("name", ["scores.json", "grid.npz", "errors.npy"])
@pytest.mark.parametrize("keep", [0, 60, -1])
def test_damaged_scores_are_not_loaded(store, name, keep):
    saved_run(store)
    store.save_scores(KEY, scores(), "f")
    path = store.run_folder(KEY) / name
    path.write_bytes(path.read_bytes()[:keep])
    assert store.load_scores(KEY) is None


def test_interrupted_scoring_leaves_no_old_scores_behind(store, monkeypatch):
    saved_run(store)
    store.save_scores(KEY, scores(), "f")
    monkeypatch.setattr(map_server, "write_map", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        store.save_scores(KEY, scores(), "f")
    assert store.load_scores(KEY) is None


# folders that cannot be written


def test_a_folder_that_cannot_be_created_is_named_with_a_remedy(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError) as caught:
        Store(tmp_path / "file" / "out")
    assert str(caught.value).startswith(f"{tmp_path / 'file' / 'out'}: cannot be written (Not a directory)")
    assert str(caught.value).endswith("); name another folder")
    with pytest.raises(
        StoreError, match=r"file: cannot be written \(a file of this name exists\); name another folder"
    ):
        Store(tmp_path / "file")


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="no /proc here")
def test_a_read_only_folder_is_named():
    with pytest.raises(StoreError, match=r"/proc/out: cannot be written \(.+\); name another folder"):
        Store(Path("/proc/out"))


def test_a_map_that_does_not_fit_on_the_disk_is_a_store_error(store, monkeypatch):
    def full(_file):
        raise OSError(28, os.strerror(28))

    saved_run(store)
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreError, match=r"No space left on device"):
        store.save_scores(KEY, scores(errors_m=None), "f")
    assert store.load_scores(KEY) is None


def test_no_temporary_files_are_left_behind(store):
    saved_run(store)
    store.save_scores(KEY, scores(), "f")
    names = sorted(str(path.relative_to(store.folder)) for path in store.folder.rglob("*") if path.is_file())
    own = ("errors.npy", "grid.npz", "result.json", "scores.json", "steps.bin")
    assert names == sorted(
        [*(f"runs/{KEY}/{name}" for name in own), f"maps/{KEY}.pgm", f"maps/{KEY}.yaml", f"trajectories/{KEY}.tum"]
    )


# maps for map_server


def test_a_map_is_grey_by_its_cells_and_row_0_is_on_top(store):
    log_odds = np.array([[5.0, -5.0, 0.0], [-5.0, 5.0, 5.0]])
    observed = np.array([[True, True, True], [True, True, False]])
    map_server.write_map(
        store.folder / "maps" / "a.b", OccupancyGrid(log_odds.astype(np.float32), observed, 0.05, -1.5, 2.0)
    )
    header, pixels = (store.folder / "maps" / "a.b.pgm").read_bytes().split(b"\n255\n")
    assert header == b"P5\n3 2"
    assert list(pixels) == [254, 0, 205, 0, 254, 205]
    lines = (store.folder / "maps" / "a.b.yaml").read_text().splitlines()
    assert {"image: a.b.pgm", "resolution: 0.05", "origin: [-1.5, 2.0, 0.0]", "negate: 0"} <= set(lines)


@pytest.mark.parametrize("number", [float, np.float64])
def test_a_written_map_is_read_with_the_same_cells_and_origin(store, number):
    pytest.importorskip("ruamel.yaml")
    kept = grid(resolution_m=number(0.1 / 3.0), origin_x=number(-1e-7 / 3.0), origin_y=number(12345.678901234567))
    map_server.write_map(store.folder / "maps" / KEY, kept)
    again = map_server.read_map(store.folder / "maps" / f"{KEY}.yaml")
    assert again.occupied().tolist() == kept.occupied().tolist()
    assert again.free().tolist() == kept.free().tolist()
    assert (again.resolution_m, again.origin_x, again.origin_y) == (kept.resolution_m, kept.origin_x, kept.origin_y)


# trajectories for other tools


def test_a_trajectory_is_read_back_to_the_nanosecond(store):
    kept = saved_run(store).estimate
    again = read_tum(store.folder / "trajectories" / f"{KEY}.tum").trajectory
    assert again.stamps_ns.tolist() == kept.stamps_ns.tolist()
    np.testing.assert_allclose(again.poses, kept.poses, atol=1e-9)


def test_a_line_is_seconds_metres_and_a_quaternion():
    text = format_tum(
        Trajectory(np.array([-1_500_000_000, 7]), np.array([[1.5, -2.0, np.pi / 2], [0, 0, 0]])), "evalkit: icp on room"
    )
    assert text.splitlines() == [
        "# evalkit: icp on room",
        "# world_from_base: timestamp tx ty tz qx qy qz qw",
        "-1.500000000 1.500000000000 -2.000000000000 0 0 0 0.707106781187 0.707106781187",
        "0.000000007 0.000000000000 0.000000000000 0 0 0 0.000000000000 1.000000000000",
    ]


@pytest.mark.parametrize("kind", ["folder", "link"])
def test_a_lock_that_is_no_file_is_named_and_not_followed(store, tmp_path, kind):
    lock, victim = store.folder / ".writer.lock", tmp_path / "victim"
    victim.write_text("mine")
    lock.mkdir() if kind == "folder" else lock.symlink_to(victim)
    with pytest.raises(StoreError, match=r"\.writer\.lock: cannot be locked .*; remove it, or"), store.writer_lock():
        pass
    assert victim.read_text() == "mine"


def test_a_file_system_that_gives_no_locks_is_named(store, monkeypatch):
    def flock(_descriptor, _operation):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.flock", flock)
    with pytest.raises(StoreError, match=r"cannot be locked .*name a folder on a local disk"), store.writer_lock():
        pass


def test_runs_and_trajectories_that_are_links_are_not_followed(tmp_path):
    """A received folder may lead elsewhere; nothing there is written or removed."""
    outside = tmp_path / "outside"
    (outside / KEY).mkdir(parents=True)
    (outside / KEY / "mine.txt").write_text("mine")
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "runs").symlink_to(outside)
    with pytest.raises(StoreError, match="'runs' is a link or a file, not a folder"):
        Store(folder)
    store = Store.existing(folder)
    for write in (lambda: store.create_run_folder(KEY), lambda: store.save_result(SPEC, RunResult(steps(), 9))):
        with pytest.raises(StoreError, match="'runs' is a link or a file, not a folder"):
            write()
    assert (outside / KEY / "mine.txt").read_text() == "mine"


def test_a_run_folder_that_is_a_link_is_replaced_and_its_target_kept(store, tmp_path):
    target = tmp_path / "target"
    target.mkdir()
    (target / "mine.txt").write_text("mine")
    store.run_folder(KEY).symlink_to(target)
    assert list(store.create_run_folder(KEY).iterdir()) == []
    assert not store.run_folder(KEY).is_symlink()
    assert (target / "mine.txt").read_text() == "mine"
