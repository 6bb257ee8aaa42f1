"""Benchmarks kept, read back and compared."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from evalkit.cli import app
from evalkit.commands.diff import benchmark
from evalkit.commands.diff.benchmark import Benchmark, Series
from evalkit.commands.diff.benchmark_comparison import compared, enough
from evalkit.core.errors import BadData

RAN_ON = {"processor": "one", "governor": "performance"}


def samples(middle, count=30, seed=0):
    return tuple((middle * np.random.default_rng(seed).normal(1.0, 0.02, count)).tolist())


def made(values, processor="one", name="speed"):
    return {name: Benchmark(name, (Series("call", "ms", values),), {"processor": processor})}


def said(old, new, limit=0.1):
    (change,) = compared(made(old), made(new), limit).changes
    return change.said


def test_what_is_kept_is_read_back(tmp_path):
    series = [Series("call", "ms", (1.0, 3.0, 2.0)), Series("other", "us", (0.5,))]
    path = benchmark.keep("speed", series, RAN_ON, tmp_path)
    found = benchmark.read(path)
    assert found == benchmark.read(tmp_path)
    assert found["speed"].series == tuple(series)
    assert (found["speed"].processor, found["speed"].environment["governor"]) == ("one", "performance")
    assert json.loads(path.read_text())["series"][0]["median"] == 2.0


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("nothing", "no JSON"),
        ("[]", "'schema'"),
        ('{"schema": 2}', "2, expected 1"),
        ('{"schema": 1, "name": "a"}', "no benchmark"),
        (
            '{"schema": 1, "name": "a", "made": "", "environment": {}, '
            '"series": [{"name": "b", "unit": "s", "samples": [NaN]}]}',
            "not finite",
        ),
        (
            '{"schema": 1, "name": "a", "made": "", "environment": {}, '
            f'"series": [{{"name": "b", "unit": "s", "samples": [1{"0" * 400}]}}]}}',
            "no benchmark",
        ),
    ],
)
def test_what_is_no_benchmark_says_so(tmp_path, content, told):
    (tmp_path / "bad.json").write_text(content)
    with pytest.raises(BadData, match=told):
        benchmark.read(tmp_path)


def test_one_benchmark_in_two_files_of_a_folder_is_refused(tmp_path):
    path = benchmark.keep("speed", [Series("call", "ms", (1.0,))], RAN_ON, tmp_path)
    path.with_name("before.json").write_text(path.read_text())
    with pytest.raises(BadData, match="several files in it hold the benchmark speed"):
        benchmark.read(tmp_path)


def test_a_folder_without_benchmarks_says_how_to_make_one(tmp_path):
    with pytest.raises(BadData, match="make bench"):
        benchmark.read(tmp_path)


def test_slower_beyond_the_limit_is_a_regression_and_faster_an_improvement():
    assert said(samples(1.0), samples(1.3, seed=1)) == "regression"
    assert said(samples(1.3), samples(1.0, seed=1)) == "improvement"
    assert said(samples(1.0), samples(1.3, seed=1), limit=0.5) == "within the limit"


def test_a_small_sure_change_is_within_the_limit_and_noise_is_no_difference():
    assert said(samples(1.0), samples(1.05, seed=1)) == "within the limit"
    assert said(samples(1.0), samples(1.0, seed=1)) == "no difference shown"


def test_the_ratio_lies_within_its_interval_and_near_the_truth():
    (change,) = compared(made(samples(2.0)), made(samples(3.0, seed=1)), 0.1).changes
    assert change.low < change.ratio < change.high
    assert change.ratio == pytest.approx(1.5, abs=0.02)
    assert change.low > 1.45


def test_too_few_samples_tell_nothing_however_large_the_change():
    """Of six and six complete separation has p = 2 / 924, of seven and six 2 / 1716."""
    assert not enough(6, 6)
    assert enough(7, 6)
    assert enough(5000, 5000)
    assert said((1.0,) * 3, (9.0,) * 3) == "too few samples"


def test_other_processors_are_refused_unless_asked_for():
    old, new = made(samples(1.0)), made(samples(1.5), "another")
    with pytest.raises(BadData, match=r"'one' and on 'another'.*--across-machines"):
        compared(old, new, 0.1)
    assert compared(old, new, 0.1, across_machines=True).regressions == 1


def test_what_one_side_alone_has_is_named():
    found = compared(made(samples(1.0), name="a"), made(samples(1.0), name="b"), 0.1)
    assert found.changes == ()
    assert found.apart == ("a: not measured in the new one", "b: not measured in the old one")


@pytest.mark.parametrize(("middle", "code"), [(1.0, 0), (2.0, 1)])
def test_the_command_ends_with_one_where_something_became_slower(tmp_path, middle, code):
    old = benchmark.keep("speed", [Series("a|b", "ms", samples(1.0))], RAN_ON, tmp_path / "old")
    benchmark.keep("speed", [Series("a|b", "ms", samples(middle, seed=1))], RAN_ON, tmp_path / "new")
    arguments = ["diff", str(old), str(tmp_path / "new")]
    assert CliRunner().invoke(app, arguments).exit_code == code
    told = CliRunner().invoke(app, [*arguments, "--markdown"])
    assert told.exit_code == code
    assert "| speed | a/b | 0.9974 ms |" in told.stdout
    assert json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)["regressions"] == code
