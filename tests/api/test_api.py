"""The Python API gives the numbers of the report, and says what it needs."""

import importlib
import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import evalkit
from evalkit.api import functions
from evalkit.cli import app
from evalkit.config.experiment_file import experiment_from_tables
from evalkit.core.errors import BadParameter, NotInstalled, StoreError, UnknownName
from evalkit.plugins import registry
from evalkit.plugins.specs import spec_of_class

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def results(tmp_path_factory, scoring_in_threads):
    """Two methods on two seeds of a short drive."""
    table = {
        "title": "two <methods>",
        "method": [{"use": "wheel-odometry"}, {"use": "embedded", "label": "core", "max_iterations": 6}],
        "sequence": [{"use": "room", "laps": 0.02, "seeds": [0, 1]}],
        "mapper": {"scans": 10},
    }
    experiment = experiment_from_tables(table, "here", "two", "compare two.toml")
    return evalkit.run(experiment, tmp_path_factory.mktemp("two"))


def test_tables_hold_the_values_of_the_report_with_their_units(results):
    assert (results.methods, results.sequences) == (("wheel-odometry", "core"), ("room",))
    scores, summary = results.scores(), results.summary()
    assert scores.attrs["units"]["ate_rmse_m"] == summary.attrs["units"]["ate_rmse_m"] == "m"
    own = [run for run in results.content["runs"] if run["method"] == "core"]
    expected = [run["scores"]["ate_rmse_m"]["value"] for run in own]
    assert list(scores[scores["method"] == "core"]["ate_rmse_m"]) == expected
    row = summary[(summary["method"] == "core") & (summary["metric"] == "ate_rmse_m")].iloc[0]
    assert row["median"] == pytest.approx(sum(expected) / 2)


def test_a_trajectory_starts_at_the_identity_and_is_aligned_by_a_rigid_motion(results):
    raw, aligned = results.trajectory("core"), results.trajectory("core", aligned=True)
    assert (raw.parent, aligned.parent) == ("start", "world")
    np.testing.assert_array_equal(raw.poses[0], np.zeros(3))
    np.testing.assert_array_equal(raw.stamps_ns, aligned.stamps_ns)
    assert aligned.path_m == pytest.approx(raw.path_m)
    other = results.trajectory("core", "room", seed=1)
    assert not np.array_equal(other.poses, raw.poses)
    (run,) = [one for one in results.content["runs"] if (one["method"], one["seed"]) == ("core", 0)]
    assert len(raw) == run["scans_answered"]


def test_a_map_is_the_stored_grid(results):
    (run,) = [one for one in results.content["runs"] if (one["method"], one["seed"]) == ("core", 1)]
    grid = results.map("core", seed=1)
    lines = (results.folder / "maps" / f"{run['key']}.pgm").read_bytes().split(b"\n")
    assert f"{grid.shape[1]} {grid.shape[0]}".encode() in lines


def test_figures_show_every_method_and_can_be_restyled(results):
    dots = results.plot.dots("ate_rmse_m")
    assert [text.get_text() for text in dots.axes[0].get_yticklabels()] == ["wheel-odometry", "core"]
    assert dots.axes[0].get_xlabel() == "ate_rmse_m [m]"
    assert [axes.get_title() for axes in results.plot.maps().axes] == ["wheel-odometry", "core"]
    lines = results.plot.error_time().axes[0].lines
    core = next(line for line in lines if line.get_label() == "core")
    run = next(one for one in results.content["runs"] if (one["method"], one["seed"]) == ("core", 0))
    rms = float(np.sqrt(np.nanmean(np.square(core.get_ydata()))))
    assert rms == pytest.approx(run["scores"]["ate_rmse_m"]["value"], rel=1e-6)
    with pytest.raises(UnknownName, match="no metric named 'ate'"):
        results.plot.dots("ate")


def test_a_notebook_shows_escaped_text_and_the_page_can_be_copied(results, tmp_path):
    assert "two &lt;methods&gt;" in results._repr_html_()
    copy = results.to_html(tmp_path / "page.html")
    assert copy.read_bytes() == results.to_html().read_bytes()
    assert evalkit.load(results.folder).content == results.content


