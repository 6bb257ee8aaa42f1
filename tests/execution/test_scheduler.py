"""Runs of an experiment on this machine: a row for every outcome, resumed where they stopped."""

import errno
import itertools
import json
import multiprocessing
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from evalkit.config.experiment_file import experiment_from_tables
from evalkit.config.limits import Limits
from evalkit.core.errors import NotInstalled, StoreError
from evalkit.core.run_result import RunConditions
from evalkit.execution import environment, run_process, run_task, subprocesses
from evalkit.execution.executors import LocalExecutor
from evalkit.execution.scheduler import Scheduler
from evalkit.plugins import registry
from evalkit.results.seal import seal
from evalkit.results.store import Store

pytestmark = [pytest.mark.slow(60), pytest.mark.usefixtures("strangers")]


class RecordedProgress:
    """Progress that records its calls."""

    def __init__(self):
        self.begins, self.ends, self.scans = [], [], 0

    def started(self, spec):
        self.begins.append(spec.method.label)

    def answered(self, spec, scans):
        self.scans = max(scans, self.scans)

    def finished(self, spec, result):
        self.ends.append(spec.method.label)


class StoppedExecutor:
    """An executor that shows that it was called."""

    def run(self, *_arguments):
        raise ZeroDivisionError


@pytest.fixture
def threaded_scoring(monkeypatch):
    """Score in threads, because the test does not concern the scoring processes."""
    monkeypatch.setattr(subprocesses, "start_process", lambda core: ThreadPoolExecutor(1))


def plan(*faults, sequence=None, mapper=None, **limits):
    """Return an experiment with a method for every fault, or for every table of methods."""
    tables = [{"use": "faulty", "label": f, "fault": f} if isinstance(f, str) else f for f in faults]
    content = {
        "method": tables,
        "sequence": [{"use": "straight", **(sequence or {})}],
        "mapper": mapper or {"resolution_m": 0.25},
        "limits": {"run_s": 600.0, "scan_s": 300.0, **limits},
    }
    return experiment_from_tables(content, "t.toml", "t", "compare t.toml")


def run(plan, folder, jobs=1, progress=None, **policy):
    scheduler = Scheduler(Store(folder), progress or RecordedProgress(), **policy)
    return scheduler.run_and_load(plan, LocalExecutor(jobs))


def records(plan, folder, jobs=2, resume=False, progress=None):
    made = run(plan, folder, jobs, progress, resume=resume)
    return {record.method: record for record in made}


def written_times(folder):
    """Return when the answers and scores of each run were written, by label."""
    runs = [
        run for run in (folder / "runs").iterdir() if (run / "result.json").exists() and (run / "scores.json").exists()
    ]
    return {
        run.name.split("-", 1)[1].rsplit("-", 1)[0]: tuple(
            (run / name).stat().st_mtime_ns for name in ("steps.bin", "scores.json")
        )
        for run in runs
    }


def test_every_run_has_a_record_with_its_cause(tmp_path):
    progress = RecordedProgress()
    faults = ("none", "raise", "remove-folder", "segfault", "far", {"use": "absent"})
    made = records(plan(*faults), tmp_path, progress=progress)
    assert {label: record.result.status for label, record in made.items()} == {
        "none": "complete", "raise": "failed", "remove-folder": "failed", "segfault": "crashed", "far": "complete",
        "absent": "not-installed",
    }  # fmt: skip
    assert list(made) == ["none", "raise", "remove-folder", "segfault", "far", "absent"] == [*progress.begins, "absent"]
    assert sorted(progress.ends) == sorted(made)
    assert progress.scans == 12
    good, broken, far = made["none"], made["raise"], made["far"]
    assert good.scores.by_metric["ate_rmse_m"].value == pytest.approx(0.0, abs=1e-9)
    assert good.scores.alignment == "least squares over 12 poses; 12 equal stamps"
    assert good.truth.how == broken.truth.how == "exact"
    assert broken.scores.by_metric["ate_rmse_m"].support == 8
    assert far.scores.by_metric["ate_rmse_m"].value > 1e5
    assert far.scores.grid is None
    assert far.scores.by_metric["map_entropy"].reason.startswith(
        "no map: the mapper failed (log-odds: parameter 'resolution_m'"
    )
    assert made["absent"].result.reason == "the library 'nowhere' is not installed; pip install nowhere"
    assert not Store(tmp_path).run_folder(made["absent"].key).exists()
    assert multiprocessing.active_children() == []


