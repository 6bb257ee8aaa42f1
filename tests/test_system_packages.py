"""The script that installs system packages, with a pretended system."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[1] / ".ci" / "system-packages"
LIBRARIES = "libGL.so.1 libEGL.so.1 libX11.so.6 libusb-1.0.so.0 libgomp.so.1"

pytestmark = [
    pytest.mark.checkout,
    pytest.mark.skipif(sys.platform != "linux", reason="the script installs packages on Linux only"),
]


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run the script with the given programs (name: shell commands) before all others; returns the completed run."""
    monkeypatch.delenv("EVALKIT_OFFLINE", raising=False)

    def start(*parts, **programs):
        pretended = {
            "uname": "echo Linux",
            "apt-get": f'echo "$@" >> {tmp_path}/log',
            "chromium-headless-shell": "",
            **programs,
        }
        for name, commands in pretended.items():
            program = tmp_path / name.replace("_", "-")
            program.write_text(f"#!/bin/sh\n{commands}\n")
            program.chmod(0o755)
        environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
        found = subprocess.run([SCRIPT, *parts], env=environment, capture_output=True, text=True, check=False)
        log = tmp_path / "log"
        return found, log.read_text() if log.exists() else ""

    return start


def test_root_installs_what_is_missing_and_says_so(run):
    found, log = run("open3d", "browser", ldconfig="echo libusb-1.0.so.0 libX11.so.6 libgomp.so.1", id="echo 0")
    assert found.stdout == "installing system packages: libgl1 libegl1\n"
    assert log == "update -qq\ninstall -y --no-install-recommends libgl1 libegl1 -qq\n"
    assert found.returncode == 0


def test_without_rights_the_command_is_printed_and_nothing_is_installed(run):
    found, log = run("open3d", ldconfig=f"echo {LIBRARIES.replace('libusb', '')}", id="echo 1000", sudo="exit 1")
    assert found.stdout.endswith("to install: sudo apt-get install -y --no-install-recommends libusb-1.0-0\n")
    assert (log, found.returncode) == ("", 0)


def test_a_complete_system_is_left_alone(run):
    found, log = run("open3d", "browser", ldconfig=f"echo {LIBRARIES}", id="echo 0")
    assert (found.stdout, found.stderr, log, found.returncode) == ("", "", "", 0)


def test_a_failed_installation_does_not_stop_the_report(run):
    found, _ = run("open3d", ldconfig="", id="echo 0", **{"apt-get": "exit 100"})
    assert "not installed; install them yourself: apt-get install" in found.stdout
    assert found.returncode == 0


def test_an_unknown_part_ends_with_2_and_the_description_of_the_script(run):
    found, log = run("open3d", "printer", id="echo 0")
    assert (found.returncode, found.stdout, log) == (2, "", "")
    assert found.stderr.startswith("Install the system packages that parts of evalkit need:")
    assert found.stderr.endswith("An unknown part ends it with 2.\n")


@pytest.mark.parametrize("target", ["report", "report-quick"])
def test_a_report_installs_and_fetches_what_it_needs_first(target):
    done = subprocess.run(["make", "-n", target], cwd=SCRIPT.parents[1], capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    system, fetched, compared = (
        next(at for at, line in enumerate(lines) if part in line)
        for part in (".ci/system-packages open3d", "datasets fetch --for reports/", "evalkit compare reports/")
    )
    assert system < fetched < compared
