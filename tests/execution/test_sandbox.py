"""Foreign code in a separate process: a result, a crash, a hang and excessive memory all give a result."""

import importlib
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from evalkit.execution import sandbox
from evalkit.execution.sandbox import ENDED
from evalkit.execution.task import make_task
from evalkit.execution.usage import Usage


@pytest.fixture(autouse=True)
def here(monkeypatch):
    """Make this file importable in the processes."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))


def doubled(row):
    return {"row": 2.0 * np.array(row), "said": "twice"}


def die(how):
    sandbox.note_place("the seventh question")
    os.kill(os.getpid(), getattr(signal, how))


def refuse():
    raise ZeroDivisionError("no pairs")


def sleep(sleeps):
    sandbox.note_place("a long one")
    Path(sleeps).touch()
    time.sleep(120.0)


def run(function, limit_s=300.0, **arguments):
    return sandbox.run(getattr(importlib.import_module("test_sandbox"), function), arguments, limit_s, 500)


def test_a_result_is_returned_with_its_arrays():
    found = run("doubled", row=[1.0, np.inf])
    assert found["said"] == "twice"
    assert found["row"].tolist() == [2.0, np.inf]


def test_a_crash_is_reported_with_signal_and_place():
    assert run("die", how="SIGSEGV") == {
        ENDED: "the process was terminated by SIGSEGV; it was in: the seventh question"
    }


def test_an_exception_is_reported_with_its_message():
    assert "ZeroDivisionError: no pairs" in run("refuse")[ENDED]


def test_a_hang_is_terminated(tmp_path, monkeypatch):
    """The limit is looked at only once it sleeps, however late it gets a core."""
    sleeps, broken_limit = tmp_path / "sleeps", sandbox._broken_limit
    monkeypatch.setattr(sandbox, "_broken_limit", lambda *given: broken_limit(*given) if sleeps.exists() else "")
    assert run("sleep", limit_s=1.0, sleeps=str(sleeps)) == {ENDED: "not finished after 1 s; it was in: a long one"}


class Noting:
    """A child of which a usage is known after each 0.8 s, and that has noted a new place in the first ``notes``."""

    def __init__(self, folder, notes):
        self._place, self._notes = folder / sandbox.PLACE, notes

    def watch(self):
        for number in range(8):
            if number < self._notes:
                self._place.write_text(f"question {number}")
            yield Usage(0.8 * number, 0.8 * number, 0)


@pytest.mark.parametrize(("notes", "why"), [(8, ""), (2, "not finished after 1 s")])
def test_the_limit_counts_from_the_last_place_that_was_noted(tmp_path, notes, why):
    """Eight questions of 0.8 s with a limit of 1 s."""
    assert sandbox._watch(Noting(tmp_path, notes), tmp_path, 1.0, 500) == why


def test_a_place_is_recorded_only_in_a_sandbox(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sandbox.note_place("nowhere")
    assert not list(tmp_path.iterdir())


def test_the_key_of_a_sandboxed_task_changes_with_arguments_and_limits():
    function = importlib.import_module("test_sandbox").doubled
    one, other = (make_task("x", function, row=row) for row in ([1.0], [2.0]))
    assert sandbox.make_sandboxed_task(one, 20.0, 500).key != sandbox.make_sandboxed_task(other, 20.0, 500).key
    assert sandbox.make_sandboxed_task(one, 20.0, 500).key != sandbox.make_sandboxed_task(one, 1.0, 500).key