def test_resume_executes_only_missing_and_changed_runs(tmp_path, threaded_scoring):
    first = records(plan("none", "raise"), tmp_path)
    before = written_times(tmp_path)
    progress = RecordedProgress()
    changed = {"use": "faulty", "label": "raise", "fault": "raise", "at": 6}
    again = records(plan("none", changed, "nan"), tmp_path, resume=True, progress=progress)
    after = written_times(tmp_path)
    assert after["none"] == before["none"]
    assert again["none"].key == first["none"].key
    assert again["raise"].key != first["raise"].key
    assert [len(again[label].result.steps) for label in ("none", "raise", "nan")] == [12, 6, 8]
    assert dict(again["none"].scores.by_metric) == dict(first["none"].scores.by_metric)
    assert np.array_equal(again["none"].scores.errors_m, first["none"].scores.errors_m)
    assert np.array_equal(again["none"].scores.grid.log_odds, first["none"].scores.grid.log_odds)
    assert sorted(progress.ends) == ["nan", "none", "raise"]


def test_resume_repeats_a_timeout_only_when_the_limits_have_changed(tmp_path, threaded_scoring, monkeypatch):
    """The limit of CPU time is looked at from the scan of the fault on: starting a process takes some, too."""
    broken_limit = run_process._broken_limit
    monkeypatch.setattr(run_process, "_broken_limit", lambda *now: broken_limit(*now) if now[-1] >= 8 else None)
    first = records(plan("spin", "raise", scan_cpu_s=1.0), tmp_path)
    assert [record.result.status for record in first.values()] == ["timeout", "failed"]
    stamps = {name: run.stat().st_mtime_ns for name, run in run_files(tmp_path).items()}
    records(plan("spin", "raise", scan_cpu_s=1.0), tmp_path, resume=True)
    assert {name: run.stat().st_mtime_ns for name, run in run_files(tmp_path).items()} == stamps
    records(plan("spin", "raise", scan_cpu_s=1.1), tmp_path, resume=True)
    changed = {name for name, run in run_files(tmp_path).items() if run.stat().st_mtime_ns != stamps[name]}
    assert changed == {"spin"}


def test_rerun_executes_only_runs_with_the_given_status(tmp_path, threaded_scoring):
    records(plan("none", "raise", "nan", "segfault"), tmp_path)
    stamps = {name: run.stat().st_mtime_ns for name, run in run_files(tmp_path).items()}
    again = frozenset({"crashed"})
    made = run(plan("none", "raise", "nan", "segfault"), tmp_path, resume=True, rerun=again)
    assert [record.result.status for record in made] == ["complete", "failed", "failed", "crashed"]
    changed = {name for name, run in run_files(tmp_path).items() if run.stat().st_mtime_ns != stamps[name]}
    assert changed == {"segfault"}


@pytest.mark.thorough
def test_rerun_disturbed_executes_only_runs_that_something_disturbed(tmp_path, threaded_scoring, monkeypatch):
    shares = iter([50.0, 0.0, 0.0])
    monkeypatch.setattr(run_process.ConditionsMeter, "conclude", lambda *_: RunConditions(other_percent=next(shares)))
    run(plan("none", "raise"), tmp_path, jobs=1)
    first = {
        name: json.loads(path.read_text())["conditions"]["disturbed"] for name, path in run_files(tmp_path).items()
    }
    assert first == {"none": True, "raise": False}
    stamps = {name: run.stat().st_mtime_ns for name, run in run_files(tmp_path).items()}
    again = run(plan("none", "raise"), tmp_path, resume=True, rerun=frozenset({"disturbed"}))
    assert [record.result.conditions.disturbed for record in again] == [False, False]
    changed = {name for name, run in run_files(tmp_path).items() if run.stat().st_mtime_ns != stamps[name]}
    assert changed == {"none"}


