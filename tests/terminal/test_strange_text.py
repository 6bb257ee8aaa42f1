"""Text of strangers on the terminal: shown, not obeyed."""

import errno
import io
import sys

import pytest
from rich.progress import Progress, TextColumn
from rich.table import Table
from rich.text import Text

from evalkit.terminal.console import WordConsole
from evalkit.terminal.entry_point import run
from evalkit.terminal.progress import TaskLines, print_table

STRANGE = "a:x:b \x1b[31mred\x1b[2J \u202eevil\u00a05 m"
SHOWN = r"a:x:b \x1b[31mred\x1b[2J \u202eevil" + "\u00a05 m"


def show_line(console):
    console.print(STRANGE, markup=False, highlight=False)


def show_cell(console):
    table = Table("name")
    table.add_row(Text(STRANGE))
    print_table(console, table)


def show_marked_cell(console):
    table = Table("name")
    table.add_row(STRANGE)
    print_table(console, table)


@pytest.mark.parametrize("show", [show_line, show_cell, show_marked_cell])
@pytest.mark.parametrize("terminal", [False, True])
def test_control_characters_are_shown_and_colons_are_no_picture(show, terminal, capsys):
    file = io.StringIO()
    show(WordConsole(file=file, force_terminal=terminal, color_system=None, width=120))
    printed = file.getvalue() + capsys.readouterr().out  # a table that is piped has a console of its own
    assert "a:x:b" in printed
    assert not any(obeyed in printed for obeyed in ("\x1b[31m", "\x1b[2J", "\u202e"))
    assert (SHOWN if show is show_line else SHOWN[:20]) in printed  # a cell is cut at the width of its text


def test_what_a_progress_bar_shows_is_no_mark_up():
    file = io.StringIO()
    lines = TaskLines(WordConsole(file=file, force_terminal=True, color_system=None, width=120), 1, 1)
    assert isinstance(lines.bar, Progress)
    lines.show("[bold]:x:[/bold] \x1b[2J", "0:01 left")
    lines.bar.refresh()
    (task,) = lines.bar.tasks
    (column,) = (one for one in lines.bar.columns if isinstance(one, TextColumn))
    assert (
        column.render(task).plain == "0:01 left  [bold]:x:[/bold] \x1b[2J"
    )  # a text; the console shows its control characters


def test_a_fault_of_the_machine_anywhere_is_one_line(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["evalkit", "compare"])

    def no_more_files():
        raise OSError(errno.EMFILE, "Too many open files")

    with pytest.raises(SystemExit) as ended:
        run(no_more_files)
    assert ended.value.code == 2
    said = "evalkit compare: the machine failed (Too many open files); free disk, memory, /dev/shm, open files"
    assert said in " ".join(capsys.readouterr().err.split())

    def no_file():
        raise FileNotFoundError(errno.ENOENT, "No such file")

    with pytest.raises(FileNotFoundError):
        run(no_file)
