"""The description of the machine in a report."""

import os
import re
import shutil
import subprocess
import tomllib
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import psutil
import pytest

import evalkit
from evalkit.core.run_result import NO_STEPS, RunResult
from evalkit.core.run_status import Cause
from evalkit.execution import environment

CHECKOUT = Path(evalkit.__file__).parent.parent


def test_the_description_contains_machine_and_software():
    told = environment.describe(("numpy", "no-such-library"))
    assert list(told)[:5] == ["evalkit", "commit", "python", "system", "processor"]
    assert told["evalkit"] == evalkit.__version__
    assert told["numpy"] == version("numpy")
    assert told["no-such-library"] == "not installed"
    assert f"{psutil.cpu_count()} logical" in told["cores"]
    assert all(isinstance(text, str) and text for text in told.values())


def test_the_version_is_written_in_one_file_and_is_that_of_the_installed_package():
    assert evalkit.__version__ == version("evalkit")
    content = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))
    assert content["project"]["dynamic"] == ["version"]
    assert content["tool"]["scikit-build"]["metadata"]["version"]["input"] == "evalkit/__init__.py"


def test_the_commit_is_that_of_the_checkout_and_marks_changes():
    if shutil.which("git") is None or not (CHECKOUT / ".git").exists():
        pytest.skip("not a checkout, or no git")
    head = subprocess.run(["git", "-C", CHECKOUT, "rev-parse", "HEAD"], capture_output=True, text=True, check=False)
    if head.returncode:
        pytest.skip(f"git does not read this checkout: {head.stderr.strip()}")
    changed = subprocess.run(["git", "-C", CHECKOUT, "diff", "--quiet", "HEAD"], check=False).returncode != 0
    told = environment.describe()["commit"]
    assert head.stdout.startswith(told.removesuffix("-dirty").rpartition("-g")[2])
    assert told.endswith("-dirty") == changed


def test_an_installed_package_has_no_commit(tmp_path, monkeypatch):
    monkeypatch.setattr(environment, "__file__", str(tmp_path / "evalkit" / "execution" / "environment.py"))
    assert environment.describe()["commit"] == "none (installed package)"


def test_a_checkout_without_git_is_described(tmp_path, monkeypatch):
    (tmp_path / ".git").mkdir()
    monkeypatch.setattr(environment, "__file__", str(tmp_path / "evalkit" / "execution" / "environment.py"))
    monkeypatch.setenv("PATH", str(tmp_path))
    assert environment.describe()["commit"] == "unknown (git is not installed)"


def test_a_timed_process_has_one_thread_in_every_pool():
    assert set(environment.SINGLE_THREAD.values()) == {"1"}
    assert {"OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"} <= set(environment.SINGLE_THREAD)


def test_the_name_of_the_machine_is_replaced_where_one_is_given(monkeypatch):
    monkeypatch.setattr(environment.platform, "node", lambda: "lab-7")
    monkeypatch.delenv("EVALKIT_HOST", raising=False)
    assert environment.describe()["host"] == "lab-7"
    monkeypatch.setenv("EVALKIT_HOST", "desktop")
    assert environment.describe()["host"] == "desktop"
    assert "lab-7" not in str(environment.describe())
    monkeypatch.setenv("EVALKIT_HOST", os.fsdecode(b"a\xff\x1b[31m"))  # neither UTF-8 nor fit for a terminal
    assert environment.describe()["host"] == r"a\udcff\x1b[31m"
    sources = [path.read_text() for path in (CHECKOUT / "evalkit").rglob("*.py")]
    assert sum(len(re.findall(r"platform\.node|gethostname|os\.uname", source)) for source in sources) == 1


def test_the_number_of_runs_at_a_time_is_described_where_known():
    assert environment.describe(jobs=3)["runs at a time"] == "3"
    assert "runs at a time" not in environment.describe()


def executed(day, commit="c", **changes):
    where = {"host": "h", "processor": "P", "governor": "g", **changes}
    return RunResult(
        NO_STEPS, 0, provenance={"executed_at": f"2024-05-{day:02d}T12:00:00+00:00", "commit": commit, **where}
    )


NOON = datetime(2024, 5, 9, 12, tzinfo=UTC)


def test_earlier_runs_are_described_in_one_line():
    def make_earlier(*results):
        return environment.describe_provenance({}, results, NOON).get("earlier runs")

    assert make_earlier(executed(9), executed(10)) is None
    line = "2 runs, executed 2024-05-01 12:00..2024-05-03 12:00 UTC, commit a and b, processor P"
    assert make_earlier(executed(3, "b"), executed(1, "a"), executed(9)) == line
    assert ", executed 2024-05-01 12:00 UTC, " in make_earlier(executed(1, "a"))
    assert (
        make_earlier(RunResult(NO_STEPS, 0)) == "1 run, executed at an unknown time, commit unknown, processor unknown"
    )
    assert make_earlier(RunResult(NO_STEPS, 0, Cause.NOT_RUN, "not run yet")) is None


def test_several_machines_are_described_in_one_line():
    results = [executed(9), executed(9, host="x", governor="fast"), executed(9)]
    lines = environment.describe_provenance({"host": "here"}, results, NOON)
    assert lines == {"host": "here", "executed on": "2 runs on h (P, governor g); 1 run on x (P, governor fast)"}


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="this system cannot pin")
def test_cores_are_one_of_each_physical_core_before_the_second_of_any(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3, 4})
    monkeypatch.setattr(environment, "_read_siblings", lambda cpu: f"{cpu // 2}")
    monkeypatch.setattr(psutil, "cpu_count", lambda logical=True: 6 if logical else 3)
    assert environment.cores() == [0, 2, 4, 1, 3]
    assert environment.physical_cores() == 3
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {2, 3})
    assert environment.physical_cores() == 1


def test_a_library_from_a_distribution_of_another_name_has_its_version(monkeypatch):
    """open3d-cpu provides the module open3d."""
    known = {"open3d-cpu": "0.19.0"}

    def find(name):
        if name not in known:
            raise environment.PackageNotFoundError(name)
        return known[name]

    monkeypatch.setattr(environment, "version", find)
    monkeypatch.setattr(environment, "packages_distributions", lambda: {"open3d": ["open3d-cpu", "open3d-cpu"]})
    assert environment.versions(["open3d", "open3d-cpu", "kiss-icp"]) == {
        "open3d": "0.19.0 (open3d-cpu)", "open3d-cpu": "0.19.0", "kiss-icp": "not installed",
    }  # fmt: skip


def test_the_origin_of_a_file_is_the_command_that_wrote_it(monkeypatch):
    monkeypatch.setattr("sys.argv", ["/somewhere/__main__.py", "a file.toml", "--seeds", "3"])
    origin = environment.describe_origin("package.module")
    assert origin["command"] == "python -m package.module 'a file.toml' --seeds 3"
    assert list(origin["versions"]) == ["evalkit", "numpy", "scipy"]
