"""Foreign code is started only where it can be ended."""

import contextlib
import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

from evalkit.core.errors import NotInstalled
from evalkit.execution import parent_watch, subprocesses


def test_where_nothing_can_be_ended_with_all_it_started_nothing_is_started(tmp_path, monkeypatch):
    parent_watch.required()  # here all is well
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("something was started"))
    with (tmp_path / "output.txt").open("ab") as output, monkeypatch.context() as windows:
        windows.setattr(os, "name", "nt")
        with pytest.raises(NotInstalled, match=r"not supported .* use Linux, macOS, or Linux within Windows \(WSL\)"):
            subprocesses.started("evalkit.execution.worker", tmp_path, output)


ORPHAN = """
import multiprocessing, os, signal, time
from evalkit.execution import parent_watch

def late():
    os.kill(multiprocessing.parent_process().pid, signal.SIGKILL)
    while os.getppid() == multiprocessing.parent_process().pid:
        time.sleep(0.01)
    parent_watch.watch_parent()
    time.sleep(600)

if __name__ == "__main__":
    child = multiprocessing.get_context("spawn").Process(target=late)
    child.start()
    print(child.pid, flush=True)
    child.join()
"""


def test_who_looks_for_its_parent_only_after_that_was_killed_ends_as_well(tmp_path):
    (tmp_path / "orphan.py").write_text(ORPHAN)
    said = tmp_path / "said"
    with said.open("wb") as out:  # no pipe: the orphan would hold it
        subprocess.run([sys.executable, tmp_path / "orphan.py"], stdout=out, check=False)
    orphan = int(said.read_text())
    try:
        until = time.monotonic() + 30.0
        while _lives(orphan) and time.monotonic() < until:
            time.sleep(0.05)
        assert not _lives(orphan)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(orphan, signal.SIGKILL)


def _lives(number):
    try:
        return psutil.Process(number).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
