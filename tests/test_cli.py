"""The command line: exit codes, output streams, and the state after an interruption."""

import json
import math
import os
import re
import resource
import shlex
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import click
import numpy as np
import psutil
import pytest
import typer
from typer.testing import CliRunner

from evalkit import __version__, cli, metrics
from evalkit.cli import COMMANDS
from evalkit.commands.calibration import command as calibration
from evalkit.commands.compare.command import VERDICT_REPETITIONS
from evalkit.commands.metric_validation import command as metric_validation
from evalkit.core.errors import NotInstalled, StoreError
from evalkit.plugins import registry
from evalkit.results.reader import load_results_json
from evalkit.stats.runs import FEW_RUNS
from evalkit.terminal.command_spec import CommandSpec

pytestmark = [pytest.mark.slow(60), pytest.mark.usefixtures("strangers", "scoring_in_threads")]

FAULTY = '[[method]]\nuse = "faulty"\nlabel = "{0}"\nfault = "{0}"\n'
MAPPER = "[mapper]\nresolution_m = 0.25\n"


@pytest.fixture
def evalkit(monkeypatch, capsys):
    """Return ``evalkit(*words)``, which gives exit code, standard output and standard error."""
    handler = signal.getsignal(signal.SIGTERM)

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["evalkit", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr()
        return ended.value.code, said.out, said.err

    yield call
    signal.signal(signal.SIGTERM, handler)


@pytest.fixture
def experiment(tmp_path):
    """Return ``experiment(*faults)``, which writes an experiment file over the straight drive."""

    def write(*faults, more="", sequence="straight"):
        path = tmp_path / "small.toml"
        path.write_text(
            "".join(FAULTY.format(fault) for fault in faults) + more + MAPPER + f'[[sequence]]\nuse = "{sequence}"\n'
        )
        return path

    return write


def test_the_version_is_printed(evalkit):
    assert evalkit("--version") == (0, f"evalkit {__version__}\n", "")


def test_a_broken_program_is_a_failed_run_and_a_missing_one_is_not_installed(evalkit, tmp_path):
    for use, code, status in ((f"exec:{sys.executable} -c pass", 1, "failed"), ("exec:./nowhere", 0, "not-installed")):
        path = tmp_path / "small.toml"
        path.write_text(f'[[method]]\nuse = "{use}"\n{MAPPER}[[sequence]]\nuse = "straight"\n')
        exit_code, out, _ = evalkit("compare", "--no-page", path, "-o", tmp_path / status, "-j", 1, "--json")
        (row,) = json.loads(out)["runs"]
        assert (exit_code, row["status"]) == (code, status)
    assert "no program found" in row["reason"]


def test_without_a_command_the_help_lists_all_commands(evalkit):
    _, out, err = evalkit()
    assert all(command in out + err for command in COMMANDS)


def test_bash_completion_contains_the_commands(evalkit, monkeypatch):
    monkeypatch.setattr("shellingham.detect_shell", lambda: ("bash", "/bin/bash"))  # there may be no parent shell
    assert "complete -o default -F _evalkit_completion evalkit" in evalkit("--show-completion")[1]
    asked = {"_EVALKIT_COMPLETE": "complete_bash", "COMP_WORDS": "evalkit comp", "COMP_CWORD": "1"}
    for name, value in asked.items():
        monkeypatch.setenv(name, value)
    assert evalkit()[1].split() == ["compare"]


# --- list


def test_the_list_of_a_kind_shows_missing_requirements_with_reasons(evalkit):
    code, out, _ = evalkit("list", "backends")
    title, *rows = out.splitlines()  # piped output has one line per row
    assert (code, title) == (0, "backends")
    assert [row.split()[0] for row in rows] == registry.names("backends")
    (absent,) = (row for row in rows if row.split()[0] == "absent")
    assert absent.endswith("; not here: the library 'nowhere' is not installed; pip install nowhere")


def test_the_list_without_a_kind_has_all_names_and_is_short(evalkit):
    lines = evalkit("list")[1].splitlines()
    kinds = ("backends", "mappers", "datasets")
    assert lines[0:6:2] == [f"{kind}: evalkit list {kind}" for kind in kinds]
    assert [line.strip().split(", ") for line in lines[1:6:2]] == [registry.names(kind) for kind in kinds]
    assert lines[6:] == ["metrics: evalkit list metrics"]


def test_the_list_can_be_printed_as_json(evalkit):
    code, out, _ = evalkit("list", "all", "--json")
    listed = json.loads(out)
    assert code == 0
    assert sorted(listed) == ["backends", "datasets", "mappers", "metrics"]
    absent = next(row for row in listed["backends"] if row["name"] == "absent")
    assert absent["missing"] == "the library 'nowhere' is not installed; pip install nowhere"


def test_an_unknown_name_is_rejected_with_the_known_kinds(evalkit):
    code, _, err = evalkit("list", "backend")
    assert code == 2
    assert "no list or metric named 'backend' (did you mean 'backends'?)" in " ".join(err.split())
    code, _, err = evalkit("list", "robots")
    assert code == 2
    assert err.strip().endswith("known: all, backends, datasets, mappers, metrics")


def test_the_list_names_every_metric_with_unit_and_direction(evalkit):
    listed = json.loads(evalkit("list", "metrics", "--json")[1])["metrics"]
    assert [row["name"] for row in listed][: len(metrics.METRICS)] == [metric.name for metric in metrics.METRICS]
    by_name = {row["name"]: row for row in listed}
    assert (by_name["ate_rmse_m"]["unit"], by_name["ate_rmse_m"]["better"]) == ("m", "lower")
    group = json.loads(evalkit("list", "metrics", "--json", "--group", "relations")[1])["metrics"]
    assert {row["group"] for row in group} == {"relations"}
    assert "span_stretch_percent" in evalkit("list", "metrics")[1]


def test_the_card_of_a_metric_contains_all_its_fields(evalkit):
    text = evalkit("list", "wall_thickness_m")[1]
    parts = (
        "wall thickness [m], lower is better",
        "Limitations ",
        "Support                 places where hits lie along a line",
        "No value                no mapped scan has a hit; only ... % of the hits lie along a wall",
        "Follows the true error  Spearman ",
    )
    for part in parts:
        assert part in text
    card = json.loads(evalkit("list", "map_entropy", "--json")[1])
    assert card["follows_the_true_error"]["support"] > 90
    assert json.loads(evalkit("list", "ate_rmse_m", "--json")[1])["follows_the_true_error"] is None


def test_an_unknown_metric_or_group_is_rejected_with_the_closest_name(evalkit):
    code, _, err = evalkit("list", "map_entropi")
    assert (code, "did you mean 'map_entropy'" in " ".join(err.split())) == (2, True)
    code, _, err = evalkit("list", "metrics", "--group", "relation")
    assert (code, "relations" in err) == (2, True)
    assert evalkit("list", "backends", "--group", "relations")[0] == 2


# --- loading


def modules_after(*words):
    """Return the modules that an evalkit command imports, in a separate process."""
    program = (
        "import json, sys, evalkit.cli\ntry:\n evalkit.cli.main()\nfinally:\n print('\\n' + json.dumps([*sys.modules]))"
    )
    ended = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True, check=True)
    return set(json.loads(ended.stdout.splitlines()[-1]))