def test_a_page_that_is_a_link_is_not_copied_and_a_link_at_the_copy_is_replaced(results, tmp_path):
    folder = shutil.copytree(results.folder, tmp_path / "received")
    secret = tmp_path / "secret"
    secret.write_text("mine", encoding="utf-8")
    (tmp_path / "page.html").symlink_to(secret)
    received = evalkit.load(folder)
    received.to_html(tmp_path / "page.html")
    assert (secret.read_text(encoding="utf-8"), (tmp_path / "page.html").is_symlink()) == ("mine", False)
    (folder / "index.html").unlink()
    (folder / "index.html").symlink_to(secret)
    with pytest.raises(StoreError, match=r"index\.html: cannot be copied"):
        received.to_html(tmp_path / "other.html")
    assert not (tmp_path / "other.html").exists()


def test_a_limit_is_required_of_every_run(results):
    values = [run["scores"]["ate_rmse_m"]["value"] for run in results.content["runs"] if run["method"] == "core"]
    results.require("ate_rmse_m", "core", below=1.01 * max(values))
    with pytest.raises(AssertionError, match=rf"below {min(values):.3g}") as error:
        results.require("ate_rmse_m", "core", below=min(values))
    assert str(error.value).count("room-s") == 2
    with pytest.raises(AssertionError, match="no value"):
        results.require("relations_all_mean_m", "core", below=1.0)
    with pytest.raises(UnknownName, match="did you mean 'core'"):
        results.require("ate_rmse_m", "cor", below=1.0)


def test_unknown_names_and_folders_are_named(results, tmp_path):
    with pytest.raises(UnknownName, match="no seed named '7'; known: 0, 1"):
        results.trajectory("core", seed=7)
    with pytest.raises(UnknownName, match="no sequence named 'hall'"):
        results.map("core", "hall")
    with pytest.raises(StoreError, match="no such file"):
        evalkit.load(tmp_path)


def test_a_table_that_is_not_the_report_s_is_refused(results, tmp_path):
    folder = shutil.copytree(results.folder, tmp_path / "copy")
    copied = evalkit.load(folder)
    for table in ("summary", "runs"):
        path = folder / f"{table}.csv"
        path.write_text(path.read_text(encoding="utf-8").replace("core", "mine"), encoding="utf-8")
    for read in (copied.summary, copied.scores):
        with pytest.raises(StoreError, match="its content does not agree with its checksum"):
            read()


def test_a_pair_of_clouds_is_registered_from_the_guess():
    points = np.random.default_rng(0).uniform(-3.0, 3.0, (300, 2))
    turn = np.array([[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]])
    match = evalkit.register(points @ turn.T + [0.05, -0.02], points, "embedded", guess=(0.04, -0.02, 0.09))
    np.testing.assert_allclose(match.target_from_source.row, [0.05, -0.02, 0.1], atol=1e-9)
    with pytest.raises(BadParameter, match="expected a registration"):
        evalkit.register(points, points, "wheel-odometry")
    with pytest.raises(UnknownName, match="no parameter named 'iterations'"):
        evalkit.register(points, points, "embedded", iterations=3)


class Shift:
    """Move every guess.

    By a distance.
    """

    def register(self, target, source, guess):
        return evalkit.Match(guess @ evalkit.Pose(1.0, 0.0, 0.0), True, 1, 0.0, len(source))


def test_a_class_of_a_module_is_a_method_and_one_of_a_notebook_is_refused():
    spec = spec_of_class(Shift)
    assert (spec.kind, spec.summary, spec.parameters) == ("registration", "Move every guess.", ())
    assert spec_of_class(SimpleNamespace) is None
    match = evalkit.register(np.zeros((3, 2)), np.zeros((3, 2)), Shift, guess=(1.0, 0.0, 0.0))
    assert match.target_from_source.row.tolist() == [2.0, 0.0, 0.0]

    class Correcting:
        update = trajectory = loop_closures = None

    assert [spec.kind for spec in map(spec_of_class, (Correcting, type("One", (), {"update": None}))) if spec] == [
        "slam", "odometry",
    ]  # fmt: skip

    class Local(Shift):
        pass

    with pytest.raises(NotInstalled, match=r"inside a function or a class.*give my_icp.Local"):
        evalkit.register(np.zeros((3, 2)), np.zeros((3, 2)), Local)


def test_importing_the_api_keeps_the_code_hash_of_runs_and_starts_light():
    here = registry.hash_run_code("embedded", "room")
    script = (
        "import sys, evalkit; light = 'numpy' not in sys.modules\n"
        "from evalkit.plugins import registry\n"
        "print(light, registry.hash_run_code('embedded', 'room'))"
    )
    shown = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    assert evalkit.compare is not None
    assert shown.split() == ["True", here]


