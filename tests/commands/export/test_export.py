"""Exports of a finished comparison, read back by independent readers."""

import csv
import hashlib
import json
import math
import os
import re
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from typer.testing import CliRunner

from evalkit import report
from evalkit.cli import app
from evalkit.commands.export import figures, latex, mcap, poses, rerun_file
from evalkit.commands.export.command import _make_writers, _write_format
from evalkit.commands.export.results import MetricColumn, SummaryRow, load_selection
from evalkit.config.experiment import Method, RunSpec, SequenceSpec
from evalkit.core.errors import DataMissing, NotInstalled, StoreError, UnknownName
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, RunResult, Score, Scores
from evalkit.core.scan import Frame, Scan
from evalkit.core.trajectory import Trajectory
from evalkit.io.g2o import read_g2o
from evalkit.plugins import registry
from evalkit.plugins.specs import DatasetSpec
from evalkit.report.formatting import escape_markdown
from evalkit.report.html import chart_style, run_figures
from evalkit.results.run_record import RunRecord
from evalkit.results.seal import seal
from evalkit.results.store import Store

pytestmark = pytest.mark.slow

N = 30
T0 = 1663967375_000000001  # not representable as a float of seconds
STAMPS = T0 + np.arange(N) * 100_000_000
HEADING = 0.05 * np.arange(N)
TRUE = np.stack([2.0 * np.sin(HEADING), 2.0 * (1.0 - np.cos(HEADING)), HEADING], axis=-1)
OFF = {"paper": 0.0005, "wheel": 0.01}
AWKWARD = "50 % & more_$x"
SEAT = Pose(0.1, 0.0, np.pi / 2)


class Lap:
    """An arc with a rotated lidar, ranges of four walls, and wheel odometry."""

    def __len__(self):
        return N

    def frames(self):
        angles = np.linspace(-3.0, 3.0, 61)
        for at in range(N):
            ranges = np.full(61, 2.0 + 0.01 * at)
            ranges[0], ranges[1] = np.inf, np.nan
            yield Frame(Scan(int(STAMPS[at]), ranges, angles, 0.1, 12.0, 1_000_000), SEAT, Pose.of(TRUE[at]))

    def truth(self):
        return Truth("exact", Trajectory(STAMPS, TRUE))

    def notes(self):
        return {}


def record_of(name, seed=0):
    steps = np.zeros(N, dtype=STEP)
    steps["stamp_ns"], steps["cpu_ns"] = STAMPS, 2_000_000
    steps["x"], steps["y"], steps["theta"] = TRUE[:, 0] + OFF[name] * np.arange(N), TRUE[:, 1], TRUE[:, 2]
    for stage in ("s2s_error", "s2m_error"):
        steps[stage] = np.nan
    errors = OFF[name] * np.arange(N)
    ate = float(np.sqrt(np.mean(errors**2)))
    scores = {
        "ate_rmse_m": Score(ate, N), "cpu_median_ms": Score(2.0, N), "drift_percent": Score(None, 0, "too short"),
        "split_distance_m": Score({"paper": 0.4, "wheel": 0.3}[name], N), "wall_thickness_m": Score(0.02, N),
        "corners": Score(4.0, N),
    }  # fmt: skip
    log_odds = np.zeros((8, 12), dtype=np.float32)
    log_odds[0], log_odds[1:4, 3:9] = 3.0, -3.0  # a wall at the lowest y
    grid = OccupancyGrid(log_odds, log_odds != 0.0, 0.0125, -1.0625, 2.5)
    run = RunResult(steps, N)
    spec = RunSpec(f"{name}-s{seed}", Method(name, name, {}), SequenceSpec(AWKWARD, "lap", {}, (seed,)), seed)
    return RunRecord(spec, run, Scores(scores, Pose(), "none", grid, errors), Lap().truth(), "evalkit compare x")


@pytest.fixture(scope="module")
def written_folder(tmp_path_factory, build):
    """A results folder with two methods over an arc, as written by a report."""
    records = [record_of("paper"), record_of("wheel")]
    store = Store(tmp_path_factory.mktemp("written") / "results")
    for record in records:
        store.save_result(record.spec, record.result)
        store.save_scores(record.key, record.scores, "")
    with pytest.MonkeyPatch.context() as patch:
        read_lap(patch)
        report.write_report(build(records), store.folder)
    return store.folder


@pytest.fixture
def finished_folder(tmp_path, written_folder, monkeypatch):
    """A copy of ``written_folder``, for one test to read and change."""
    read_lap(monkeypatch)
    return shutil.copytree(written_folder, tmp_path / "results")


def read_lap(patch):
    patch.setattr(registry, "dataset", lambda _name: DatasetSpec(lambda **_: Lap(), "", "", "", "", ""))


def run_export(folder, form, *more):
    target = folder.parent / "export"
    result = CliRunner().invoke(app, ["export", str(folder), "--format", form, "-o", str(target), "--json", *more])
    assert result.exit_code == 0, result.output
    return [Path(path) for path in json.loads(result.stdout)["written"]]


# --- tables


def test_csv_and_json_contain_the_selected_rows_and_conform_to_the_schema(finished_folder):
    jsonschema = pytest.importorskip("jsonschema")
    whole = {path.name: path.read_bytes() for form in ("csv", "json") for path in run_export(finished_folder, form)}
    assert set(whole) == {"runs.csv", "scores.csv", "summary.csv", "results.json", "results.schema.json"}
    for name in ("runs.csv", "scores.csv", "summary.csv"):
        assert whole[name] == (finished_folder / name).read_bytes()
    assert json.loads(whole["results.json"]) == json.loads((finished_folder / "results.json").read_bytes())
    part = {
        path.name: path for form in ("csv", "json") for path in run_export(finished_folder, form, "--method", "wheel")
    }
    heading, row = part["runs.csv"].read_text(encoding="utf-8").splitlines()
    assert (heading.split(",")[1], row.split(",")[1]) == ("method", "wheel")
    content = json.loads(part["results.json"].read_text(encoding="utf-8"))
    jsonschema.validate(content, json.loads(part["results.schema.json"].read_text(encoding="utf-8")))
    assert [record["method"] for record in content["runs"]] == list(content["methods"]) == ["wheel"]
    assert content["verdicts"] == content["overview"] == []  # they compare with the method that is left out


