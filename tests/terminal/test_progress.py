"""Time estimates, calculated by hand, and the progress lines of a pipe."""

import io
import itertools
import time
from dataclasses import replace

import pytest
import typer
from rich.table import Table

from evalkit.config.experiment import Method, SequenceSpec
from evalkit.config.experiment_file import experiment_from_tables
from evalkit.core.run_result import NO_STEPS, RunResult
from evalkit.core.run_status import BROKEN, Cause, RunStatus
from evalkit.terminal import options
from evalkit.terminal.console import WordConsole
from evalkit.terminal.progress import TaskLines, TimeLeft, format_unavailable, print_table, show_runs, show_tasks


@pytest.fixture
def make_plan():
    """Two methods, one sequence with two seeds and one with one seed."""
    content = {
        "method": [{"use": "wheel-odometry", "label": "fast"}, {"use": "paper", "label": "slow"}],
        "sequence": [{"use": "room", "seeds": [0, 1]}, {"use": "lab"}],
    }
    return list(experiment_from_tables(content, "x.toml", "x", "compare x.toml").runs())


def test_the_time_left_is_unknown_before_the_first_run_ends(make_plan):
    assert TimeLeft(make_plan, 1).seconds() is None


def test_after_one_run_all_others_are_assumed_equal(make_plan):
    left = TimeLeft(make_plan, 1)
    left.finished("room", "fast", 4.0)
    assert left.seconds() == pytest.approx(5 * 4.0)


def test_an_open_run_takes_its_sequence_mean_times_its_method_ratio(make_plan):
    """Room: fast 1 s, slow 3 s, so mean 2 s: ratios 1/2 and 3/2. Open: room 1 and lab 0, without a finished run."""
    left = TimeLeft(make_plan, 1)
    left.finished("room", "fast", 1.0)
    left.finished("room", "slow", 3.0)
    assert left.seconds() == pytest.approx(1.0 + 3.0 + 1.0 + 3.0)
    left.finished("lab", "fast", 5.0)  # mean 3; fast 3, slow 3; room 2, lab 5
    assert left.seconds() == pytest.approx(2.0 * 3.0 / 3.0 + 2.0 * 3.0 / 3.0 + 5.0 * 3.0 / 3.0)


def test_two_jobs_halve_the_time_left_and_zero_is_left_at_the_end(make_plan):
    left = TimeLeft(make_plan, 2)
    left.finished("room", "fast", 4.0)
    assert left.seconds() == pytest.approx(5 * 4.0 / 2)
    for item in make_plan[1:]:
        left.finished(item.sequence.label, item.method.label, 4.0)
    assert left.seconds() == 0.0


def test_a_pipe_gets_one_plain_line_per_run_with_its_reason(make_plan, monkeypatch):
    printed = io.StringIO()
    monkeypatch.setattr(time, "monotonic", itertools.count(0.0, 2.0).__next__)
    crashed = RunResult(NO_STEPS, 0, Cause.SIGNAL, "signal [bold]11[/bold]")
    with show_runs(WordConsole(file=printed, soft_wrap=True), make_plan, 1) as shown:
        for spec, result in zip(make_plan, [RunResult(NO_STEPS, 0), crashed], strict=False):
            shown.started(spec)
            shown.answered(spec, 7)
            shown.finished(spec, result)
    first, second = printed.getvalue().splitlines()
    assert first.startswith("[1/6] room seed 0 / fast: complete, 2.0 s, 0:10 left")
    assert second.startswith("[2/6] room seed 0 / slow: crashed (signal [bold]11[/bold]), 2.0 s")


def test_unavailable_methods_are_one_line_per_reason_with_system_packages_first(make_plan):
    content = {"method": [{"use": "wheel-odometry"}], "sequence": [{"use": "room"}]}
    plan = experiment_from_tables(content, "x.toml", "x", "compare x.toml")
    assert format_unavailable(plan) == []
    pip, apt = "not installed: pip install x", "needs libGL:\napt-get install libgl1"
    methods = [Method(label, "", {}, why) for label, why in (("a", pip), ("b", apt), ("c", apt), ("d", ""))]
    sequences = (SequenceSpec("e", "", {}, (None,), "no file e"),)
    assert format_unavailable(replace(plan, methods=tuple(methods), sequences=sequences)) == [
        "not available here: b, c: needs libGL: apt-get install libgl1",
        "not available here: a: not installed: pip install x",
        "not available here: e: no file e",
    ]


