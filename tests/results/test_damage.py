"""Random damage of a stored run is noticed: what is read is what was written, or nothing."""

import io
import json
import random

import numpy as np
import pytest

from evalkit.config.experiment import Method, RunSpec, SequenceSpec
from evalkit.core.grid import OccupancyGrid
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.path_correction import PathCorrection
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, RunConditions, RunResult, Score, Scores
from evalkit.core.trajectory import Trajectory
from evalkit.results.final_files import CLOSURES, FINAL, PATHS, format_final, parse_final
from evalkit.results.reader import load_stored_results
from evalkit.results.seal import check_seal, seal
from evalkit.results.store import ERRORS, GRID, RESULT, SCORES, STEPS, Store

KEY = "room-s0-icp-0123456789"
SPEC = RunSpec(KEY, Method("icp", "icp", {}), SequenceSpec("room", "room", {}, (0,)), 0)
DAMAGES = 1000


@pytest.fixture
def stored(tmp_path):
    """Return the store of a tiny run, and what it reads."""
    store = Store(tmp_path / "out")
    steps = np.zeros(20, dtype=STEP)
    steps["stamp_ns"], steps["x"] = np.arange(20) * 100_000_000, np.linspace(0.0, 1.0, 20)
    final = Trajectory(steps["stamp_ns"], np.random.default_rng(1).normal(size=(20, 3)), "start", "base")
    closures = (LoopClosure(1_900_000_000, 100_000_000, Pose(0.1, 0.2, 0.3), True, "score 0.8"),)
    conditions = RunConditions(load=0.5)
    path = PathCorrection(int(steps["stamp_ns"][9]), steps["stamp_ns"][:9], final.poses[:9], final.poses[1:10])
    result = RunResult(
        steps, 20, notes={"gaps": 2}, conditions=conditions, final=final, loop_closures=closures,
        path_corrections=(path,),
    )  # fmt: skip
    log_odds = np.random.default_rng(0).normal(size=(12, 10)).astype(np.float32)
    grid = OccupancyGrid(log_odds, log_odds > 0.0, 0.05, -1.0, 2.0)
    scores = Scores({"ate": Score(1.0 / 3.0, 20)}, Pose(0.1, 0.2, 0.3), "first pose", grid, np.linspace(0.0, 0.1, 20))
    store.create_run_folder(KEY)
    store.save_result(SPEC, result)
    store.save_scores(KEY, scores, "code")
    return store


FILES = (RESULT, STEPS, FINAL, CLOSURES, PATHS, SCORES, GRID, ERRORS)


def content_of(store):
    """Return everything that is read of a run, None for a part that is not."""
    result, scores = store.load_result(KEY), store.load_scores(KEY, "code")
    return (
        result and (result.steps.tobytes(), result.status, result.expected, result.notes, result.conditions,
                   result.final.poses.tobytes(), result.final.stamps_ns.tobytes(), result.loop_closures,
                   [one.before.tobytes() + one.after.tobytes() for one in result.path_corrections]),
        scores and (scores.by_metric, scores.world_from_start, scores.grid.log_odds.tobytes(),
                    scores.grid.observed.tobytes(), scores.grid.origin_x, scores.errors_m.tobytes()),
        store.load_score_values(KEY) or None,
    )  # fmt: skip


def damage(chance, raw, other):
    """Return the bytes of a file after one of the usual damages."""
    at, length = chance.randrange(len(raw)), chance.choice([1, 4, 16, 512])
    block = raw[at : at + length]
    kinds = [
        lambda: raw[:at] + bytes([raw[at] ^ 1 << chance.randrange(8)]) + raw[at + 1 :],
        lambda: raw[:at] + bytes(len(block)) + raw[at + length :],
        lambda: raw[:at] + chance.randbytes(len(block)) + raw[at + length :],
        lambda: raw[:at],
        lambda: raw[:at] + other[at:],  # torn: the rest is of another file
        lambda: raw[:at] + raw[at + length :],
        lambda: raw + block,
        lambda: b"",
        lambda: other,
    ]
    return chance.choice(kinds)()


def test_no_random_damage_changes_a_value_that_is_read(stored):
    chance, whole = random.Random(15), content_of(stored)
    assert None not in whole
    folder = stored.run_folder(KEY)
    files = {name: (folder / name).read_bytes() for name in FILES}
    noticed = 0
    for _ in range(DAMAGES):
        name = chance.choice(list(files))
        damaged = damage(chance, files[name], files[chance.choice(list(files))])
        (folder / name).write_bytes(damaged)
        for part, expected in zip(content_of(stored), whole, strict=True):
            assert part is None or part == expected, f"{name}: {damaged[:200]!r}"
        noticed += content_of(stored) != whole
        (folder / name).write_bytes(files[name])
    assert noticed > 0.8 * DAMAGES  # the rest are spaces in a text, and damages that change nothing