# --- trajectories


def test_tum_files_read_by_evo_have_the_same_errors(finished_folder):
    file_interface = pytest.importorskip("evo.tools.file_interface")
    metrics = pytest.importorskip("evo.core.metrics")
    files = {path.name: path for path in run_export(finished_folder, "tum")}
    truth = file_interface.read_tum_trajectory_file(files["50-more-x-s0.truth.tum"])
    wheel = file_interface.read_tum_trajectory_file(files["wheel-s0.tum"])
    assert np.allclose(wheel.timestamps, STAMPS * 1e-9, atol=1e-6)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((truth, wheel))
    assert error.get_statistic(metrics.StatisticsType.rmse) == pytest.approx(
        0.01 * np.sqrt(np.mean(np.arange(N) ** 2.0)), rel=1e-6
    )


def test_the_result_files_of_evo_hold_the_errors_that_evo_itself_computes(finished_folder):
    file_interface = pytest.importorskip("evo.tools.file_interface")
    metrics = pytest.importorskip("evo.core.metrics")
    results = {path.name: path for path in run_export(finished_folder, "evo")}
    truth = {path.name: path for path in run_export(finished_folder, "tum")}["50-more-x-s0.truth.tum"]
    found = file_interface.load_res_file(results["wheel-s0.zip"], load_trajectories=True)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((file_interface.read_tum_trajectory_file(truth), found.trajectories["estimate"]))
    assert found.np_arrays["error_array"] == pytest.approx(error.error, abs=1e-6)
    for name in ("rmse", "mean", "median", "std", "min", "max", "sse"):
        assert found.stats[name] == pytest.approx(error.get_statistic(metrics.StatisticsType[name]), abs=1e-6)
    assert found.np_arrays["timestamps"] == pytest.approx(STAMPS * 1e-9, abs=1e-6)
    assert found.info["est_name"].startswith("wheel, ")


def test_an_export_without_a_file_says_what_it_needs(tmp_path, capsys):
    without_truth = SimpleNamespace(runs=[SimpleNamespace(scores=SimpleNamespace(errors_m=None))])
    writers = _make_writers("column", "")
    assert _write_format("evo", writers, without_truth, tmp_path, all_formats=False) == []
    said = "evo: no file: no run has a ground-truth trajectory, which its errors need; --format tum writes trajectories"
    assert capsys.readouterr().err == f"{said}\n"
    assert _write_format("evo", writers, without_truth, tmp_path, all_formats=True) == []
    assert capsys.readouterr().err == ""


@pytest.mark.thorough
def test_evo_res_compares_the_result_files(finished_folder, tmp_path):
    pytest.importorskip("evo.cli", reason="evo is not installed")
    zips = [str(path) for path in run_export(finished_folder, "evo")]
    table = tmp_path / "table.csv"
    call = [sys.executable, "-c", "from evo.cli.entry_points import res; res()", *zips, "--save_table", str(table)]
    place = {**os.environ, "HOME": str(tmp_path), "MPLBACKEND": "Agg"}  # it writes its settings at home
    done = subprocess.run(call, capture_output=True, text=True, check=False, timeout=600, env=place)
    assert done.returncode == 0, done.stderr
    with table.open(newline="") as file:
        rmse = {row[""]: float(row["rmse"]) for row in csv.DictReader(file)}
    assert rmse == {
        f"{name}, {AWKWARD}": pytest.approx(OFF[name] * np.sqrt(np.mean(np.arange(N) ** 2.0)), abs=1e-6)
        for name in ("paper", "wheel")
    }


def test_kitti_files_read_by_evo_have_the_same_poses_and_as_many_of_ground_truth(finished_folder):
    file_interface = pytest.importorskip("evo.tools.file_interface")
    files = {path.name: path for path in run_export(finished_folder, "kitti")}
    paper, truth = (file_interface.read_kitti_poses_file(files[f"paper-s0{end}.kitti.txt"]) for end in ("", ".truth"))
    assert paper.num_poses == truth.num_poses == N
    assert np.allclose(truth.positions_xyz[:, :2], TRUE[:, :2], atol=1e-10)
    assert np.allclose(paper.positions_xyz[:, 0], TRUE[:, 0] + 0.0005 * np.arange(N), atol=1e-10)
    headings = [np.arctan2(pose[1, 0], pose[0, 0]) for pose in truth.poses_se3]
    assert np.allclose(headings, TRUE[:, 2], atol=1e-10)


def test_a_run_without_ground_truth_has_a_kitti_file_of_all_its_poses_alone():
    run = replace(record_of("paper"), truth=Truth("none"))
    ((name, content),) = poses.format_kitti(SimpleNamespace(runs=[run]))
    assert (name, len(content.splitlines())) == ("paper-s0.kitti.txt", N)


def test_the_edges_of_a_g2o_file_connect_the_first_vertex_with_every_other(finished_folder):
    path = next(path for path in run_export(finished_folder, "g2o") if path.name == "wheel-s0.g2o")
    rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
    vertices = {int(row[1]): np.array(row[2:], dtype=float) for row in rows if row[0] == "VERTEX_SE2"}
    x, y, heading = vertices[0]
    for row in (row for row in rows if row[0] == "EDGE_SE2"):
        dx, dy, turn = map(float, row[3:6])
        x, y = x + np.cos(heading) * dx - np.sin(heading) * dy, y + np.sin(heading) * dx + np.cos(heading) * dy
        heading += turn
        assert (x, y, heading) == pytest.approx(vertices[int(row[2])], abs=1e-9)
        assert row[6:] == ["1", "0", "0", "1", "0", "1"]
    assert len(vertices) == N


