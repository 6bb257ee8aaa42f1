"""Lists on terminals of any width: no word is cut, and a pipe gets one line a row."""

import io

import pytest
from rich.console import Console

from evalkit.terminal.console import WordConsole
from evalkit.terminal.text_list import format_row, print_hanging, print_list


def test_a_text_is_wrapped_beside_its_name_and_a_long_word_stays_whole():
    assert format_row("ab", "one two three", 6, 26) == "  ab  one two three"
    assert format_row("ab", f"one {'x' * 30} two", 6, 26) == f"  ab  one\n    {'x' * 30}\n      two"
    assert format_row("ab", f"{'x' * 21} two", 6, 26) == f"  ab\n     {'x' * 21}\n      two"
    assert format_row("ab", "one " * 30, 6, 0) == "  ab  " + ("one " * 30).rstrip()
    assert format_row("ab", "", 6, 26) == "  ab"


@pytest.mark.parametrize("terminal", [True, False])
def test_only_a_terminal_wraps(terminal):
    printed = io.StringIO()
    console = WordConsole(file=printed, force_terminal=terminal, color_system=None, width=30)
    print_list(console, "kinds", [("a", "[m] is a unit, no mark-up " * 3)])
    print_hanging(console, "wide " * 20)
    console.print("plain words of a line longer than the console", markup=False)
    console.print("/a/path/" + "x" * 60, markup=False)
    lines = printed.getvalue().splitlines()
    assert printed.getvalue().count("[m]") == 3
    assert lines[-1] == "/a/path/" + "x" * 60
    assert (max(map(len, lines[:-1])) <= 30) == terminal
    assert terminal or len(lines) == 5


def test_the_wrapped_lines_of_a_text_are_indented():
    printed = io.StringIO()
    print_hanging(Console(file=printed, force_terminal=True, color_system=None, width=10), "one two three")
    assert printed.getvalue() == "one two\n    three\n"
