"""Foreign code in a process apart: its result, its crash, its hang and its hunger are all results."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from evalkit.execution import sandbox
from evalkit.execution.sandbox import ENDED

LIMITS = {"limit_s": 20.0, "memory_mib": 500}


@pytest.fixture(autouse=True)
def here(monkeypatch):
    """The processes can import this file."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))


def doubled(row):
    return {"row": 2.0 * np.array(row), "said": "twice"}


def die(how):
    sandbox.at("the seventh question")
    os.kill(os.getpid(), getattr(signal, how))


def refuse():
    raise ZeroDivisionError("no pairs")


def sleep():
    sandbox.at("a long one")
    time.sleep(60.0)


def run(function, limit_s=20.0, **arguments):
    return sandbox.run(f"test_sandbox:{function}", arguments, limit_s, 500)


def test_a_result_comes_back_with_its_arrays():
    found = run("doubled", row=[1.0, np.inf])
    assert found["said"] == "twice"
    assert found["row"].tolist() == [2.0, np.inf]


def test_a_crash_says_how_and_where():
    assert run("die", how="SIGSEGV") == {ENDED: "the process was ended by SIGSEGV; it was at the seventh question"}


def test_an_exception_is_told_in_its_own_words():
    assert "ZeroDivisionError: no pairs" in run("refuse")[ENDED]


def test_a_hang_is_ended():
    assert run("sleep", limit_s=3.0) == {ENDED: "not finished after 3 s; it was at a long one"}


def test_word_is_left_only_in_such_a_process(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    sandbox.at("nowhere")
    assert not list(tmp_path.iterdir())


def test_a_job_changes_with_what_it_calls_and_with_its_limits():
    one = sandbox.job("x", "evalkit.commands.validate.probes:rules", {"name": "paper"}, LIMITS, ())
    assert one.key != sandbox.job("x", "evalkit.commands.validate.probes:rules", {"name": "lib"}, LIMITS, ()).key
    limits = {"limit_s": 1.0}
    assert one.key != sandbox.job("x", "evalkit.commands.validate.probes:rules", {"name": "paper"}, limits, ()).key