HEAVY = {
    "scipy",
    "pandas",
    "pooch",
    "matplotlib",
    "jinja2",
    "rosbags",
    "evalkit.metrics",
    "evalkit.execution.scheduler",
}


@pytest.mark.parametrize("words", [["--version"], ["--help"], ["list"], ["inspect", "--help"], ["compare", "--help"]])
def test_commands_without_computation_import_no_heavy_library(words):
    heavy = HEAVY if words[0] != "compare" else HEAVY - {"scipy", "evalkit.metrics", "evalkit.execution.scheduler"}
    assert heavy & modules_after(*words) == set()


@pytest.mark.parametrize("words", [["--version"], ["--help"], ["list"]])
def test_the_version_the_help_and_the_names_import_no_numerical_library(words):
    assert not (HEAVY | {"numpy", "psutil"}) & modules_after(*words)


def number_options(command):
    """Return the options of a command and its subcommands that take a number, but for seeds, which may be large."""
    found = [one for each in getattr(command, "commands", {}).values() for one in number_options(each)]
    numbers = (click.types.IntParamType, click.types.FloatParamType)
    return [*found, *(one for one in command.params if isinstance(one.type, numbers) and one.name != "seed")]


@pytest.mark.parametrize(
    "command",
    [
        *(
            pytest.param(lambda name=name: cli.load_command(name), id=name)
            for name in (*COMMANDS, "inspect", "datasets")
        ),
        pytest.param(lambda: typer.main.get_command(calibration.app), id="calibration"),
        pytest.param(lambda: typer.main.get_command(metric_validation.app), id="metric_validation"),
    ],
)
def test_every_option_with_a_number_refuses_more_than_its_largest_and_nan(command):
    for option in number_options(command()):
        with pytest.raises(click.BadParameter, match=rf"1{'0' * 30} is not in the range"):
            option.type.convert(f"1{'0' * 30}", option, None)
        with pytest.raises(click.BadParameter, match=r"nan'? is not a"):
            option.process_value(click.Context(click.Command("it")), "nan")


