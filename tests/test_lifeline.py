"""Foreign code is started only where it can be ended."""

import os
import subprocess

import pytest

from evalkit import child, lifeline
from evalkit.errors import NotInstalled


def test_where_nothing_can_be_ended_with_all_it_started_nothing_is_started(tmp_path, monkeypatch):
    lifeline.required()  # here all is well
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("something was started"))
    with (tmp_path / "output.txt").open("ab") as output, monkeypatch.context() as windows:
        windows.setattr(os, "name", "nt")
        with pytest.raises(NotInstalled, match=r"not supported .* use Linux, macOS, or Linux within Windows \(WSL\)"):
            child.started("evalkit.worker", tmp_path, output)