def test_a_terminal_gets_a_line_only_for_what_did_not_complete(make_plan):
    told = io.StringIO()
    screen = WordConsole(file=told, force_terminal=True, width=100, color_system=None)
    with show_runs(screen, make_plan, 1) as shown:
        shown.finished(make_plan[0], RunResult(NO_STEPS, 0))
        shown.answered(make_plan[1], 1234)
        shown.finished(make_plan[1], RunResult(NO_STEPS, 0, Cause.TIME_LIMIT, "[late]"))
    assert "room seed 0 / slow: timeout ([late]), 0.0 s" in told.getvalue()
    assert "room seed 0 / fast: complete" not in told.getvalue()


def test_the_last_task_line_counts_stored_results_and_the_time_left():
    told = io.StringIO()
    with show_tasks(WordConsole(file=told, width=100), 3, 2) as done:
        done("first", 0.0)
        done("second", 4.0)
        done("third", 2.0)
    assert told.getvalue().splitlines() == ["[3/3] third, 0:00 left, 1 kept from before"]


def test_the_time_left_of_tasks_is_their_mean_divided_by_the_workers():
    told = io.StringIO()
    lines = TaskLines(WordConsole(file=told, width=100), 5, 2)
    lines.EVERY_S = 0.0
    lines("first", 30.0)
    assert told.getvalue() == "[1/5] first, 1:00 left\n"


def test_a_unit_in_the_heading_of_a_table_is_no_markup():
    printed = io.StringIO()
    print_table(
        WordConsole(file=printed, force_terminal=True, color_system=None, width=80), Table("reach [m]", "A50 [deg]")
    )
    assert "reach [m]" in printed.getvalue()
    assert "A50 [deg]" in printed.getvalue()


def test_a_table_on_a_terminal_cuts_no_word():
    printed = io.StringIO()
    table = Table("back end", *(f"A{n} [m]" for n in range(5)), "remark")
    table.add_row("embedded-map-line", *(["25 (5 to 70)"] * 5), "")
    print_table(WordConsole(file=printed, force_terminal=True, color_system=None, width=80), table)
    text = printed.getvalue()
    assert "…" not in text
    assert "embedded-map-line" in text
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize(("columns", "lines"), [("60", 3), ("", 1)])
def test_a_row_that_is_piped_is_folded_to_columns_where_it_is_set(monkeypatch, capsys, columns, lines):
    monkeypatch.setenv("COLUMNS", columns)
    table = Table("text")
    table.add_row("word " * 30)
    print_table(WordConsole(), table)
    assert sum("word" in line for line in capsys.readouterr().out.splitlines()) == lines


def test_names_in_the_first_column_stay_whole_where_other_words_must_be_folded():
    printed = io.StringIO()
    table = Table("method", *(f"within {'x' * 12}" for _ in range(6)))
    table.add_row("correlative", *(["0.1234567890"] * 6))
    print_table(WordConsole(file=printed, force_terminal=True, color_system=None, width=80), table)
    assert "correlative" in printed.getvalue()
    assert max(map(len, printed.getvalue().splitlines())) <= 80


def test_options_of_execution_that_contradict_are_refused():
    given = {"jobs": 1, "resume": False, "collect": False}
    with pytest.raises(typer.BadParameter, match="--rerun: found 'lost', expected one of: complete, failed"):
        options.RunOptions.of(rerun=["lost"], **given)
    with pytest.raises(typer.BadParameter, match="--scheduler: needs --engine dask"):
        options.RunOptions.of(rerun=[], scheduler="tcp://a:1", **given)
    found = options.RunOptions.of(rerun=["failed", "skipped"], **given)
    assert (found.resume, found.rerun) == (True, BROKEN | {RunStatus.SKIPPED})