def g2o_of_slam(answered_x, final_x, corrected, *loops):
    """The lines of the g2o file of a SLAM along x, with an answer every 10 ns."""
    stamps = 10 * np.arange(len(final_x))
    steps = np.zeros(len(stamps), dtype=STEP)
    steps["stamp_ns"], steps["x"], steps["corrected"] = stamps, answered_x, corrected
    final = Trajectory(stamps, [[x, 0, 0] for x in final_x], "start", "base")
    result = RunResult(steps, len(stamps), final=final, loop_closures=loops)
    run = SimpleNamespace(key="slam", method="slam", sequence="room", result=result)
    [(name, text)] = poses.format_g2o(SimpleNamespace(runs=[run]))
    assert name == "slam.g2o"
    return text.decode().splitlines()


def test_the_g2o_file_of_a_slam_has_its_final_poses_and_its_accepted_loops_as_measured():
    measured = Pose(0.25, 0.0, 0.125)
    loops = LoopClosure(20, 0, measured, True, "chi2 3"), LoopClosure(20, 10, Pose(), False, "chi2 90")
    rows = g2o_of_slam(0, [0, 1, 0.2], 0, *loops)
    assert rows[1:5] == ["VERTEX_SE2 0 0 0 0", "VERTEX_SE2 1 1 0 0", "VERTEX_SE2 2 0.2 0 0", "FIX 0"]
    assert rows[-1] == "EDGE_SE2 0 2 0.25 0 0.125 1 0 0 1 0 1"
    assert len([row for row in rows if row.startswith("EDGE_SE2")]) == 3


def test_a_g2o_file_says_that_its_information_is_not_that_of_the_method(finished_folder):
    path = next(path for path in run_export(finished_folder, "g2o") if path.name == "wheel-s0.g2o")
    first, second = path.read_text(encoding="utf-8").splitlines()[:2]
    assert first.startswith("# evalkit: wheel on ")
    assert first.endswith("; all edges have the identity as information, because the method reports no uncertainty")
    assert second == "VERTEX_SE2 0 0 0 0"
    graph = read_g2o(path).graph
    assert (len(graph), len(graph.first)) == (N, N - 1)


def test_the_steps_of_a_g2o_file_of_a_slam_are_those_of_its_answers_except_at_a_correction():
    """The robot answers 1 m a step; the loop at the last scan shows that it stands where it began."""
    loop = LoopClosure(30, 0, Pose(), True, "chi2 3")
    rows = g2o_of_slam([0, 1, 2, 0], [0, 0.25, 0.5, 0], [0, 0, 0, 1], loop)
    edges = [list(map(float, row.split()[1:6])) for row in rows if row.startswith("EDGE")]
    assert edges == [[0, 1, 1, 0, 0], [1, 2, 1, 0, 0], [2, 3, -0.5, 0, 0], [0, 3, 0, 0, 0]]


# --- maps