@pytest.mark.parametrize("command", [*COMMANDS, "inspect"])
def test_the_help_of_a_command_has_no_cut_word_at_80_columns(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = CliRunner().invoke(cli.app, [command, "--help"]).output
    assert "--" in text
    assert "…" not in text


@pytest.mark.parametrize("words", [[name] for name in (*COMMANDS, "inspect")] + [["datasets", "fetch"]])
def test_the_help_of_a_command_breaks_a_line_only_where_the_next_word_does_not_fit(words, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = CliRunner().invoke(cli.app, [*words, "--help"]).output.partition("╭")[0]
    paragraphs = [one.splitlines() for one in re.split(r"\n *\n", text)]
    broken = [(line, after.split()[0]) for lines in paragraphs for line, after in pairwise(lines) if after.strip()]
    assert [line for line, word in broken if line.strip() and len(line.rstrip()) + 1 + len(word) < 79] == []
    assert "``" not in text


def test_a_help_keeps_the_lines_of_a_marked_paragraph_and_joins_those_of_the_others(monkeypatch):
    def command() -> None:
        """Do it.

        One
        two ``three``.

        \b
        - first
        - second
        """

    monkeypatch.setattr(cli, "load_function", lambda _: command)
    assert cli.load_command("it").help == "Do it.\n\nOne two three.\n\n\b\n- first\n- second"


def test_the_summary_of_a_command_is_the_first_line_of_its_docstring():
    for name in (*COMMANDS, *registry.names("commands")):
        spec = COMMANDS.get(name) or registry.load("commands", name, CommandSpec)
        function = spec.load()
        text = function.info.help if isinstance(function, typer.Typer) else function.__doc__
        assert text.splitlines()[0] == spec.summary, name


def test_the_help_shows_every_command_in_its_panel(evalkit):
    out = evalkit("--help")[1]
    panels = re.findall(r"─ (.+?) ─+╮\n(.*?)╰", out, re.DOTALL)
    names = {title: re.findall(r"^│ ([a-z]+) ", text, re.MULTILINE) for title, text in panels[1:]}
    assert names == {
        "Start": ["compare", "inspect"],
        "My implementation": ["validate"],
        "Questions": ["basin", "realtime", "study", "tune"],
        "Results": ["diff", "export"],
        "Reference": ["schema", "list", "datasets"],
    }


def test_a_plugin_command_that_does_not_load_is_shown_with_the_reason_and_breaks_no_other(evalkit, monkeypatch):
    names, load = registry.names, registry.load

    def broken(kind, name, wanted):
        if name == "broken":
            raise NotInstalled(name, "its plug-in m:f does not load (no licence)", "reinstall its package")
        return load(kind, name, wanted)

    monkeypatch.setattr(registry, "names", lambda kind: [*names(kind), *(["broken"] if kind == "commands" else [])])
    monkeypatch.setattr(registry, "load", broken)
    code, out, _ = evalkit("--help")
    assert code == 0
    assert "does not load (no licence)" in " ".join(out.replace("│", " ").split())
    assert evalkit("--version")[0] == 0
    assert evalkit("list", "mappers")[0] == 0
    code, _, err = evalkit("broken")
    assert (code, "does not load (no licence)" in err) == (2, True)


# --- completion


def complete_words(monkeypatch, evalkit, line):
    monkeypatch.setenv("_EVALKIT_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(line.split(" ")) - 1))
    return set(evalkit()[1].split())


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("evalkit validate paper-m", {"paper-map", "paper-map-line"}),
        ("evalkit compare drive.bag --backends paper,kiss", {"paper,kiss-icp"}),
        ("evalkit basin --on turt", {"turtlebot4"}),
        ("evalkit list map_entr", {"map_entropy"}),
        ("evalkit list me", {"metrics"}),
        ("evalkit export --format mc", {"mcap"}),
        ("evalkit export --metric ate_rm", {"ate_rmse_m"}),
        ("evalkit compare --engine da", {"dask"}),
        ("evalkit validate paper --only lo", {"lockstep"}),
    ],
)
def test_the_shell_completes_names(monkeypatch, evalkit, line, expected):
    assert complete_words(monkeypatch, evalkit, line) == expected


# --- names are checked before anything runs


@pytest.mark.parametrize(
    ("words", "more", "message"),
    [
        ((), '[[method]]\nuse = "ipc"\n', "no backend named 'ipc'; known: absent, "),
        ((), '[[method]]\nuse = "paper"\nkeyframe = 3\n', "no parameter named 'keyframe' (did you mean 'keyfram"),
        (("--method", "non"), "", "no method named 'non' (did you mean 'none'?); known: none"),
        (("--sequence", "bent"), "", "no sequence named 'bent'; known: straight"),
        (("--resume", "--seed", "3"), "", "no seed named '3'; known: none"),
    ],
)
@pytest.mark.parametrize("command", [["--no-page"], []])
def test_unknown_names_are_reported_with_the_known_ones_and_nothing_runs(
    evalkit, experiment, tmp_path, command, words, more, message
):
    folder = tmp_path / "out"
    code, out, err = evalkit("compare", *command, experiment("none", more=more), "--out", folder, *words)
    assert (code, out) == (2, "")
    assert message in err.replace("\n", "")
    assert not folder.exists()


def test_a_missing_experiment_file_is_reported(evalkit, tmp_path):
    code, _, err = evalkit("compare", "--no-page", tmp_path / "absent.toml")
    assert code == 2
    assert "absent.toml: no such file" in err


# --- run


def test_a_failed_run_is_exit_code_1_and_a_plain_line_and_the_other_runs_are_kept(evalkit, experiment, tmp_path):
    code, out, err = evalkit(
        "compare", "--no-page", experiment("none", "raise"), "--out", tmp_path / "out", "-j", 2, "--json"
    )
    assert code == 1
    assert "\x1b" not in err
    lines = err.splitlines()
    assert [line.split("straight")[0] for line in lines] == ["[1/2] ", "[2/2] "]
    failed = "straight / raise: failed (RuntimeError: lost the plot; at scan 9 (stamp 800000000 ns)), "
    assert sum(failed in line for line in lines) == 1, lines
    assert sum("straight / none: complete, " in line for line in lines) == 1
    result = json.loads(out)  # alone on standard output
    assert result["page"] is None
    assert [(row["method"], row["status"], row["seed"]) for row in result["runs"]] == [
        ("none", "complete", None), ("raise", "failed", None),
    ]  # fmt: skip
    assert result["runs"][0]["scores"]["ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)


def test_a_method_that_is_not_installed_is_not_a_failure(evalkit, experiment, tmp_path):
    path = experiment(more='[[method]]\nuse = "absent"\n')
    code, out, err = evalkit("compare", "--no-page", path, "--out", tmp_path / "out")
    assert (code, out) == (0, "0 runs complete, 0 failed, 1 not available here: absent\n")
    assert (
        err.splitlines()[0] == "not available here: absent: the library 'nowhere' is not installed; pip install nowhere"
    )
    assert err.count("the library 'nowhere' is not installed") == 1  # once, not once a run


def test_a_results_folder_that_is_a_file_is_exit_code_2(evalkit, experiment, tmp_path):
    (tmp_path / "out").touch()
    code, _, err = evalkit("compare", "--no-page", experiment("none"), "--out", tmp_path / "out")
    assert code == 2
    assert "out: cannot be written (a file of this name exists); name another folder\n" in err
    assert "name another folder" in err


# --- interrupted runs


def started(path, folder, *words, **how):
    command = [
        sys.executable,
        "-c",
        "from evalkit.cli import main; main()",
        "compare",
        "--no-page",
        path,
        "--out",
        folder,
        *words,
    ]
    return subprocess.Popen(
        list(map(str, command)),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **how,
    )


@pytest.mark.parametrize("ending", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.thorough)])
def test_an_interrupt_keeps_finished_runs_and_leaves_no_process(experiment, tmp_path, wait_for, ending):
    folder = tmp_path / "out"
    process = started(experiment("none", "hang", "raise"), folder, "-j", "1")
    assert wait_for(lambda: answers(folder, "hang"))
    os.killpg(process.pid, ending)  # to the whole foreground process group, like a terminal
    _, err = process.communicate(timeout=600.0)
    assert process.returncode == 128 + ending
    assert "finished runs are kept: repeat the command with --resume to continue\nevalkit: interrupted\n" in err
    assert "Traceback" not in err
    assert [run.parent.name.rsplit("-", 1)[0] for run in folder.glob("runs/*/result.json")] == ["straight-none"]
    assert not list(folder.glob("runs/straight-raise-*"))
    assert wait_for(lambda: not [one for one in psutil.process_iter(["cmdline"]) if str(folder) in str(one.info)])


