"""``make bench``: no script that fails stops the others, and each figure is set beside its aim."""

import importlib.util
import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from evalkit import Pose
from evalkit.commands.diff.benchmark import FOLDER, Benchmark, BenchmarkSeries, load_benchmarks
from evalkit_baselines.embedded.compiled import compiled_missing

HERE = Path(__file__).parent


def load_script(name):
    spec = importlib.util.spec_from_file_location(f"evalkit_bench_{name}", HERE / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def run():
    return load_script("run")


WRITES = """
from evalkit.commands.diff.benchmark import BenchmarkSeries, write_benchmark
ran_on = {"absent peer karto": "not installed", "load before": "0.25"}
write_benchmark("later", [BenchmarkSeries("a call", "ms", (1.0, 3.0, 2.0))], ran_on)
"""


def test_a_script_that_fails_stops_no_other_and_ends_with_1(run, tmp_path, monkeypatch, capsys):
    (tmp_path / "first.py").write_text("raise SystemExit('limit missed')")
    (tmp_path / "later.py").write_text(WRITES)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run, "HERE", tmp_path)
    monkeypatch.setattr(run, "SCRIPTS", ("first", "later"))
    monkeypatch.setattr(
        run, "AIMS", (run.Aim("later", "a call", 2.0), run.Aim("first", "a call", 1.0), run.Aim("later", "b", math.nan))
    )
    monkeypatch.setattr(sys, "argv", ["run.py"])
    assert run.main() == 1
    out = capsys.readouterr().out
    for text in (
        "first failed: it wrote no measurement",
        "later: karto was not measured: not installed",
        "1 of 2 aims met",
    ):
        assert text in out
    assert re.search(r"; load before 0\.25, after (\d|unknown)", out)


@pytest.mark.parametrize(
    ("aim", "found", "quartiles", "wanted", "verdict"),
    [
        (("b", "ours", 2.0), "2 ms", "1.5 - 2.5", "<= 2", "met"),
        (("b", "ours", 1.9), "2 ms", "1.5 - 2.5", "<= 1.9", "missed"),
        (("b", "ours", 2.9, "", False, 95.0), "2.9 ms", "", "<= 2.9", "met"),
        (("b", "theirs", 5.0, "ours"), "5 x", "5 - 5", ">= 5 x", "met"),
        (("b", "theirs", 4.0, "ours", True), "5 x", "5 - 5", "<= 4 x", "missed"),
        (("b", "ours", math.nan), "2 ms", "1.5 - 2.5", "", "no aim"),
        (("b", "absent", 1.0), "", "", "1", "not measured"),
        (("b", "absent", math.nan), "", "", "", "not measured"),
    ],
)
def test_figures_beside_their_aims_are_those_computed_by_hand(run, aim, found, quartiles, wanted, verdict):
    """Ours 1, 2, 3 ms: median 2, 95 % below 2.9; theirs 10 ms: five times ours."""
    series = (BenchmarkSeries("ours", "ms", (1.0, 3.0, 2.0)), BenchmarkSeries("theirs", "ms", (10.0,)))
    line = run.row(run.Aim(*aim), {"b": Benchmark("b", series)})
    assert line[1:] == (found, quartiles, wanted, verdict)


@pytest.mark.skipif(bool(compiled_missing()), reason="the core is not built")
def test_a_broken_library_takes_away_its_own_rows_only(monkeypatch):
    registration = load_script("registration")

    def broken(_asked):
        raise ImportError("x")

    monkeypatch.setattr(registration, "PEERS", {"numpy": broken, "no_such_module": broken})
    monkeypatch.setattr(registration, "SCANS", 2)
    cloud = np.random.default_rng(0).uniform(-1.0, 1.0, (60, 2))
    asked = registration.Questions(cloud, [cloud, cloud], [Pose(0.01, 0.0, 0.0)] * 2)
    calls, absent = registration.methods(asked)
    assert absent == {"numpy": "broken: ImportError: x", "no_such_module": "not installed"}
    assert {"embedded", "embedded + table", "embedded + index", "paper (NumPy)"} <= set(calls)
    for taken in registration.measure_ns(calls, 3, 2).values():
        assert taken.shape == (6,)
        assert (taken > 0.0).all()


def test_every_method_registers_the_same_scans_in_turn_or_in_a_row(monkeypatch):
    registration = load_script("registration")
    monkeypatch.setattr(registration, "SCANS", 3)
    asked = []
    calls = {name: lambda k, name=name: asked.append((name, k)) for name in ("one", "two")}
    registration.measure_ns(calls, 3, 1)
    assert asked == [("two", 0), ("one", 0), ("one", 1), ("two", 1), ("two", 2), ("one", 2)]
    asked.clear()
    registration.measure_ns(calls, 1, 3)
    assert asked == [("two", 0), ("two", 1), ("two", 2), ("one", 0), ("one", 1), ("one", 2)]


@pytest.mark.skipif(bool(compiled_missing()), reason="the core is not built")
def test_the_benchmark_of_normals_writes_a_sample_a_round(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(HERE))
    normals = load_script("normals")
    cloud = np.random.default_rng(0).uniform(-1.0, 1.0, (60, 2))
    monkeypatch.setattr(normals.registration, "questions", lambda _: normals.registration.Questions(cloud, [], []))
    monkeypatch.setattr(sys, "argv", ["normals.py", "--rounds", "3", "--targets", "60"])
    monkeypatch.chdir(tmp_path)
    normals.main()
    found = load_benchmarks(tmp_path / FOLDER / "normals.json")["normals"]
    assert {one.name: len(one.samples) for one in found.series} == {"core, 60 points": 3, "NumPy, 60 points": 3}


def test_the_commands_that_are_timed_run():
    assert load_script("overhead").commands(0) == {"--version": [], "list": []}


def test_each_aim_is_of_a_script_that_is_run(run):
    assert {aim.benchmark for aim in run.AIMS} == set(run.SCRIPTS)
    assert all((HERE / f"{name}.py").exists() for name in run.SCRIPTS)