def test_collect_executes_no_run_and_lists_missing_runs(tmp_path, threaded_scoring):
    records(plan("none", "raise"), tmp_path)
    stamps = {name: run.stat().st_mtime_ns for name, run in run_files(tmp_path).items()}
    made = run(plan("none", "nan", "raise"), tmp_path, collect=True)
    assert [record.result.status for record in made] == ["complete", "skipped", "failed"]
    assert made[0].scores.by_metric["ate_rmse_m"].value == pytest.approx(0.0, abs=1e-9)
    assert made[1].result.reason == "not run yet; the same command without --collect runs it"
    assert {name: run.stat().st_mtime_ns for name, run in run_files(tmp_path).items()} == stamps


def test_two_processes_cannot_write_to_one_results_folder(tmp_path, threaded_scoring):
    store = Store(tmp_path)
    with store.writer_lock(), pytest.raises(StoreError, match="another evalkit writes to this folder; wait for it"):
        records(plan("none"), tmp_path)
    assert records(plan("none"), tmp_path)["none"].result.status == "complete"


def test_setting_the_system_clock_does_not_affect_limits(tmp_path, threaded_scoring, monkeypatch):
    now, jumps = time.time(), itertools.cycle((-86_400.0, 0.0, 86_400.0))
    monkeypatch.setattr(time, "time", lambda: now + next(jumps))
    assert records(plan("none"), tmp_path / "a")["none"].result.status == "complete"  # a jump is longer than its limits
    assert records(plan("hang", scan_s=1.5), tmp_path / "b")["hang"].result.status == "timeout"


def run_files(folder):
    """Return the record of each run's end, by label."""
    return {path.parent.name.split("-")[1]: path for path in folder.glob("runs/*/result.json")}


def test_every_run_stores_its_provenance(tmp_path, threaded_scoring):
    ran_on = {"commit": "abc", "processor": "slow", "memory": "not kept"}
    before = datetime.now(UTC)
    (record,) = run(plan("none"), tmp_path, environment=ran_on)
    made = dict(Store(tmp_path).load_result(record.key).provenance)
    assert before <= datetime.fromisoformat(made.pop("executed_at")) <= datetime.now(UTC)
    assert made.pop("limits") == asdict(Limits(run_s=600.0, scan_s=300.0))
    assert made.pop("core") == next(iter(environment.cores()), None)
    assert made.pop("versions") == environment.versions(("numpy", "scipy"))
    assert made.pop("timed") is True
    assert (tmp_path / made.pop("folder")).resolve() == Path.cwd()
    assert made.keys() == set(environment.KEPT_WITH_RUNS)
    assert {name: text for name, text in made.items() if text != "unknown"} == {"commit": "abc", "processor": "slow"}


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system cannot pin")
def test_a_run_is_scored_on_its_core_before_the_core_is_released(tmp_path, monkeypatch):
    """With one core for two runs, the second must not start before the first is scored."""
    told = []

    class Told(RecordedProgress):
        def started(self, spec):
            told.append(f"started {spec.method.label}")

    def score(*arguments):
        told.append(f"scored on {arguments[-1]}")
        raise RuntimeError("enough")

    monkeypatch.setattr(subprocesses, "start_process", lambda core: ThreadPoolExecutor(1))
    monkeypatch.setattr(run_task, "score_and_save", score)
    only = environment.cores()[0]
    monkeypatch.setattr(environment, "core_of_each", lambda jobs: [only])
    run(plan("none", "far"), tmp_path, 2, Told())
    assert told == ["started none", f"scored on {only}", "started far", f"scored on {only}"]


