"""``--collect`` starts no program of an experiment: it reads how the program described itself when it was run."""

import json
import sys

import pytest
from typer.testing import CliRunner

from evalkit.cli import app
from evalkit.results import descriptions
from evalkit.results.store import Store

pytestmark = pytest.mark.usefixtures("strangers", "scoring_in_threads")

LEAVES_A_MARK = """
import json, sys
open({marks!r}, "a").write("x")
for line in sys.stdin:
    question = json.loads(line)
    if question["ask"] == "hello":
        answer = {{"protocol": 1, "kind": "odometry", "parameters": [{{"name": "gain", "default": 0.5}}]}}
    else:
        answer = {{"pose": question.get("odom_from_base")}}
    print(json.dumps(answer), flush=True)
"""
EXPERIMENT = """
[mapper]
resolution_m = 0.25

[[sequence]]
use = "straight"

[[method]]
label = "mine"
use = "exec:{} -I -S {}"
"""


@pytest.fixture
def compare(tmp_path):
    """Return ``compare(*options)``: exit code, output, standard error, and how often the program was started."""
    marks, program, file = tmp_path / "marks", tmp_path / "program.py", tmp_path / "small.toml"
    program.write_text(LEAVES_A_MARK.format(marks=str(marks)))
    file.write_text(EXPERIMENT.format(sys.executable, program))

    def call(*options):
        descriptions._asked.clear()  # each command is a process of its own
        marks.write_text("")
        done = CliRunner().invoke(app, ["compare", str(file), "--out", str(tmp_path / "out"), *options])
        return done.exit_code, done.stdout, done.stderr, len(marks.read_text())

    call.folder, call.program, call.file = tmp_path / "out", program, file
    return call


@pytest.mark.parametrize("page", [("--no-page",), pytest.param((), marks=pytest.mark.thorough)])
def test_collect_finds_the_runs_of_a_program_that_it_does_not_start(compare, page):
    code, _, _, started = compare("--no-page")
    assert (code, started > 0) == (0, True)
    (run,) = (compare.folder / "runs").iterdir()
    code, out, err, started = compare("--collect", *page)
    assert (code, started) == (0, 0)
    assert "1 run complete" in out
    assert "collect" not in err
    Store.existing(compare.folder).discard_scores(run.name)  # it is then scored again
    code, out, _, started = compare("--collect", "--no-page", "--json")
    assert (code, started) == (0, 0)
    assert json.loads(out)["runs"][0]["scores"]["ate_rmse_m"] is not None
    code, _, _, started = compare("--resume", "--no-page")  # finds the same run, with what the program says now
    assert (code, started) == (0, 1)
    assert list((compare.folder / "runs").iterdir()) == [run]


@pytest.mark.parametrize("change", ["another program", "damaged", "no results"])
def test_collect_counts_the_runs_of_an_undescribed_program_as_missing(compare, change):
    if change != "no results":
        assert compare("--no-page")[0] == 0
    if change == "another program":
        compare.program.write_text(compare.program.read_text() + "# another build")
    if change == "damaged":
        (stored,) = (compare.folder / descriptions.FOLDER).iterdir()
        stored.write_text(stored.read_text().replace("0.5", "0.6"))
    compare.file.write_text(compare.file.read_text() + "gain = 2.0\n" * (change == "no results"))
    code, out, err, started = compare("--collect", "--no-page")
    assert (code, started) == (3, 0)
    assert "1 not run yet: mine on straight" in out
    (line,) = err.splitlines()
    assert line.startswith("exec:")
    assert line.endswith("was never started for this results folder, and --collect does not start it")


def test_collect_of_a_tuning_starts_no_program(compare, tmp_path):
    lines = compare.file.read_text().replace("[[sequence]]", "[[training]]").replace("straight", "lab")
    lines = lines.replace('use = "lab"', 'use = "lab"\nseeds = [0]\nconfirm = [2, 3, 4, 5]')
    file = tmp_path / "tuning.toml"
    file.write_text(f'{lines}search = {{ gain = [0.5, 1.0] }}\n\n[[held-out]]\nuse = "room"\nseeds = [0]\n')
    descriptions._asked.clear()
    done = CliRunner().invoke(app, ["tune", str(file), "--collect", "--out", str(tmp_path / "tuned")])
    assert done.exit_code == 3, done.output
    assert "does not start it" in done.stderr
    assert not (tmp_path / "marks").exists()
