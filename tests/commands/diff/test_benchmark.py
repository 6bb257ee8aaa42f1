"""Benchmark files: written, loaded and compared."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from evalkit.cli import app
from evalkit.commands.diff.benchmark import Benchmark, BenchmarkSeries, load_benchmarks, write_benchmark
from evalkit.commands.diff.benchmark_changes import can_show_difference, compare_benchmarks, describe_benchmark_diff
from evalkit.core.errors import BadData

RAN_ON = {"processor": "one", "governor": "performance"}


def samples(middle, count=30, seed=0):
    return tuple((middle * np.random.default_rng(seed).normal(1.0, 0.02, count)).tolist())


def make_benchmark(values, processor="one", name="speed"):
    return {name: Benchmark(name, (BenchmarkSeries("call", "ms", values),), {"processor": processor})}


def compute_verdict(old, new, limit=0.1):
    (change,) = compare_benchmarks(make_benchmark(old), make_benchmark(new), limit).changes
    return change.verdict


def test_a_written_benchmark_is_loaded_unchanged(tmp_path):
    series = [BenchmarkSeries("call", "ms", (1.0, 3.0, 2.0)), BenchmarkSeries("other", "us", (0.5,))]
    path = write_benchmark("speed", series, RAN_ON, tmp_path)
    found = load_benchmarks(path)
    assert found == load_benchmarks(tmp_path)
    assert found["speed"].series == tuple(series)
    assert (found["speed"].processor, found["speed"].environment["governor"]) == ("one", "performance")
    written, single = json.loads(path.read_text())["series"]
    assert (written["median"], written["quartiles"]) == (2.0, [1.5, 2.5])
    assert single["quartiles"] == [0.5, 0.5]


def test_a_table_of_changes_states_medians_ratio_and_verdict_and_leaves_out_what_did_not_change():
    same, few, later = samples(1.0), (1.0, 1.1, 1.2), (9.0, 9.1, 9.2)
    old = make_benchmark(same) | make_benchmark(few, name="start") | make_benchmark(same, name="end")
    new = make_benchmark(samples(2.0)) | make_benchmark(later, name="start") | make_benchmark(same, name="end")
    compared = compare_benchmarks(old, new, 0.1)
    shown = describe_benchmark_diff(compared)
    assert [(row[0], row[4], row[-1]) for row in shown.rows] == [
        ("speed", "2.000", "❌ regression"),
        ("start", "8.273", "too few samples (3 and 3)"),
    ]
    assert shown.conclusion.startswith("1 of 3 series became worse beyond 10 %")
    assert [row[0] for row in describe_benchmark_diff(compared, everything=True).rows] == ["speed", "end", "start"]


@pytest.mark.parametrize(
    ("content", "shown"),
    [
        ("nothing", "no JSON"),
        ("[]", "'schema'"),
        ('{"schema": 1}', "1, expected 3"),
        ('{"schema": 3, "name": "a"}', "no benchmark"),
        (
            '{"schema": 3, "name": "a", "written": "", "environment": {}, '
            '"series": [{"name": "b", "unit": "s", "samples": [NaN]}]}',
            "not finite",
        ),
        (
            '{"schema": 3, "name": "a", "written": "", "environment": {}, '
            f'"series": [{{"name": "b", "unit": "s", "samples": [1{"0" * 400}]}}]}}',
            "no benchmark",
        ),
    ],
)
def test_a_file_that_is_not_a_benchmark_is_rejected(tmp_path, content, shown):
    (tmp_path / "bad.json").write_text(content)
    with pytest.raises(BadData, match=shown):
        load_benchmarks(tmp_path)


def test_one_benchmark_in_two_files_of_a_folder_is_rejected(tmp_path):
    path = write_benchmark("speed", [BenchmarkSeries("call", "ms", (1.0,))], RAN_ON, tmp_path)
    path.with_name("before.json").write_text(path.read_text())
    with pytest.raises(BadData, match="several files in it hold the benchmark speed"):
        load_benchmarks(tmp_path)


def test_a_folder_without_benchmarks_is_reported_with_a_remedy(tmp_path):
    with pytest.raises(BadData, match="make bench"):
        load_benchmarks(tmp_path)


def test_slower_beyond_the_limit_is_a_regression_and_faster_an_improvement():
    assert compute_verdict(samples(1.0), samples(1.3, seed=1)) == "regression"
    assert compute_verdict(samples(1.3), samples(1.0, seed=1)) == "improvement"
    assert compute_verdict(samples(1.0), samples(1.3, seed=1), limit=0.5) == "within the limit"


def test_a_small_significant_change_is_within_the_limit_and_noise_is_no_difference():
    assert compute_verdict(samples(1.0), samples(1.05, seed=1)) == "within the limit"
    assert compute_verdict(samples(1.0), samples(1.0, seed=1)) == "no difference shown"


def test_the_ratio_is_within_its_interval_and_near_the_true_value():
    (change,) = compare_benchmarks(make_benchmark(samples(2.0)), make_benchmark(samples(3.0, seed=1)), 0.1).changes
    assert change.low < change.ratio < change.high
    assert change.ratio == pytest.approx(1.5, abs=0.02)
    assert change.low > 1.45


def test_too_few_samples_are_never_significant():
    """Complete separation of six and six has p = 2 / 924, of seven and six p = 2 / 1716."""
    assert not can_show_difference(6, 6)
    assert can_show_difference(7, 6)
    assert can_show_difference(5000, 5000)
    assert compute_verdict((1.0,) * 3, (9.0,) * 3) == "too few samples"


def test_benchmarks_of_different_processors_are_rejected_by_default():
    old, new = make_benchmark(samples(1.0)), make_benchmark(samples(1.5), "another")
    with pytest.raises(BadData, match=r"'one' and on 'another'.*--across-machines"):
        compare_benchmarks(old, new, 0.1)
    assert compare_benchmarks(old, new, 0.1, across_machines=True).regressions == 1


def test_benchmarks_on_one_side_only_are_named():
    found = compare_benchmarks(make_benchmark(samples(1.0), name="a"), make_benchmark(samples(1.0), name="b"), 0.1)
    assert found.changes == ()
    assert found.remarks == ("a: not in the new measurement", "b: not in the old measurement")
    assert found.missing == 1


def test_a_series_that_the_new_measurement_lacks_fails_unless_it_is_allowed(tmp_path):
    """A benchmark script that ended early must not pass as one that became no slower."""
    kept, gone = (BenchmarkSeries(name, "ms", samples(1.0)) for name in ("kept", "gone"))
    both, one = (
        str(write_benchmark("speed", series, RAN_ON, tmp_path / name))
        for name, series in (("both", [kept, gone]), ("one", [kept]))
    )
    shown = CliRunner().invoke(app, ["diff", both, one])
    assert (shown.exit_code, "--allow-missing" in shown.stderr) == (1, True)
    assert "1 series of the old measurement has no counterpart in the new one. No regression" in shown.stdout
    assert json.loads(CliRunner().invoke(app, ["diff", both, one, "--json"]).stdout)["missing"] == 1
    assert CliRunner().invoke(app, ["diff", both, one, "--allow-missing"]).exit_code == 0
    assert CliRunner().invoke(app, ["diff", one, both]).exit_code == 0


@pytest.mark.parametrize("option", ["--limit-ate", "--limit-time"])
def test_a_limit_of_results_is_a_usage_error_between_benchmarks(tmp_path, option):
    path = str(write_benchmark("speed", [BenchmarkSeries("call", "ms", (1.0,))], RAN_ON, tmp_path))
    shown = CliRunner().invoke(app, ["diff", path, path, option, "5%"])
    assert (shown.exit_code, f"{option} is for results folders" in shown.stderr) == (2, True)


@pytest.mark.parametrize(("middle", "code"), [(1.0, 0), (2.0, 1)])
def test_the_command_exits_with_1_if_something_became_slower(tmp_path, middle, code):
    old = write_benchmark("speed", [BenchmarkSeries("a|b", "ms", samples(1.0))], RAN_ON, tmp_path / "old")
    write_benchmark("speed", [BenchmarkSeries("a|b", "ms", samples(middle, seed=1))], RAN_ON, tmp_path / "new")
    arguments = ["diff", str(old), str(tmp_path / "new")]
    assert CliRunner().invoke(app, arguments).exit_code == code
    shown = CliRunner().invoke(app, [*arguments, "--markdown"])
    assert shown.exit_code == code
    assert ("| speed | a/b | 0.9974 ms |" in shown.stdout) == bool(code)
    assert json.loads(CliRunner().invoke(app, [*arguments, "--json"]).stdout)["regressions"] == code


def test_unchanged_series_are_counted_and_listed_only_with_all(tmp_path):
    series = [BenchmarkSeries("same", "ms", samples(1.0)), BenchmarkSeries("slower", "ms", samples(1.0))]
    changed = [series[0], BenchmarkSeries("slower", "ms", samples(2.0, seed=1))]
    arguments = ["diff", *(str(write_benchmark("speed", each, RAN_ON, tmp_path / name))
                           for name, each in (("old", series), ("new", changed)))]  # fmt: skip
    short, long = (CliRunner().invoke(app, [*arguments, *more]).stdout for more in ([], ["--all"]))
    assert [" same " in text for text in (short, long)] == [False, True]
    assert [" slower " in text for text in (short, long)] == [True, True]
    assert "1 of 2 series show no difference or are within the limit" in " ".join(short.split())


def test_two_benchmarks_with_nothing_in_common_are_an_error_and_no_agreement(tmp_path):
    one, other = (
        str(write_benchmark(name, [BenchmarkSeries("call", "ms", samples(1.0))], RAN_ON, tmp_path))
        for name in ("normals", "mapper")
    )
    answer = CliRunner().invoke(app, ["diff", one, other])
    assert isinstance(answer.exception, BadData)
    assert f"nothing was compared: no series is in both (normals in {one}; mapper in {other})" in str(answer.exception)