KEEP = (
    "from evalkit import Match\n\nclass Keep:\n    'Answer the guess.'\n"
    "    def register(self, target, source, guess):\n        return Match(guess, True, 1, 0.0, len(source))\n"
)


def test_a_script_needs_no_main_guard(tmp_path, results):
    (tmp_path / "my_icp.py").write_text(KEEP)
    script = tmp_path / "script.py"
    script.write_text(
        "import sys, evalkit, my_icp\nprint('once')\n"
        "r = evalkit.compare(sys.argv[1], methods=[my_icp.Keep, {'use': 'embedded', 'label': 'mine'}], limit=8)\n"
        "print(r.scores()[['method', 'status']].to_json(orient='values'))\n"
    )
    log = tmp_path / "drive.log"
    log.write_text(carmen_log())
    ended = subprocess.run([sys.executable, script, log], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    once, runs = ended.stdout.splitlines()
    assert once == "once"
    assert json.loads(runs) == [["my_icp:Keep", "complete"], ["mine", "complete"]]


@pytest.fixture
def compare_here(tmp_path, monkeypatch):
    """Return ``compare_here(module, other)``, which compares a class of a module with a method, in this folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")

    def compare(module, other):
        (tmp_path / f"{module}.py").write_text(KEEP)
        (tmp_path / "drive.log").write_text(carmen_log())
        keep = importlib.import_module(module).Keep
        return evalkit.compare("drive.log", [keep, other], out="here", limit=8).content

    return compare


def run_stored(command):
    return subprocess.run(command, shell=True, check=True, capture_output=True, text=True).stdout


def test_the_stored_command_repeats_a_comparison_that_no_command_line_states(compare_here):
    """That of a run is the same call with a folder of its own."""
    made = compare_here("first_icp", {"use": "embedded", "label": "my own", "max_iterations": 6})
    command = made["runs"][0]["command"]
    run_stored(command)
    (again,) = Path("evalkit-results").iterdir()
    assert [run["key"] for run in evalkit.load(again).content["runs"]] == [run["key"] for run in made["runs"]]
    words = [word.replace(f"out='{again}', ", "") for word in shlex.split(command)]
    assert words == shlex.split(made["command"])


def test_the_stored_commands_repeat_a_comparison_of_names_and_one_run(compare_here):
    made = compare_here("second_icp", "wheel-odometry")
    planned = json.loads(run_stored(f"{made['command']} --collect --no-page --out here --json"))
    found, expected = ([(run["key"], run["status"]) for run in content["runs"]] for content in (planned, made))
    assert found == expected
    run_stored(made["runs"][0]["command"])
    (alone,) = Path("evalkit-results").iterdir()
    assert [run.name for run in (alone / "runs").iterdir()] == [made["runs"][0]["key"]]


def test_the_ground_truth_is_named_as_the_parameter_of_the_reader(tmp_path, monkeypatch):
    monkeypatch.setattr(functions, "run", lambda experiment, *_, **__: experiment)  # as it would run
    log, truth = tmp_path / "drive.log", tmp_path / "true.tum"
    log.write_text(carmen_log())
    truth.write_text("1000000 0 0 0 0 0 0 1\n1000009 0 0 0 0 0 0 1\n")
    for made in (
        evalkit.compare(log, [{"use": "embedded", "label": "mine"}], truth),
        evalkit.compare(log, [{"use": "embedded", "label": "mine"}], ground_truth=truth),
    ):
        assert made.sequences[0].parameters["ground_truth"] == str(truth)
        assert f"ground_truth={str(truth)!r}" in made.whole_command.replace("'\"'\"'", "'")
    with pytest.raises(UnknownName, match="carmen: no parameter named 'reference'"):
        evalkit.compare(log, ["embedded"], reference=truth)


def test_a_module_that_compares_a_class_of_its_own_on_import_is_refused(tmp_path):
    (tmp_path / "drive.log").write_text(carmen_log())
    for given in ("Keep", "'own:Keep'"):
        (tmp_path / "own.py").write_text(f"import evalkit\n{KEEP}\nevalkit.compare('drive.log', [{given}], limit=8)\n")
        ended = subprocess.run(
            [sys.executable, "-c", "import own"], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=600
        )
        assert "the module own is being imported" in ended.stderr
        assert "move the comparison to another file" in ended.stderr


class Unready:
    """No method."""


@pytest.mark.parametrize("methods", ["paper", [], Unready, [Unready()], [{"label": "mine"}]])
def test_what_is_no_list_of_methods_is_refused(tmp_path, methods):
    (tmp_path / "drive.log").write_text(carmen_log())
    with pytest.raises(BadParameter, match=r"expected a (list of methods|name, a class)"):
        evalkit.compare(tmp_path / "drive.log", methods)


def test_arguments_that_are_no_numbers_are_refused(tmp_path, results):
    points = np.zeros((3, 2))
    for clouds in (("a", points), (points.astype(complex), points), (points, [[0.0, 1.0], [2.0]]), (points, None)):
        with pytest.raises(BadParameter, match=r"expected points \(N, 2\) in m"):
            evalkit.register(*clouds, "embedded")
    for guess in ((1.0, 2.0), (np.nan, 0.0, 0.0), "here"):
        with pytest.raises(BadParameter, match=r"expected a Pose, or x, y \(m\), theta \(rad\)"):
            evalkit.register(points, points, "embedded", guess)
    for limit in ("5 cm", np.nan):
        with pytest.raises(BadParameter, match=r"'below'.*expected a number in the unit of ate_rmse_m"):
            results.require("ate_rmse_m", "core", below=limit)
    with pytest.raises(BadParameter, match="found 0, expected a whole number from 1"):
        evalkit.run(tmp_path / "any.toml", jobs=0)
    (tmp_path / "drive.log").write_text(carmen_log())
    with pytest.raises(BadParameter, match=r"expected x \(m\), y \(m\), yaw \(deg\)"):
        evalkit.compare(tmp_path / "drive.log", ["embedded"], start=(1.0, 2.0))


def test_a_table_gives_parameters_to_one_registration():
    points = np.random.default_rng(0).uniform(-3.0, 3.0, (300, 2))
    one = evalkit.register(
        points + np.array([0.1, 0.0]), points, {"use": "embedded", "label": "mine", "max_iterations": 1}
    )
    assert one.iterations == 1


def test_results_are_shown_in_one_line(results):
    assert repr(results) == f"ComparisonResults({str(results.folder)!r}: 4 runs of wheel-odometry, core)"


def test_python_and_the_command_line_use_the_same_results_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "my exp.toml"
    file.write_text(
        'method = [{ use = "wheel-odometry" }]\nsequence = [{ use = "room", laps = 0.02 }]\nmapper.scans = 10\n'
    )
    ended = CliRunner().invoke(app, ["compare", file.name, "--jobs", "1"])
    assert ended.exit_code == 0, ended.output
    assert evalkit.compare(file.name).scores()["status"].tolist() == ["complete"]
    assert [path.name for path in (tmp_path / "evalkit-results").iterdir()] == ["my exp"]


def carmen_log():
    """A robot that stands in a square room of 4 m: the range of a beam at angle a is 2 m / max(|cos a|, |sin a|)."""
    angles = np.radians(np.arange(180) - 90.0)
    ranges = " ".join(f"{value:.3f}" for value in 2.0 / np.maximum(abs(np.cos(angles)), abs(np.sin(angles))))
    return "".join(f"FLASER 180 {ranges} 0 0 0 0 0 0 {1e6 + 0.1 * k:.2f} host {0.1 * k:.2f}\n" for k in range(12))


def test_the_fixture_runs_the_comparison_of_the_marker(pytester):
    pytester.makefile(".log", drive=carmen_log())
    pytester.makepyfile(
        "import pytest\n"
        "@pytest.mark.evalkit('drive.log', methods=['embedded'], limit=8)\n"
        "def test_limits(evalkit_results):\n"
        "    evalkit_results.require('answered_percent', 'embedded', above=99.0)\n"
        "    evalkit_results.require('ate_rmse_m', 'embedded', below=1.0)\n"  # the log has no ground truth
        "def test_unmarked(evalkit_results): ...\n"
    )
    # Its own process: in this one, pytester forgets modules that others still hold.
    outcome = pytester.runpytest_subprocess("-p", "no:cacheprovider", "-p", "no:xdist")
    outcome.assert_outcomes(failed=1, errors=1)
    outcome.stdout.fnmatch_lines(
        ["*evalkit_results needs a marker*", "*expected ate_rmse_m of embedded below 1 m, found*", "*no value (*"]
    )
