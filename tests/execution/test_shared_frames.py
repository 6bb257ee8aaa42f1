"""Frames that several runs read: from one file, written once, unchanged, and gone when no run needs it."""

import json
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evalkit.config.experiment_file import experiment_from_tables
from evalkit.core.run_result import STEP
from evalkit.core.run_status import Cause
from evalkit.execution import executors
from evalkit.execution.executors import LocalExecutor
from evalkit.execution.one_run import Request, execute_request
from evalkit.execution.scheduler import Scheduler
from evalkit.execution.shared_frames import FOLDER, SharedFrames
from evalkit.execution.subprocesses import WorkerPool
from evalkit.plugins.stored_frames import StoredFrames
from evalkit.results.store import STEPS, Store

pytestmark = pytest.mark.usefixtures("strangers")

TIMES = ("wall_ns", "cpu_ns", "conversion_ns", "harness_ns", "device_ns", "preparation_ns")


class NoProgress:
    """Progress that reports nothing."""

    def started(self, spec): ...

    def answered(self, spec, scans): ...

    def finished(self, spec, result): ...


def plan(*methods, **sequence):
    """Return an experiment of back ends on the data set "straight"."""
    content = {
        "method": [{"use": "faulty", "label": label, "fault": "none"} for label in methods],
        "sequence": [{"use": "straight", "scans": 12, **sequence}],
        "mapper": {"resolution_m": 0.25},
    }
    return experiment_from_tables(content, "t.toml", "t", "compare t.toml")


def request_of(store, spec):
    return Request.of(json.loads((store.run_folder(spec.key) / "request.json").read_text()))


def test_all_methods_read_one_file_and_answer_as_without_it(tmp_path, monkeypatch):
    opened = []

    class Counted(SharedFrames):
        def of_run(self, spec, core):
            opened.append((tmp_path / FOLDER).exists())
            return super().of_run(spec, core)

    monkeypatch.setattr(executors, "SharedFrames", Counted)
    store = Store(tmp_path)
    results = list(Scheduler(store, NoProgress()).run(plan("a", "b"), LocalExecutor(1)))
    files = {request_of(store, spec).frames for spec, _ in results}
    assert len(files) == 1
    assert None not in files
    assert opened == [False, True]  # not yet for the first run, and still there for the last
    assert not (tmp_path / FOLDER).exists()
    for spec, result in results:
        folder = tmp_path / f"{spec.method.label} again"
        folder.mkdir()
        again = execute_request(replace(request_of(store, spec), core=None, frames=None), folder)
        steps = store.read_result(spec.key).steps
        assert (
            (result.expected, result.notes, result.every) == (again.expected, again.notes, again.every) == (12, {}, 1)
        )
        for name in set(STEP.names) - set(TIMES):
            assert steps[name].tobytes() == np.fromfile(folder / STEPS, STEP)[name].tobytes(), name


def test_a_run_refuses_frames_that_a_back_end_has_changed(tmp_path, monkeypatch):
    class Changed(SharedFrames):
        @contextmanager
        def of_run(self, spec, core):
            with super().of_run(spec, core) as file:
                if spec.method.label == "b":
                    path = Path(file.path)
                    path.write_bytes(path.read_bytes()[:-1] + b"?")
                yield file

    monkeypatch.setattr(executors, "SharedFrames", Changed)
    runs = Scheduler(Store(tmp_path), NoProgress()).run(plan("a", "b"), LocalExecutor(1))
    results = {spec.method.label: result for spec, result in runs}
    assert (results["a"].status, len(results["a"].steps)) == ("complete", 12)
    assert (results["b"].cause, len(results["b"].steps)) == (Cause.EXCEPTION, 0)
    assert "sha256" in results["b"].reason


@pytest.fixture(scope="module")
def scoring():
    """One process of the scoring pool."""
    with WorkerPool([None]) as pool:
        yield pool


def test_a_file_is_written_for_the_first_run_and_deleted_after_the_last(tmp_path, scoring):
    specs = list(plan("a", "b").runs())
    with SharedFrames(tmp_path, specs, scoring, 600.0) as shared:
        with shared.of_run(specs[0], None) as first:
            assert len(list(StoredFrames(first).frames())) == 12
        with shared.of_run(specs[1], None) as second:
            assert second == first
            assert len(StoredFrames(second)) == 12
        assert not list((tmp_path / FOLDER).iterdir())


def test_files_of_a_killed_process_are_deleted_and_nothing_else(tmp_path, scoring):
    spec, *_ = plan("a").runs()
    killed = SharedFrames(tmp_path, [spec], scoring, 600.0)
    with killed.of_run(spec, None) as file:
        Path(f"{file.path}.0123.part").touch()
        kept = Path(file.path).read_bytes()
        with SharedFrames(tmp_path, [], scoring, 600.0):
            assert not (tmp_path / FOLDER).exists()
    (tmp_path / FOLDER).mkdir()
    Path(file.path).write_bytes(kept)
    (tmp_path / FOLDER / "of the user.txt").touch()
    with SharedFrames(tmp_path, [], scoring, 600.0):
        assert [path.name for path in (tmp_path / FOLDER).iterdir()] == ["of the user.txt"]


def test_a_link_in_place_of_the_folder_is_not_followed(tmp_path, scoring):
    elsewhere, results = tmp_path / "elsewhere", tmp_path / "results"
    elsewhere.mkdir()
    results.mkdir()
    (elsewhere / "a.frames").touch()
    (results / FOLDER).symlink_to(elsewhere)
    spec, *_ = plan("a").runs()
    with SharedFrames(results, [spec], scoring, 600.0) as shared, shared.of_run(spec, None) as file:
        assert file is None  # nothing is written through the link either
    assert [path.name for path in elsewhere.iterdir()] == ["a.frames"]


@pytest.mark.parametrize("sequence", [{"file": __file__ + " is gone"}, {"reads_until": __file__ + " never"}])
def test_a_run_reads_data_itself_that_cannot_be_read_in_time(tmp_path, scoring, sequence):
    """The run then tells why: the file is gone, or the limit of a run is over."""
    spec, *_ = plan("a", **{**sequence, "file": ""}).runs()
    spec = replace(spec, sequence=replace(spec.sequence, parameters={**spec.sequence.parameters, **sequence}))
    with SharedFrames(tmp_path, [spec], scoring, 0.5) as shared, shared.of_run(spec, None) as file:
        assert file is None


def test_a_run_in_a_known_map_reads_the_data_itself(tmp_path, scoring):
    """Its start is searched with the ground truth, which the file does not hold."""
    spec, *_ = plan("a", map="truth").runs()
    with SharedFrames(tmp_path, [spec], scoring, 600.0) as shared, shared.of_run(spec, None) as file:
        assert file is None