def test_a_disk_that_fills_up_is_exit_code_2_and_a_message(experiment, tmp_path):
    def small_disk():
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))

    process = started(experiment("none"), tmp_path / "out", preexec_fn=small_disk)
    _, err = process.communicate(timeout=600.0)
    assert process.returncode == 2
    assert "cannot be written (File too large); free some space or name another folder" in err
    assert "Traceback" not in err


def test_a_runner_that_is_killed_loses_no_result_and_leaves_no_process(experiment, tmp_path, wait_for):
    path, folder = experiment("none", "daemon", "raise"), tmp_path / "out"
    process = started(path, folder, "-j", "1")
    assert wait_for(lambda: answers(folder, "daemon"))
    (done,) = folder.glob("runs/straight-none-*/steps.bin")
    kept = done.read_bytes(), done.stat().st_mtime_ns
    process.kill()
    process.wait()
    again = started(path, folder, "-j", "1", "--resume", "--sequence", "straight", "--method", "none",
                    "--method", "raise")  # fmt: skip
    again.communicate(timeout=600.0)
    assert (done.read_bytes(), done.stat().st_mtime_ns) == kept
    assert len(list(folder.glob("runs/*/result.json"))) == 2
    assert wait_for(lambda: not workers(folder))


def answers(folder, method):
    """Return the number of bytes of answers that a method has written."""
    return sum(path.stat().st_size for path in folder.glob(f"runs/straight-{method}-*/steps.bin"))