def test_no_more_runs_than_there_are_get_a_core_and_a_scoring_process(tmp_path, monkeypatch):
    pools, cores = [], []
    monkeypatch.setattr(subprocesses, "start_process", lambda core: pools.append(core) or ThreadPoolExecutor(1))
    monkeypatch.setattr(environment, "core_of_each", lambda jobs: cores.append(jobs) or [None] * jobs)
    run(plan("none", "far"), tmp_path, 500)
    assert (len(pools), cores) == (2, [2])


def test_without_resume_every_run_is_executed_again(tmp_path, threaded_scoring):
    records(plan("none"), tmp_path)
    before = written_times(tmp_path)
    records(plan("none"), tmp_path)
    assert written_times(tmp_path)["none"][0] > before["none"][0]


def test_a_metric_that_does_not_load_is_an_error_before_any_run(tmp_path, threaded_scoring, monkeypatch):
    def fail():
        raise NotInstalled("lab", "does not load", "mend it")

    monkeypatch.setattr(run_task.metrics, "all_metrics", fail)
    with pytest.raises(NotInstalled, match=r"^lab: does not load; mend it$"):
        run(plan("none"), tmp_path)
    assert not list(tmp_path.rglob("result.json"))


@pytest.mark.parametrize("what", ["code", "mapper"])
def test_changed_scoring_code_or_mapper_scores_the_stored_run_again(tmp_path, threaded_scoring, monkeypatch, what):
    records(plan("none"), tmp_path)
    (answers, scores) = written_times(tmp_path)["none"]
    mapper = {"resolution_m": 0.5} if what == "mapper" else None
    if what == "code":
        monkeypatch.setattr(registry, "hash_scoring_code", lambda mapper: "another")
    again = records(plan("none", mapper=mapper), tmp_path, resume=True)["none"]
    assert written_times(tmp_path)["none"][0] == answers
    assert written_times(tmp_path)["none"][1] > scores
    assert again.scores.grid.resolution_m == (0.5 if what == "mapper" else 0.25)


def test_resume_executes_a_run_whose_data_became_available(tmp_path, threaded_scoring):
    file = tmp_path / "file"
    absent = records(plan("none", sequence={"file": str(file)}), tmp_path / "out")["none"]
    assert (absent.result.status, absent.result.reason) == ("data-missing", f"{file} is gone")
    assert absent.truth.how == "the data are not available here"
    file.touch()
    assert (
        records(plan("none", sequence={"file": str(file)}), tmp_path / "out", resume=True)["none"].result.reason == ""
    )


def test_a_file_deleted_after_planning_is_missing_data(tmp_path, threaded_scoring):
    file = tmp_path / "file"
    file.touch()
    planned = plan("none", "raise", sequence={"file": str(file)})
    file.unlink()
    for record in records(planned, tmp_path / "out").values():
        assert record.result.status == "data-missing"
        assert record.result.reason == f"straight: {file} is gone; bring it back"
        assert record.truth.how == f"cannot be read: straight: {file} is gone; bring it back"


def test_a_run_that_cannot_be_scored_has_failed_and_keeps_its_answers(tmp_path, threaded_scoring):
    record = records(plan("none", sequence={"breaks": True}), tmp_path)["none"]
    assert record.result.status == "failed"
    assert record.result.reason == "scoring failed: RuntimeError: the truth is out there"
    assert len(record.result.steps) == 12
    assert record.scores.by_metric == {}


@pytest.mark.thorough
def test_a_mapper_that_kills_the_scoring_process_affects_only_its_run(tmp_path):
    mapper = {"use": "faulty-mapper", "fault": "sigkill", "only_past_m": 1e3}
    made = records(plan("far", "none", mapper=mapper), tmp_path, jobs=1)
    assert [record.result.status for record in made.values()] == ["crashed", "complete"]
    reason = made["far"].result.reason
    assert reason.startswith("quarantined: scoring it killed its process twice (")
    assert len(made["far"].result.steps) == 12
    assert made["none"].scores.by_metric["ate_rmse_m"].value == pytest.approx(0.0, abs=1e-9)