@pytest.mark.parametrize("name", [FINAL, CLOSURES, PATHS])
def test_a_damaged_file_of_corrected_poses_is_named(stored, name):
    path = stored.run_folder(KEY) / name
    raw = path.read_bytes()
    path.write_bytes(raw[:-1] + bytes([raw[-1] ^ 1]))
    assert stored.load_result(KEY) is None
    with pytest.raises(ValueError, match=f"{name} is damaged: its content does not agree with its checksum"):
        stored.read_result(KEY)


def _set(name, at, value):
    def change(steps):
        steps[name][at] = value

    return change


@pytest.mark.parametrize(
    "change", [_set("x", 7, np.nan), _set("theta", 0, np.inf), _set("stamp_ns", 9, 800_000_000), _set("y", 19, -np.inf)]
)
def test_steps_that_no_run_writes_are_refused_although_their_checksum_is_right(stored, change):
    """Of a folder from somebody who made the checksums again."""
    folder = stored.run_folder(KEY)
    steps = np.fromfile(folder / STEPS, STEP)
    change(steps)
    (folder / STEPS).write_bytes(steps.tobytes())
    seal_again(folder, RESULT, (STEPS, FINAL, CLOSURES))
    with pytest.raises(ValueError, match=r"steps.bin: the stamp of record \d+ is not after"):
        stored.read_result(KEY)
    assert stored.load_result(KEY) is None


@pytest.mark.parametrize("values", [np.array(["a"] * 20), np.zeros((20, 2)), np.zeros(20, dtype=np.int64)])
def test_errors_of_another_type_are_refused_although_their_checksum_is_right(stored, values):
    folder = stored.run_folder(KEY)
    np.save(folder / ERRORS, values)
    seal_again(folder, SCORES, (GRID, ERRORS))
    assert stored.load_scores(KEY) is None
    assert [run.errors_m.size for run in load_stored_results(stored.folder).runs.values()] == [0]


def seal_again(folder, name, files):
    content = json.loads((folder / name).read_text(encoding="utf-8"))
    values = {key: value for key, value in content.items() if key not in ("sha256", "files")}
    text = seal(values, {file: (folder / file).read_bytes() for file in files})
    (folder / name).write_text(text, encoding="utf-8")


def test_a_seal_is_of_the_values_and_not_of_their_order_or_spaces():
    content = {"b": [1.5, None, float("nan")], "a": {"x": "ä"}}
    text = seal(content, {"f": b"1"})
    again = json.loads(text)
    check_seal(dict(sorted(again.items())))
    for changed in ({**again, "b": [1.5, None, 2.0]}, {**again, "more": 1}, {**again, "files": {}}, {"a": 1}):
        with pytest.raises(ValueError, match="damaged: its values do not agree with its checksum"):
            check_seal(changed)


def test_corrected_poses_of_another_type_are_damaged():
    stamps = np.arange(2, dtype=np.int64)
    closure = LoopClosure(1, 0, Pose(1.0, 0.0, 0.0), True, "near")
    sound = format_final(Trajectory(stamps, np.zeros((2, 3))), (closure,))
    assert parse_final(sound, stamps)[1] == (closure,)
    body = io.BytesIO()
    np.save(body, np.zeros((2, 3), dtype=np.float32))
    with pytest.raises(ValueError, match="is damaged: an array of float32, expected float64"):
        parse_final({**sound, FINAL: body.getvalue()}, stamps)
    for key, value in (("stamp_ns", 1.5), ("accepted", 1), ("found_again", 1)):
        entry = {**json.loads(sound[CLOSURES])[0], key: value}
        with pytest.raises(ValueError, match=r"is damaged: .*expected (whole stamps, and )?true(,| or) false"):
            parse_final({**sound, CLOSURES: json.dumps([entry]).encode()}, stamps)


def test_loop_closures_of_earlier_versions_do_not_say_whether_they_found_a_lost_track_again():
    entry = {"stamp_ns": 1, "other_stamp_ns": 0, "other_from_base": [1.0, 0.0, 0.0], "accepted": True, "reason": "near"}
    stamps = np.arange(2, dtype=np.int64)
    files = {**format_final(Trajectory(stamps, np.zeros((2, 3))), ()), CLOSURES: json.dumps([entry]).encode()}
    assert parse_final(files, stamps)[1] == (LoopClosure(1, 0, Pose(1.0, 0.0, 0.0), True, "near", found_again=None),)