def workers(folder):
    """Return the processes that run a back end in a results folder."""
    lines = (other.info["cmdline"] or [] for other in psutil.process_iter(["cmdline"]))
    return [line for line in lines if "evalkit.execution.one_run" in line and str(folder) in line[-1]]


@pytest.fixture
def small_disk(tmp_path):
    """A disk of 400 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=400k", "tmpfs", folder], check=False, capture_output=True
    )
    if made.returncode:
        pytest.skip("mounting a small disk takes the rights of an administrator")
    yield folder
    subprocess.run(["umount", folder], check=True)


@pytest.mark.thorough
def test_a_disk_that_is_full_stops_the_command_and_keeps_finished_runs(experiment, small_disk):
    path = experiment("none", "raise", "nan")
    first = started(path, small_disk / "out", "-j", "1")
    first.communicate(timeout=600.0)
    assert first.returncode == 1
    room = os.statvfs(small_disk)
    (small_disk / "filler").write_bytes(bytes((room.f_bavail - 1) * room.f_bsize))
    full = started(experiment("none", "far"), small_disk / "out", "-j", "1", "--resume")
    _, err = full.communicate(timeout=600.0)
    assert full.returncode == 2
    assert "No space left on device); free some space or name another folder" in err
    assert "Traceback" not in err
    (small_disk / "filler").unlink()
    last = started(experiment("none", "far"), small_disk / "out", "-j", "1", "--resume", "--json")
    out, _ = last.communicate(timeout=600.0)
    assert [row["status"] for row in json.loads(out)["runs"]] == ["complete", "complete"]


def test_collect_leaves_a_report_alone_to_which_no_finished_run_belongs(evalkit, experiment, tmp_path):
    page = tmp_path / "out" / "index.html"
    page.parent.mkdir()
    page.write_text("an earlier report")
    code, _, err = evalkit("compare", experiment("none"), "--out", tmp_path / "out", "--collect")
    assert code == 3
    assert "no finished run of this experiment; run it without --collect" in err
    assert page.read_text() == "an earlier report"


def test_a_report_of_a_part_says_which_command_reports_all(evalkit, experiment, tmp_path):
    file, folder = experiment("none", "raise"), tmp_path / "out"
    assert "leaves out" not in evalkit("compare", file, "--out", folder)[2]
    code, _, err = evalkit("compare", file, "--out", folder, "--resume", "--method", "none")
    note = f"this report leaves out 1 finished run in this folder; with all: evalkit compare {file} --collect"
    assert (code, note in err) == (0, True)
    assert len(json.loads((folder / "results.json").read_text())["runs"]) == 1
    evalkit("compare", file, "--collect", "--out", folder)
    assert len(json.loads((folder / "results.json").read_text())["runs"]) == 2


def test_runs_without_a_page_say_that_the_report_in_their_folder_is_older(evalkit, experiment, tmp_path):
    file, folder = experiment("none"), tmp_path / "out"
    words = ("compare", "--no-page", file, "--out", folder)
    note = f"the report in this folder is of before these runs; evalkit compare {file} --collect --out {folder} writes"
    assert note not in evalkit(*words)[2]  # there is none
    evalkit("compare", file, "--out", folder, "--collect")
    assert note not in evalkit(*words, "--resume")[2]  # no run is repeated
    assert note in evalkit(*words)[2]


def test_a_resumed_comparison_says_how_many_runs_were_stored_with_other_settings(evalkit, experiment, tmp_path):
    file, folder = experiment("none", "raise"), tmp_path / "out"
    words = ("compare", "--no-page", file, "--out", folder, "--resume")
    evalkit(*words, "--method", "none")
    note = "executed again: stored with other code, libraries, settings or data"
    assert note not in evalkit(*words)[2]  # one run is finished, the other was never stored
    file.write_text(file.read_text().replace('fault = "none"', 'fault = "none"\nat = 5'))
    assert f"1 run is {note}" in evalkit(*words)[2]
    assert note not in evalkit(*words)[2]


def test_a_folder_without_a_report_is_told_how_to_get_one(evalkit, experiment, tmp_path):
    evalkit("compare", "--no-page", experiment("none"), "--out", tmp_path / "out")
    with pytest.raises(StoreError, match="repeat it with --collect in place of --no-page"):
        load_results_json(tmp_path / "out")
    assert evalkit("compare", experiment("none"), "--out", tmp_path / "out", "--collect")[0] == 0
    assert load_results_json(tmp_path / "out")["runs"]


def test_missing_runs_are_exit_code_3_and_an_unknown_status_is_rejected(evalkit, experiment, tmp_path):
    assert evalkit("compare", "--no-page", experiment("none"), "--out", tmp_path / "out")[0] == 0
    code, out, _ = evalkit("compare", "--no-page", experiment("none", "raise"), "--out", tmp_path / "out", "--collect")
    assert code == 3
    assert out.splitlines() == [
        "1 run complete, 0 failed, 0 not available here",
        "1 not run yet: raise on straight",
    ]
    code, _, err = evalkit("compare", "--no-page", experiment("none"), "--out", tmp_path / "out", "--rerun", "sleepy")
    assert code == 2
    assert "found 'sleepy', expected one of: complete, failed, crashed" in " ".join(err.replace("│", " ").split())


# --- compare


def box(x):
    """Return the ranges (m) in a box of 8 x 4 m, 180 beams to the front, at x on the centre line."""
    angles = np.radians(np.arange(-90.0, 90.0))
    with np.errstate(divide="ignore"):
        return np.minimum((8.0 - x) / np.cos(angles), 2.0 / np.abs(np.sin(angles)))


TRUE_X = 1.0 + 0.1 * np.arange(24)
WHEEL_X = 1.0 + 0.11 * np.arange(24)  # wheel odometry may be scaled by a tenth


@pytest.fixture
def carmen(tmp_path):
    """Write a CARMEN log with true trajectory and relations, of a straight drive with wheels 10 % too small."""
    lines, poses = [], []
    for index, (x, wheel_x) in enumerate(zip(TRUE_X, WHEEL_X, strict=True)):
        robot = f"{wheel_x} 0 0"
        ranges = " ".join(f"{r:.4f}" for r in box(x))
        lines.append(f"FLASER 180 {ranges} {robot} {robot} {100 + 0.1 * index:.6f} robot 0.5")
        poses.append(f"{100 + 0.1 * index:.6f} {x} 0 0 0 0 0 1")
    (tmp_path / "drive.log").write_text("\n".join(lines) + "\n")
    (tmp_path / "true.tum").write_text("\n".join(poses) + "\n")
    (tmp_path / "true.relations").write_text("100.0 101.0 1.0 0 0 0 0 0\n101.0 102.0 1.0 0 0 0 0 0\n")
    (tmp_path / "tape.toml").write_text("[[span]]\nfrom = 100.0\nto = 101.0\nmetres = 1.0\n")
    return tmp_path / "drive.log"


def test_a_carmen_log_is_compared_by_one_command(evalkit, carmen, tmp_path):
    folder = tmp_path / "out"
    code, out, _ = evalkit(
        "compare", carmen, "--ground-truth", tmp_path / "true.tum", "--relations", tmp_path / "true.relations",
        "--spans", tmp_path / "tape.toml", "--backends", "wheel-odometry, paper", "--out", folder, "--json",
    )  # fmt: skip
    assert code == 0
    result = json.loads(out)
    assert Path(result["page"]) == folder / "index.html"
    assert (folder / "index.html").stat().st_size > 10_000
    wheels, paper = (row["scores"] for row in result["runs"])
    assert wheels["relations_all_mean_m"] == pytest.approx(0.1, abs=1e-6)
    assert paper["relations_all_mean_m"] < 0.05
    assert (wheels["span_rmse_m"], wheels["span_stretch_percent"]) == pytest.approx((0.1, 10.0), abs=1e-5)
    assert paper["span_rmse_m"] < 0.05
    assert paper["ate_rmse_m"] < 0.5 * wheels["ate_rmse_m"]
    assert "--backends wheel-odometry,paper" in (folder / "results.json").read_text()


def test_without_truth_the_fit_to_the_map_ranks_and_the_use_of_the_map_is_stated(evalkit, carmen, tmp_path):
    """The wheels, 10 % too small, leave the known map by 0.1 m at half of the drive and 0.23 m at its end."""
    cells = np.full((84, 164), 254, dtype=np.uint8)  # 5 cm each: the box of 8 x 4 m, its walls two cells thick
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 0, 0, 0, 0
    (tmp_path / "box.pgm").write_bytes(b"P5 164 84 255\n" + cells.tobytes())
    (tmp_path / "box.yaml").write_text(
        "image: box.pgm\nresolution: 0.05\norigin: [-0.1, -2.1, 0.0]\nnegate: 0\noccupied_thresh: 0.65\n"
        "free_thresh: 0.196\n"
    )
    code, out, _ = evalkit(
        "compare", carmen, "--as-is", "--map", tmp_path / "box.yaml", "--start", "1,0,0", "--backends",
        "wheel-odometry,distance-field", "--out", tmp_path / "out",
    )  # fmt: skip
    assert code == 0
    lines = [line.replace("\u00a0", " ").split() for line in out.splitlines()]
    head = next(at for at, line in enumerate(lines) if line[:5] == ["wrong", "by", "map", "fit,", "drive.log"])
    assert [line[0] for line in lines[head + 1 : head + 3]] == ["distance-field", "wheel-odometry"]
    wheels, field = (next(one for one in lines if one[:2] == words) for words in (
        ["wheel-odometry", "start"], ["distance-field", "matched"]))  # fmt: skip
    assert (wheels[2:4], field[2]) == (["only", "given"], "given")
    assert float(field[-2]) < 5.0 < 20.0 < float(wheels[-2])


def ros_bag(path):
    """Write a ROS 1 bag of the same drive: /scan and /odom."""
    rosbag1, typesys = pytest.importorskip("rosbags.rosbag1"), pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)

    def make(name, *values):
        return store.types[name](*values)

    def header(index, frame):
        stamp = make("builtin_interfaces/msg/Time", 100 + index // 10, index % 10 * 100_000_000)
        return make("std_msgs/msg/Header", index, stamp, frame)

    def scan(index, x):
        ranges, none = box(x).astype(np.float32), np.zeros(0, dtype=np.float32)
        angles = (-math.pi / 2, math.radians(89.0), math.radians(1.0))
        return make("sensor_msgs/msg/LaserScan", header(index, "base_link"), *angles, 0.0, 0.1, 0.1, 20.0, ranges, none)

    def odom(index, x):
        place = make("geometry_msgs/msg/Point", x, 0.0, 0.0), make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
        still = make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        pose = make("geometry_msgs/msg/PoseWithCovariance", make("geometry_msgs/msg/Pose", *place), np.zeros(36))
        twist = make(
            "geometry_msgs/msg/TwistWithCovariance", make("geometry_msgs/msg/Twist", still, still), np.zeros(36)
        )
        return make("nav_msgs/msg/Odometry", header(index, "odom"), "base_link", pose, twist)

    with rosbag1.Writer(path) as writer:
        topics = {"/odom": "nav_msgs/msg/Odometry", "/scan": "sensor_msgs/msg/LaserScan"}
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in topics.items()}
        for index, (x, wheel_x) in enumerate(zip(TRUE_X, WHEEL_X, strict=True)):
            for topic, message in (("/odom", odom(index, float(wheel_x))), ("/scan", scan(index, float(x)))):
                raw = store.serialize_ros1(message, topics[topic])
                writer.write(connections[topic], (1000 + index) * 100_000_000, raw)


def test_the_repetitions_that_compare_proposes_are_enough_for_a_verdict():
    assert VERDICT_REPETITIONS + 1 == FEW_RUNS


@pytest.mark.thorough
def test_after_one_run_of_several_methods_the_command_that_gives_a_verdict_is_printed(evalkit, tmp_path):
    """Six runs give a verdict; the runs that exist are kept, and no further command repeats them."""
    ros_bag(tmp_path / "drive.bag")
    call = ["compare", tmp_path / "drive.bag", "--backends", "wheel-odometry,paper"]
    _, out, _ = evalkit(*call, "--out", tmp_path / "out")
    said = [line for line in out.splitlines() if line.startswith("next: ")]
    assert len(said) == 2
    again, _ = said[0].removeprefix("next: evalkit ").split(" (for a verdict)")
    assert f"--nuisance {FEW_RUNS - 1} --resume" in again
    code, out, _ = evalkit(*shlex.split(again))
    assert code == 0
    assert "12 runs complete, 0 failed, 0 not available here" in out
    assert "(for a verdict)" not in out


@pytest.mark.parametrize(("method", "announced"), [((), True), (("--method", "wheel-odometry"), False)])
def test_the_default_methods_are_announced_only_if_all_of_them_run(evalkit, tmp_path, method, announced):
    ros_bag(tmp_path / "drive.bag")
    _, _, said = evalkit("compare", tmp_path / "drive.bag", *method, "--collect", "--out", tmp_path / "out")
    assert ("6 methods: " in said) == announced


def test_a_ros_bag_is_compared_by_one_command(evalkit, carmen, tmp_path):
    ros_bag(tmp_path / "drive.bag")
    code, out, _ = evalkit(
        "compare", tmp_path / "drive.bag", "--topic", "/scan", "--ground-truth", tmp_path / "true.tum",
        "--backends", "paper,wheel-odometry", "--method", "paper", "--set", "every=2", "--out", tmp_path / "out",
    )  # fmt: skip
    assert code == 0
    answer, *_, counts, page, following = out.splitlines()
    assert answer == "Only paper is ranked: there is no other method to compare it with."
    assert counts == "1 run complete, 0 failed, 0 not available here"
    assert Path(page) == tmp_path / "out" / "index.html"
    assert following == f"next: evalkit export {tmp_path / 'out'} -f latex (tables for a paper)"
    trial = json.loads((tmp_path / "out" / "results.json").read_text())["runs"][0]
    assert (trial["scans_answered"], trial["dataset_parameters"]["every"]) == (12, 2)
    assert trial["scores"]["ate_rmse_m"]["value"] < 0.05


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ("validate", "paper", "--only", "rule"),
            "'rule' is not one of 'rules', 'registrations', 'lockstep', 'determinism'",
        ),
        (("validate", "paper", "--claim", "better"), "'better' is not one of 'equal', 'as-good'"),
        (("realtime", "paper", "--policy", "wait"), "'wait' is not one of 'drop', 'queue-of-one'"),
        (("compare", "exp.toml", "--engine", "ray"), "'ray' is not one of 'local', 'dask'"),
        (("export", "results", "--format", "csv", "--width", "page"), "'page' is not one of 'column', 'text'"),
    ],
)
def test_an_option_with_a_fixed_choice_names_what_it_takes(evalkit, words, message):
    code, _, err = evalkit(*words)
    assert (code, message in " ".join(err.replace("│", "").split())) == (2, True), err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("absent.bag",), "absent.bag: no such file or folder; give the path of a bag or a log"),
        (("drive.log", "--relations", "no.relations"), "carmen: parameter 'relations': no file no.relations; check"),
        (
            ("drive.log", "--ground-truth", "other.tum"),
            "do not overlap the recording, 100",
        ),
        (
            ("drive.log", "--spans", "no.toml"),
            "carmen: parameter 'spans': no file no.toml; check the path, which begins at the working folder",
        ),
        (("drive.log", "--spans", "drive.log"), "drive.log: not valid TOML ("),
        (("drive.log", "--spans", "negative.toml"), "span 1: metres: expected a positive number, got -1.0"),
        (("cut.bag",), "cut.bag: not a readable bag ("),
        (("drive.log", "--set", "every"), "--set: parameter 'every': found 'every', expected NAME=VALUE"),
        (
            ("drive.log", "--set", "every=2", "--set", "every=3"),
            "'every': found '3', expected one value, but '2' is given",
        ),
        (("drive.log", "--spans", "no.toml", "--set", "spans=negative.toml"), "--spans: contradicts --set spans"),
        (
            ("drive.log", "--set", "path=cut.bag"),
            "'path': found 'cut.bag', expected one path, but drive.log is given too",
        ),
        (
            ("drive.log", "--set", "every=x"),
            "parameter 'every': found 'x', expected a whole number (take every n-th scan)",
        ),
        (("drive.log", "--start", "1,2,90"), "--start: needs --map"),
        (("drive.log", "--align-truth"), "--align-truth: needs --map"),
        (("drive.log", "--backends", "papr"), "no backend named 'papr' (did you mean 'paper'?)"),
        (("drive.log", "--backends", "paper", "--topic", "/scan"), "no parameter named 'topic'"),
        (
            ("drive.log", "--backends", "wheel-odometry,paper", "--set", "keyframes=20"),
            "carmen: no parameter named 'keyframes' (a parameter of paper: set it below [[method]] of an experiment",
        ),
        (
            ("drive.log", "--backends", "paper keyframes=20"),
            "no backend named 'paper keyframes=20' (set it below [[method]] of an experiment, with the [[sequence]] "
            "that evalkit inspect prints)",
        ),
    ],
)
def test_an_invalid_comparison_is_rejected_before_the_first_run(evalkit, carmen, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    Path("other.tum").write_text("9000.0 0 0 0 0 0 0 1\n9001.0 1 0 0 0 0 0 1\n")
    Path("negative.toml").write_text("[[span]]\nfrom = 100.0\nto = 101.0\nmetres = -1.0\n")
    Path("cut.bag").write_bytes(b"#ROSBAG V2.0\n\x45\x00\x00\x00")
    code, _, err = evalkit("compare", *words)
    assert code == 2
    assert "Traceback" not in err
    assert message in err.replace("\n", "")
    assert not Path("reports").exists()