def test_a_run_quarantined_in_scoring_is_executed_again_only_with_rerun(tmp_path, threaded_scoring, monkeypatch):
    def deadly(*_arguments):
        asked.append(1)
        raise BrokenProcessPool("ended")

    asked = []
    monkeypatch.setattr(run_task, "score_and_save", deadly)
    again = frozenset({"crashed"})
    for how, count in ({}, 2), ({"resume": True}, 2), ({"resume": True, "rerun": again}, 4):
        (record,) = run(plan("none"), tmp_path, **how)
        assert record.result.reason.startswith("quarantined: scoring it killed its process twice (")
        assert len(asked) == count


def test_no_run_is_quarantined_if_no_scoring_process_can_start(tmp_path, monkeypatch):
    class Broken(ThreadPoolExecutor):
        def submit(self, *_arguments):
            raise BrokenProcessPool("no memory")

    monkeypatch.setattr(subprocesses, "start_process", lambda core: Broken(1))
    record = records(plan("none"), tmp_path)["none"]
    assert record.result.status == "interrupted"  # by the machine; not counted against the method
    assert record.result.reason.startswith("scoring: no process can be started here; free disk, memory, /dev/shm, ")
    monkeypatch.setattr(subprocesses, "start_process", lambda core: ThreadPoolExecutor(1))
    assert records(plan("none"), tmp_path, resume=True)["none"].result.status == "complete"


@pytest.mark.thorough
def test_a_run_that_kills_evalkit_twice_is_quarantined_and_others_are_executed(tmp_path, threaded_scoring):
    """A back end kills its parent evalkit twice; the third evalkit skips its runs and names them."""
    (tmp_path / "t.toml").write_text(
        '[[method]]\nuse = "faulty"\nfault = "kill-parent"\n[[method]]\nuse = "faulty"\nlabel = "none"\n'
        '[mapper]\nresolution_m = 0.25\n[[sequence]]\nuse = "straight"\n'
    )
    words = [str(tmp_path / "t.toml"), "--out", str(tmp_path / "out"), "-j", "1", "--resume", "--json"]
    command = [sys.executable, "-c", "from evalkit.cli import main; main()", "compare", "--no-page", *words]
    first, second, third = (subprocess.run(command, capture_output=True, text=True, check=False) for _ in range(3))
    assert (first.returncode, second.returncode, third.returncode) == (-9, -9, 1)
    deadly, other = json.loads(third.stdout)["runs"]
    assert deadly["reason"].startswith("quarantined: evalkit was killed twice while it ran (process ")
    assert (deadly["status"], other["status"]) == ("crashed", "complete")


@pytest.mark.parametrize("full", ["save_result", "save_scores", "begin"])
def test_a_full_results_folder_stops_everything_and_keeps_finished_runs(tmp_path, threaded_scoring, monkeypatch, full):
    original = getattr(Store, full)

    def guarded(self, run, *arguments):
        if "-raise-" in getattr(run, "key", run):
            raise StoreError(str(self.folder), "cannot be written (No space left on device)", "free some space")
        return original(self, run, *arguments)

    monkeypatch.setattr(Store, full, guarded)
    progress = RecordedProgress()
    with pytest.raises(StoreError, match="No space left on device"):
        records(plan("none", "raise", "nan", "far"), tmp_path, jobs=1, progress=progress)
    assert progress.ends == ["none"]
    assert written_times(tmp_path).keys() == {"none"}