def nav2(path):
    """Return cells (H, W) of 100, 0 and -1 and their lower left corner, by Nav2's map_io in trinary mode."""
    words = dict(re.findall(r"^(\w+): (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE))
    head, pixels = (path.parent / words["image"]).read_bytes().split(b"\n255\n", 1)
    columns, rows = map(int, head.split()[1:3])
    shade = np.frombuffer(pixels, dtype=np.uint8).reshape(rows, columns) / 255.0
    occupancy = shade if int(words["negate"]) else 1.0 - shade
    cells = np.full((rows, columns), -1)
    cells[occupancy >= float(words["occupied_thresh"])] = 100
    cells[occupancy <= float(words["free_thresh"])] = 0
    x, y, _ = json.loads(words["origin"])
    return cells[::-1], float(words["resolution"]), x, y


def test_a_map_read_by_nav2s_rules_equals_the_exported_grid(finished_folder):
    path = next(path for path in run_export(finished_folder, "map") if path.name == "paper-s0.yaml")
    cells, resolution, x, y = nav2(path)
    grid = record_of("paper").scores.grid
    assert (resolution, x, y) == (0.0125, -1.0625, 2.5)
    assert np.array_equal(cells == 100, grid.occupied())
    assert np.array_equal(cells == 0, grid.free())
    assert (cells[0] == 100).all()  # the wall at the lowest y
    first = "# frame: world; the trajectory is start_from_base, world_from_start = 0.0 0.0 0.0 (x y theta: m, m, rad)"
    assert path.read_text(encoding="utf-8").splitlines()[0] == first


# --- papers


def test_a_latex_table_has_complete_rows_and_no_unescaped_special_character(finished_folder):
    files = {path.name: path.read_text(encoding="utf-8") for path in run_export(finished_folder, "latex")}
    assert r"\input{table-50-more-x}" in files["tables.tex"]
    text = files["table-50-more-x.tex"]
    assert Counter(re.findall(r"\\begin\{(\w+)\}", text)) == Counter(re.findall(r"\\end\{(\w+)\}", text))
    assert text.count("{") - text.count(r"\{") == text.count("}") - text.count(r"\}")
    specification = re.sub(r"\[.*?\]|@\{.*?\}", "", re.search(r"\\begin\{tabular\}\{(.+)\}", text)[1])
    columns = len(specification.replace(" ", ""))
    head, units, *rows = [line for line in text.splitlines() if line.endswith(r"\\")]
    assert [row.split("&")[0].strip() for row in rows] == ["paper", "wheel"]  # by rank
    assert {len(re.findall(r"(?<!\\)&", row)) + 1 for row in rows} == {columns}
    assert len(re.findall(r"(?<!\\)&", head)) + 1 + head.count("multicolumn") == columns
    assert [title.strip() for title in head.split("&")][-2:] == ["{CPU}", r"Rank \\"]
    assert [unit.strip() for unit in units.split("&")][-2:] == [r"{[ms] $\downarrow$}", r"\\"]
    assert r"{[mm] $\downarrow$}" in units
    assert "resizebox" not in text
    assert r"\caption{50 \% \& more\_\$x:" in text
    assert [text.count(rule) for rule in (r"\toprule", r"\midrule", r"\bottomrule")] == [1, 1, 1]


def test_latex_compiles_the_tables_and_the_figures(finished_folder):
    if shutil.which("pdflatex") is None:
        pytest.skip("pdflatex is not installed")
    tables, figures = (run_export(finished_folder, form)[0].parent for form in ("latex", "pdf"))
    (tables / "paper.tex").write_text(
        r"\documentclass[twocolumn]{article}\usepackage{booktabs,graphicx,siunitx}\begin{document}\input{tables}"
        rf"\noindent\includegraphics[width=\columnwidth]{{{figures / '50-more-x-trajectories.pdf'}}}\end{{document}}",
        encoding="utf-8",
    )
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    done = subprocess.run(command, cwd=tables, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stdout[-2000:]
    log = (tables / "paper.log").read_text(encoding="latin-1")
    assert "Missing character" not in log
    assert "Overfull" not in log  # the tables fit a column


def test_tables_contain_exactly_the_intervals_of_results_json(finished_folder):
    intervals = json.loads((finished_folder / "results.json").read_text(encoding="utf-8"))["intervals"]
    wheel = next(one for one in intervals if (one["method"], one["metric"]) == ("wheel", "ate_rmse_m"))
    (path,) = (
        path for path in run_export(finished_folder, "latex", "--metric", "ate_rmse_m") if path.name != "tables.tex"
    )
    rows = {line.split("&")[0].strip(): line for line in path.read_text(encoding="utf-8").splitlines() if "&" in line}
    assert f"[{1000 * wheel['low']:.1f}, {1000 * wheel['high']:.1f}]" in rows["wheel"]  # below a metre: millimetres
    assert rows["paper"].split("&")[1].strip() in ("8.4", r"\bfseries 8.4")
    (path,) = run_export(finished_folder, "markdown", "--metric", "ate_rmse_m")
    table = [line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    assert {line.count("|") for line in table} == {4}
    assert f"[{1000 * wheel['low']:.1f}, {1000 * wheel['high']:.1f}]" in table[-1]


def test_a_metric_that_no_method_has_is_refused_with_its_reason(finished_folder):
    call = ["export", str(finished_folder), "-f", "latex", "-o", str(finished_folder / "x"), "--metric", "ate_rmse_m"]
    result = CliRunner().invoke(app, [*call, "--metric", "drift_percent"])
    assert isinstance(result.exception, StoreError)
    assert "no method has drift_percent: too short; metrics with a value: " in str(result.exception)
    assert str(result.exception).split("metrics with a value: ")[1].split(", ")[0] == "ate_rmse_m"
    assert not (finished_folder / "x").exists()


def rank_column(folder, form, *metrics):
    """The rows of the exported table as label and last cell, without heading."""
    options = [word for metric in metrics for word in ("--metric", metric)]
    (path,) = (one for one in run_export(folder, form, *options) if one.name != "tables.tex")
    cut, start = ("|", "| ") if form == "markdown" else ("&", "    ")
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line.startswith(start) and cut in line]
    rows = [[cell.strip(" \\") for cell in line.strip(cut).split(cut)] for line in lines]
    return [(row[0], row[-1]) for row in rows if row[0] in OFF]


@pytest.mark.parametrize("form", ["latex", "markdown"])
def test_the_rank_is_that_in_the_first_column_and_left_out_where_there_is_none(finished_folder, form):
    assert rank_column(finished_folder, form) == [("paper", "1"), ("wheel", "2")]  # by error
    assert rank_column(finished_folder, form, "split_distance_m") == [("wheel", "1"), ("paper", "2")]
    assert rank_column(finished_folder, form, "ate_rmse_m", "split_distance_m") == [("paper", "1"), ("wheel", "2")]
    assert rank_column(finished_folder, form, "wall_thickness_m") == [("paper", "1"), ("wheel", "1")]  # equal
    assert rank_column(finished_folder, form, "cpu_median_ms") == [("paper", "1"), ("wheel", "--")]  # the baseline
    assert rank_column(finished_folder, form, "corners") == [("paper", "4"), ("wheel", "4")]  # none is better


def captions(folder):
    """The caption of the only table in LaTeX, and the same line of Markdown."""
    latex_text = next(p for p in run_export(folder, "latex") if p.name != "tables.tex").read_text(encoding="utf-8")
    (path,) = run_export(folder, "markdown")
    last = [line for line in path.read_text(encoding="utf-8").splitlines() if line][-2]
    caption = re.search(r"\\caption\{.*?: (.+)\.\}", latex_text)[1].replace(r"\%", "%")
    assert last == f"{caption[0].upper()}{caption[1:]}."
    return caption


def test_the_caption_of_single_runs_promises_no_median_and_no_bold(finished_folder):
    assert captions(finished_folder) == (
        "one complete run of each method; CPU: median time of a scan; "
        "in brackets: 95 % interval over the scans of the run"
    )


PAPER_M = (0.104, 0.100, 0.103, 0.102, 0.106, 0.101, 0.105)
"""Error of each run: the median is 103 mm, the range 100 to 106 mm. By the wheels it is twice that."""


@pytest.mark.parametrize("perturbed", [False, True])
def test_an_exported_table_states_the_bounds_and_the_ranks_of_the_page(tmp_path, build, monkeypatch, perturbed):
    read_lap(monkeypatch)
    records = []
    for name, factor in (("paper", 1.0), ("wheel", 2.0)):
        for seed, error in enumerate(PAPER_M):
            one = record_of(name, seed)
            sequence = replace(one.spec.sequence, seeds=tuple(range(len(PAPER_M))), perturbed=perturbed)
            scores = replace(
                one.scores, by_metric={"ate_rmse_m": Score(factor * error, N), "cpu_median_ms": Score(2, N)}
            )
            records.append(replace(one, spec=replace(one.spec, sequence=sequence), scores=scores))
    store = Store(tmp_path / "results")
    for one in records:
        store.save_result(one.spec, one.result)
        store.save_scores(one.key, one.scores, "")
    report.write_report(build(records), store.folder)
    table = next(p for p in run_export(store.folder, "latex") if p.name != "tables.tex").read_text(encoding="utf-8")
    bounds = re.findall(r"\d & \[(\d+), (\d+)\]", table)
    page = json.loads((store.folder / "results.json").read_text(encoding="utf-8"))["verdicts"][0]["sentences"]
    stated = r"\((\d+) to (\d+) in 7 repeated runs\)" if perturbed else r"interval (\d+) to (\d+)\)"
    assert bounds == re.findall(stated, " ".join(page))[:2]
    assert (bounds == [("100", "106"), ("200", "212")]) is perturbed
    kind = "lowest and highest of the repeated runs" if perturbed else "95 % interval"
    assert captions(store.folder) == (
        f"medians over complete runs; CPU: median time of a scan; in brackets: {kind}; "
        "bold: the best value, and close ones not clearly different"
    )


def test_the_caption_names_whom_bold_numbers_do_not_compare():
    def row(method, metric, rank, best=False):
        return SummaryRow("hall", method, metric, 2.0, 3, None, best, rank, "")

    columns = tuple(
        MetricColumn(name, name, "ms", "lower", 1) for name in ("ate_rmse_m", "cpu_median_ms", "cpu_p95_ms")
    )
    cells = {
        "icp": (row("icp", "ate_rmse_m", 1), row("icp", "cpu_median_ms", 1, True), row("icp", "cpu_p95_ms", 1, True)),
        "wheels": (
            row("wheels", "ate_rmse_m", None),
            *(row("wheels", m, None) for m in ("cpu_median_ms", "cpu_p95_ms")),
        ),
    }
    table = latex.PaperTable(columns, tuple((label, own, ()) for label, own in cells.items()), 3)
    assert table.caption().endswith("clearly different; not ranked: wheels (CPU, cpu_p95_ms)")  # no bold error


def test_a_method_without_a_value_has_a_dash_in_the_column_and_beside_it_where_others_have_bounds():
    columns = tuple(MetricColumn(name, name, "ms", "lower", 1) for name in ("cpu_median_ms", "cpu_p95_ms"))
    bounded = SummaryRow("hall", "icp", "cpu_median_ms", 2.0, 3, SimpleNamespace(low=1.0, high=3.0), False, 1, "")
    plain = replace(bounded, metric="cpu_p95_ms", spread=None)
    failed = replace(plain, method="kiss", median=None)
    table = latex.PaperTable(columns, (("icp", (bounded, plain), ("1",)), ("kiss", (None, failed), ("--",))), 2)
    assert [latex._latex_cell(table, at, cell) for at, cell in enumerate((bounded, plain))] == [
        "2.0 & [1.0, 3.0]",
        "2.0",
    ]
    assert [latex._latex_cell(table, at, cell) for at, cell in enumerate((None, failed))] == ["{--} & ", "{--}"]


@pytest.mark.parametrize(("median", "digits"), [(0.2, 2), (0.0038, 3), (0.00001, 4), (0.0, 2)])
def test_the_smallest_time_of_a_column_is_not_printed_as_zero(median, digits):
    cells = [SummaryRow("hall", "icp", "cpu_median_ms", value, 1, None, False, None, "") for value in (median, 40.0)]
    column, _ = latex._with_digits(MetricColumn("cpu_median_ms", "CPU", "ms", "lower", 2), [*cells, None])
    assert column.digits == digits


def test_every_latex_special_character_is_escaped():
    assert latex.escape_latex(r"a_b & 5% {x} #1 ~^ $\n") == (
        r"a\_b \& 5\% \{x\} \#1 \textasciitilde{}\textasciicircum{} \$\textbackslash{}n"
    )


def test_a_name_is_escaped_in_markdown():
    assert escape_markdown("a|b `c` *d* [x](javascript:alert) <script> \\ \x1b[2J") == (
        r"a\|b \`c\` \*d\* [x]\(javascript:alert) &lt;script> \\ \\x1b[2J"
    )
    assert [escape_markdown(text) for text in ("# x", "- x", "-5 %", "a # b")] == [r"\# x", r"\- x", "-5 %", "a # b"]


def test_figures_are_vector_graphics_with_embedded_fonts_and_reproducible_bytes(finished_folder):
    found = load_selection(finished_folder)
    drawn = dict(figures.draw_figures(found, "pdf"))
    kinds = ("trajectories", "errors", "runtimes", "maps", "accuracy-time")
    assert set(drawn) == {f"50-more-x-{kind}.pdf" for kind in kinds}
    for name, content in drawn.items():
        assert content.startswith(b"%PDF-")
        assert b"/FontFile2" in content
        assert (b"/Subtype /Image" in content) == name.endswith("maps.pdf")
    first = next(iter(drawn))
    assert next(figures.draw_figures(found, "pdf")) == (first, drawn[first])
    assert next(figures.draw_figures(found, "svg"))[1].startswith(b"<?xml")


def test_the_figure_of_errors_marks_methods_whose_settings_were_chosen_on_its_data(finished_folder, monkeypatch):
    shown = []

    def keep(panels, *_):
        shown.append(Figure().subplots())
        panels[0](shown[-1])

    monkeypatch.setattr(figures, "render_figure", keep)
    found = load_selection(finished_folder)
    paper = chart_style.PaperStyle(3.4, "")
    for tuned_on in ([], ["other"], ["lap"]):
        methods = {**found.content["methods"], "paper": {**found.content["methods"]["paper"], "tuned_on": tuned_on}}
        figures.draw_accuracy_time(replace(found, content={**found.content, "methods": methods}), AWKWARD, "svg", paper)
    marks = [sorted(line.get_marker() for line in axes.lines if len(line.get_xdata())) for axes in shown]
    assert marks == [["o", "o"], ["o", "o"], ["D", "o"]]
    assert [axes.get_legend() and axes.get_legend().get_texts()[0].get_text() for axes in shown] == [
        None,
        None,
        figures.TUNED,
    ]


@pytest.mark.parametrize(("width", "inches"), [("column", 3.4), pytest.param("text", 7.0, marks=pytest.mark.thorough)])
def test_figures_have_their_final_width_and_no_text_below_7_pt(finished_folder, monkeypatch, width, inches):
    sizes = []

    def note_sizes(figure, form):
        figure.canvas.draw()
        shown = [text for text in figure.findobj(Text) if text.get_text().strip() and text.get_visible()]
        sizes.extend(text.get_fontsize() for text in shown)
        assert figure.get_figwidth() == pytest.approx(inches)
        return b""

    found = load_selection(finished_folder)
    monkeypatch.setattr(chart_style, "render_figure", chart_style.render_figure)
    monkeypatch.setattr(run_figures, "_run_figure", lambda panels, remark="", min_legend=1: run_figures.RunFigure(
        b"", remark, partial(chart_style.render_figure, panels, run_figures.SIZE, min_legend)))  # fmt: skip
    monkeypatch.setattr(chart_style, "_save", note_sizes)
    assert len(list(figures.draw_figures(found, "pdf", width))) == 5
    assert min(sizes) >= 7.0


def test_an_unknown_font_or_width_is_named(finished_folder):
    with pytest.raises(UnknownName, match=r"no font family named 'DejaVu Sanz' .did you mean 'DejaVu Sans'"):
        next(figures.draw_figures(load_selection(finished_folder), "pdf", "column", "DejaVu Sanz"))
    result = CliRunner().invoke(app, ["export", str(finished_folder), "-f", "latex", "--width", "page"])
    assert result.exit_code == 2
    assert "'page' is not one of 'column', 'text'" in " ".join(result.output.split())


def test_a_table_for_the_text_width_spans_both_columns(finished_folder):
    (path, _) = run_export(finished_folder, "latex", "--width", "text")
    assert path.read_text(encoding="utf-8").startswith(r"\begin{table*}")


# --- viewers


def test_a_bag_read_by_evalkit_equals_the_recording(finished_folder):
    from evalkit_datasets.readers.rosbag import RosBag

    folder = finished_folder.parent / "export" / "mcap" / "wheel-s0"
    assert folder in run_export(finished_folder, "mcap")
    sequence = RosBag(str(folder), base_frame="base_link")
    for made, frame in zip(Lap().frames(), sequence.frames(), strict=True):
        assert frame.scan.stamp_ns == made.scan.stamp_ns
        assert np.allclose(frame.scan.ranges, made.scan.ranges, atol=1e-6, equal_nan=True)
        assert np.allclose(frame.scan.angles, made.scan.angles, atol=1e-6)
        assert frame.base_from_sensor.row == pytest.approx(SEAT.row)
        assert frame.odom_from_base.row == pytest.approx(made.odom_from_base.row)


def test_the_inspection_of_a_bag_finds_its_known_properties(finished_folder):
    from evalkit_datasets.commands.inspect.inspector import inspect_recording
    from evalkit_datasets.commands.inspect.suggested_config import suggest_config

    found = inspect_recording(run_export(finished_folder, "mcap", "--method", "wheel")[0])
    (lidar,), (seat,), (driven,) = found.lidars, found.frames.mountings, found.odometries
    assert (lidar.timing.count, lidar.beams, lidar.returns.nan) == (N, 61, pytest.approx(1 / 61))
    assert lidar.timing.rate_hz == pytest.approx(10.0)
    assert lidar.sweep_s == pytest.approx(0.06)
    assert (seat.base, seat.x_m, seat.theta_deg) == ("base_link", pytest.approx(0.1), pytest.approx(90.0))
    assert driven.path_m == pytest.approx(29 * 4.0 * np.sin(0.025))
    assert driven.twist.constant
    advice = suggest_config(found)
    assert (advice.parameters["topic"], advice.scans, advice.problem) == ("/scan", N, "")


def test_an_mcap_file_read_by_the_mcap_library_contains_estimate_ground_truth_and_map(finished_folder):
    reader = pytest.importorskip("mcap.reader", reason="mcap is not installed")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    (path,) = (run_export(finished_folder, "mcap", "--method", "wheel")[0]).glob("*.mcap")
    with path.open("rb") as file:
        messages = [(schema, channel.topic, message) for schema, channel, message in
                    reader.make_reader(file, validate_crcs=True).iter_messages()]  # fmt: skip
    counts = Counter(topic for _, topic, _ in messages)
    assert counts == {"/scan": N, "/odom": N, "/tf": 2 * N, "/tf_static": 2, "/estimate": 1, "/truth": 1, "/map": 1}
    assert {schema.encoding for schema, _, _ in messages} == {"ros2msg"}
    assert [message.log_time for _, _, message in messages] == sorted(m.log_time for _, _, m in messages)
    offered = (path.parent / "metadata.yaml").read_text(encoding="utf-8").split("message_count")
    kept = {topic for topic in counts for part in offered if f"name: {topic}\n" in part and "transient_local" in part}
    assert kept == {"/tf_static", "/estimate", "/truth", "/map"}  # RViz requests these after they were sent
    estimate = next(store.deserialize_cdr(m.data, s.name) for s, topic, m in messages if topic == "/estimate")
    assert [pose.pose.position.x for pose in estimate.poses] == pytest.approx(TRUE[:, 0] + 0.01 * np.arange(N))
    grid = next(store.deserialize_cdr(m.data, s.name) for s, topic, m in messages if topic == "/map")
    cells = grid.data.reshape(grid.info.height, grid.info.width)
    assert (cells[0] == 95).all()  # 1 / (1 + exp(-3))
    assert (cells[5:] == -1).all()


def test_the_odometry_of_a_bag_has_its_place_in_the_world():
    """Its origin is where the first frame with an answer and odometry puts it; that is not where the robot starts."""
    world_from_odom = Pose(3.0, -2.0, 0.5)
    answers = {int(stamp): world_from_odom @ Pose.of(row) for stamp, row in zip(STAMPS[4:], TRUE[4:], strict=True)}
    builder = mcap.MessageBuilder()
    sent = list(mcap.sequence_messages(builder, Lap(), 0, T0, answers))
    moved = [message.transforms[0] for _, topic, message in sent if topic == "/tf_static"]
    assert [(one.header.frame_id, one.child_frame_id) for one in moved] == [("base_link", "laser"), ("world", "odom")]
    place, turn = moved[1].transform.translation, moved[1].transform.rotation
    assert (place.x, place.y, 2.0 * math.atan2(turn.z, turn.w)) == pytest.approx((3.0, -2.0, 0.5))
    alone = [topic for _, topic, _ in mcap.sequence_messages(builder, Lap(), 0, T0)]
    assert alone.count("/tf_static") == 1


def test_a_recording_that_starts_at_zero_is_shifted_to_valid_ros_times(finished_folder):
    found = load_selection(finished_folder, methods=["paper"])
    (record,) = found.runs
    early = RunResult(record.result.steps.copy(), N)
    early.steps.flags.writeable = True
    early.steps["stamp_ns"] -= T0
    sent = list(
        mcap._run_messages(mcap.MessageBuilder(), replace(record, result=early, truth=Truth("none")), Nothing())
    )
    assert min(stamp for stamp, _, _ in sent) == 10**9


class Nothing:
    """A sequence without scans."""

    def frames(self):
        return iter(())


def test_a_rerun_recording_passes_reruns_own_check(finished_folder):
    pytest.importorskip("rerun", reason="rerun is not installed")
    (path,) = run_export(finished_folder, "rerun")
    assert path.name == "50-more-x-s0.rrd"
    command = [sys.executable, "-m", "rerun", "rrd", "verify", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
    told = subprocess.run([*command[:4], "stats", str(path)], capture_output=True, text=True, check=False, timeout=600)
    for entity in ("/world/truth", "/world/paper/path", "/world/wheel/scan", "/maps/wheel", "/errors/wheel"):
        assert entity in told.stdout


@pytest.mark.thorough
def test_without_rerun_the_message_names_the_install_command_and_the_rest_is_written(finished_folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(NotInstalled, match=r"pip install 'evalkit\[rerun\]'"):
        rerun_file.import_rerun()
    result = CliRunner().invoke(
        app, ["export", str(finished_folder), "-f", "all", "-o", str(finished_folder.parent / "everything")]
    )
    assert result.exit_code == 0
    assert "rerun is left out" in result.output
    assert (finished_folder.parent / "everything" / "markdown" / "summary.md").exists()


# --- unavailable data


def test_a_sequence_without_its_files_gives_a_remark_and_the_rest_is_written(finished_folder, monkeypatch):
    def gone(**_):
        raise DataMissing("lap", "no such folder", "fetch it")

    monkeypatch.setattr(registry, "dataset", lambda _name: DatasetSpec(gone, "", "", "", "", ""))
    found = load_selection(finished_folder)
    assert len(found.remarks) == 1
    assert "fetch it" in found.remarks[0]
    assert [record.truth.trajectory for record in found.runs] == [None, None]
    assert next(figures.draw_figures(found, "pdf"))[0] == "50-more-x-trajectories.pdf"


def test_a_parameter_that_the_reader_no_longer_has_gives_a_remark(finished_folder, monkeypatch):
    monkeypatch.setattr(registry, "dataset", lambda _name: DatasetSpec(Lap, "", "", "", "", ""))
    (remark,) = load_selection(finished_folder).remarks
    assert remark.endswith("without scans and ground truth (Lap() takes no arguments)")


@pytest.mark.parametrize(
    ("name", "left", "said"),
    [
        ("steps.bin", 500, "of 30 poses"),
        ("steps.bin", 0, "0 of 30 poses"),
        ("result.json", 20, "0 of 30 poses"),
        ("scores.json", 20, "its alignment and map are missing"),
        ("grid.npz", 30, "its alignment and map are missing"),
    ],
)
def test_an_incomplete_run_is_left_out_with_a_message_and_the_others_are_written(finished_folder, name, left, said):
    path = finished_folder / "runs" / "paper-s0" / name
    path.write_bytes(path.read_bytes()[:left])
    found = load_selection(finished_folder)
    assert [record.method for record in found.runs] == ["wheel"]
    (remark,) = found.remarks
    assert remark.startswith(f"paper over {AWKWARD}")
    assert said in remark
    assert [path.name for path in run_export(finished_folder, "tum")] != []


def test_an_export_that_can_write_nothing_fails(finished_folder, tmp_path):
    shutil.rmtree(finished_folder / "runs")
    call = ["export", str(finished_folder), "-f", "tum", "-o", str(tmp_path / "export")]
    result = CliRunner().invoke(app, call)
    assert result.exit_code == 1
    assert "incomplete: 0 of 30 poses (result.json: No such file or directory); repeat the comparison" in result.stderr
    assert result.stdout.startswith("0 files in ")
    assert CliRunner().invoke(app, [*call, "-f", "csv"]).exit_code == 0  # the tables need no run


def test_invalid_folders_and_labels_are_reported(finished_folder, tmp_path):
    with pytest.raises(StoreError, match="no such file"):
        load_selection(tmp_path)
    for wrong in ({"sequences": ["nowhere"]}, {"methods": ["nobody"]}, {"metrics": ["ate"]}):
        with pytest.raises(UnknownName):
            load_selection(finished_folder, **wrong)
    result = CliRunner().invoke(app, ["export", str(finished_folder), "-f", "word"])
    assert isinstance(result.exception, UnknownName)


def test_an_export_does_not_change_the_results_folder(finished_folder):
    before = sorted(path for path in finished_folder.rglob("*"))
    load_selection(finished_folder)
    assert sorted(path for path in finished_folder.rglob("*")) == before


@pytest.mark.parametrize("key", ["../../victim", "/tmp/victim", "..", ".hidden", "a/b", "", 3])
def test_a_received_folder_cannot_name_files_outside_the_output(finished_folder, tmp_path, key):
    received = tmp_path / "received"
    shutil.copytree(finished_folder, received)
    content = json.loads((received / "results.json").read_text(encoding="utf-8"))
    del content["sha256"], content["files"]
    content["runs"][0]["key"] = key
    (received / "results.json").write_text(seal(content, {}), encoding="utf-8")
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "mine.txt").write_text("mine")
    result = CliRunner().invoke(app, ["export", str(received), "-f", "mcap", "--out", str(tmp_path / "out" / "deep")])
    assert "runs[0].key: found" in str(result.exception)
    assert (victim / "mine.txt").read_text() == "mine"
    assert not (tmp_path / "out").exists()


def test_an_export_removes_nothing_that_it_did_not_write(finished_folder, tmp_path):
    pytest.importorskip("rosbags")
    (first,) = (run_export(finished_folder, "mcap", "--method", "wheel"))[:1]
    (first / "notes.txt").write_text("mine")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text("mine")
    bag = next(first.glob("*.mcap"))
    bag.unlink()
    bag.symlink_to(elsewhere)
    again = run_export(finished_folder, "mcap", "--method", "wheel")[0]
    assert again == first
    assert (first / "notes.txt").read_text() == elsewhere.read_text() == "mine"
    assert not bag.is_symlink()
    assert bag.stat().st_size > 1000


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("verdicts", None, "verdicts: found None, expected array"),
        ("verdicts", [{"sequence": "lab", "sentences": 3}], r"verdicts\[0\]: no key 'outcome'"),
        ("methods", {"wheel": math.nan}, "not JSON compliant"),
        ("title", "\ud800", "surrogates not allowed"),
    ],
)
def test_results_of_a_stranger_with_a_part_of_another_type_are_one_line(finished_folder, name, value, problem):
    path = finished_folder / "results.json"
    content = json.loads(path.read_text(encoding="utf-8")) | {name: value}
    del content["sha256"]
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    path.write_text(json.dumps({**content, "sha256": hashlib.sha256(text.encode()).hexdigest()}), encoding="utf-8")
    with pytest.raises(StoreError, match=problem):
        load_selection(finished_folder)


@pytest.mark.parametrize("content", [{}, {"metrics": 3}, {"metrics": [], "sequences": 1, "methods": [], "runs": None}])
def test_results_with_missing_keys_or_wrong_types_are_one_line(finished_folder, content):
    schema = json.loads((finished_folder / "results.json").read_text(encoding="utf-8"))["schema"]
    (finished_folder / "results.json").write_text(seal({"schema": schema, **content}, {}), encoding="utf-8")
    with pytest.raises(StoreError, match=r"results\.json: no key 'title'; repeat the comparison with --resume"):
        load_selection(finished_folder)


def write_recording(folder):
    """Write a CARMEN log of a robot that drives straight, with its true poses beside it."""
    ranges = " ".join(f"{2.0 + 0.01 * beam:.2f}" for beam in range(180))
    folder.mkdir(parents=True)
    times = [(f"{1000 + 0.1 * at:.1f}", f"{0.02 * at:.2f} 0 0") for at in range(12)]
    lines = [f"FLASER 180 {ranges} {pose} {pose} {time} h {time}" for time, pose in times]
    (folder / "drive.log").write_text("\n".join(lines) + "\n")
    (folder / "poses.tum").write_text("".join(f"{time} {pose} 0 0 0 1\n" for time, pose in times))


def test_data_with_relative_paths_are_found_from_any_folder_and_after_a_move(tmp_path, monkeypatch):
    project, work = tmp_path / "project", tmp_path / "project" / "work"
    write_recording(project / "data")
    work.mkdir()
    monkeypatch.chdir(work)
    given = ["../data/drive.log", "--ground-truth", "../data/poses.tum", "--backends", "wheel-odometry", "--as-is"]
    assert CliRunner().invoke(app, ["compare", *given, "--out", "../results"]).exit_code == 0
    (tmp_path / "moved").mkdir()
    project.rename(tmp_path / "moved" / "project")
    monkeypatch.chdir(tmp_path)
    found = load_selection(Path("moved/project/results"))
    assert found.remarks == ()
    assert len(found.runs[0].truth.trajectory) == 12
    (tmp_path / "moved" / "project" / "data" / "poses.tum").unlink()
    (remark,) = load_selection(Path("moved/project/results")).remarks
    assert "../data/poses.tum: no such file" in remark
    assert f"relative paths were sought in {tmp_path / 'moved' / 'project' / 'work'}, where it ran" in remark