def test_a_folder_with_the_report_of_another_experiment_is_refused_and_unchanged(tmp_path):
    def report(command, *labels, title="Lab"):
        content = {"title": title, "command": command, "sequences": {label: {} for label in labels}}
        (tmp_path / "results.json").write_text(json.dumps(content))

    def start(experiment):
        next(Scheduler(Store(tmp_path), RecordedProgress()).run(experiment, StoppedExecutor()))

    mine = plan("none")
    (label,) = (one.label for one in mine.sequences)
    report("evalkit compare lab.toml", "lab", "room")
    Store(tmp_path)
    before = {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}
    with pytest.raises(
        StoreError, match=r"another experiment, 'Lab' \('evalkit compare lab.toml'\); name another folder"
    ):
        start(mine)
    assert {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")} == before
    report("evalkit compare lab.toml", label)  # another file and another title, on a sequence of the same label
    with pytest.raises(StoreError, match="another experiment"):
        start(mine)
    for same in (
        lambda: report(mine.whole_command, "lab"),  # its sequences were exchanged
        lambda: report("evalkit compare elsewhere.toml", "lab", label, title=mine.title),  # its file was renamed
        lambda: report("evalkit compare elsewhere/t.toml", label),  # moved, with another title
        lambda: (tmp_path / "results.json").write_text('{"title": "La'),  # half-written: a run writes it again
        (tmp_path / "results.json").unlink,
    ):
        same()
        with pytest.raises(ZeroDivisionError):  # the runs start
            start(mine)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.ENOMEM, errno.EMFILE])
def test_a_fault_of_the_machine_interrupts_a_run_and_resume_repeats_it(tmp_path, threaded_scoring, monkeypatch, number):
    """The same fault once while the process starts and once while the run is scored."""

    def fail(*_arguments, **_options):
        raise OSError(number, os.strerror(number))

    for module, name in ((run_process, "ChildProcess"), (run_task, "score_and_save")):
        with monkeypatch.context() as broken:
            broken.setattr(module, name, fail)
            result = records(plan("none"), tmp_path, resume=True)["none"].result
        assert result.status == "interrupted"
        assert f"the machine failed ({os.strerror(number)}); free disk, memory" in result.reason
        assert "repeat with --resume" in result.reason
        stored = [Store(tmp_path).read_result(folder.parent.name) for folder in tmp_path.glob("runs/*/result.json")]
        assert [(one.cause, one.reason) for one in stored] == [(result.cause, result.reason)] * len(stored)
    assert records(plan("none"), tmp_path, resume=True)["none"].result.status == "complete"


def test_a_failed_rescoring_leaves_no_scores_of_other_code(tmp_path, threaded_scoring, monkeypatch):
    key = records(plan("none"), tmp_path)["none"].key
    store, path = Store(tmp_path), tmp_path / "runs" / key / "scores.json"
    content = {name: value for name, value in json.loads(path.read_text()).items() if name not in ("sha256", "files")}
    path.write_text(seal({**content, "fingerprint": "other code"}, {}))
    assert store.load_score_values(key)

    def refuse(*_arguments):
        raise ValueError("no such metric")

    monkeypatch.setattr(run_task, "score_and_save", refuse)
    assert (
        records(plan("none"), tmp_path, resume=True)["none"].result.reason
        == "scoring failed: ValueError: no such metric"
    )
    assert store.load_score_values(key) == {}


def test_a_failed_scoring_is_the_stored_cause_too_until_the_run_is_scored(tmp_path, threaded_scoring, monkeypatch):
    def refuse(*_arguments):
        raise ValueError("no such metric")

    planned, store = plan("none"), Store(tmp_path)
    with monkeypatch.context() as broken:
        broken.setattr(run_task, "score_and_save", refuse)
        for resume in (False, True):  # fails again, and keeps what was before the first failure
            record = records(planned, tmp_path, resume=resume)["none"]
            stored = store.read_result(record.key)
            for result in (record.result, stored):
                assert (result.cause, result.reason) == ("scoring failed", "scoring failed: ValueError: no such metric")
    collected = run(planned, tmp_path, collect=True)[0].result
    assert (collected.cause, collected.reason) == (stored.cause, stored.reason)
    executed_at = stored.provenance["executed_at"]
    record = records(planned, tmp_path, resume=True)["none"]
    stored = store.read_result(record.key)
    assert record.result.cause == stored.cause == "completed"
    assert record.result.reason == stored.reason == ""
    assert stored.provenance["executed_at"] == executed_at  # not executed again
    assert "before_scoring" not in stored.provenance
