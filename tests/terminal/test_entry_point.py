"""Every command: strange arguments, variables and terminals give one line, never a traceback."""

import errno
import io
import os
import signal
import subprocess
import sys

import pytest

from evalkit.terminal.entry_point import run


@pytest.fixture(autouse=True)
def _unchanged_signals():
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def called(monkeypatch, capsys):
    """Return ``called(app, *words)``: exit code and standard error of a program."""

    def call(app, *words):
        monkeypatch.setattr(sys, "argv", ["evalkit", *words])
        with pytest.raises(SystemExit) as ended:
            run(app)
        return ended.value.code, " ".join(capsys.readouterr().err.split())

    return call


def test_an_argument_that_is_not_utf_8_is_refused_before_the_command_starts(called):
    code, err = called(lambda: pytest.fail("started"), "compare", os.fsdecode(b"drive\xff.bag"))
    assert code == 2
    assert r"argument 2': found 'drive\udcff.bag', expected UTF-8; rename the file" in err


@pytest.mark.parametrize("path", ["a" * 5000, "\x1b[31m/loop"])
def test_a_path_that_the_system_refuses_is_an_error_that_names_it(called, path):
    def app():
        raise OSError(errno.ENAMETOOLONG, "File name too long", path)

    code, err = called(app)
    assert code == 2
    assert err.startswith(f"evalkit: {path[:3]}" if path[0] == "a" else r"evalkit: \x1b[31m/loop")
    assert err.endswith("File name too long; check the path")
    assert len(err) < 2100


@pytest.mark.parametrize(("number", "expected"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_the_exit_code_tells_the_signal_that_ended_a_command(called, number, expected):
    def app():
        try:
            signal.raise_signal(number)
        except KeyboardInterrupt:  # as typer does
            sys.exit(130)

    assert called(app) == (expected, "evalkit: interrupted")


def test_a_closed_terminal_interrupts_once_though_its_shell_sends_the_signal_too(called):
    def app():
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGHUP)  # while the runs are ended
        sys.exit(130)

    assert called(app) == (129, "evalkit: interrupted")


def test_a_closed_terminal_does_not_interrupt_a_command_under_nohup():
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    run(lambda: signal.raise_signal(signal.SIGHUP))
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


@pytest.mark.parametrize("library", ["rich", "typer"])
def test_a_closed_pipe_is_exit_code_141_and_no_failed_run(library):
    """The reader of the output ends before the first line, as ``head -0`` does."""
    printing = {"rich": "from evalkit.terminal.console import out\nout.print('x')", "typer": "print('x', flush=True)"}
    program = (
        "import typer\nfrom evalkit.terminal.entry_point import run\napp = typer.Typer()\n"
        f"@app.command()\ndef it():\n    {printing[library].replace(chr(10), chr(10) + '    ')}\nrun(app)\n"
    )
    closed = _closed_pipe()
    command = [sys.executable, "-c", program]
    ended = subprocess.run(command, stdout=closed, stderr=subprocess.PIPE, text=True, check=False)
    os.close(closed)
    assert (ended.returncode, ended.stderr) == (141, "")


@pytest.mark.parametrize(("command", "remedy"), [("compare", "repeat with --resume"), ("list", "repeat the command")])
def test_a_full_device_names_only_options_that_the_command_has(called, command, remedy):
    def app():
        raise OSError(errno.ENOSPC, "No space left on device")

    code, err = called(app, command)
    assert code == 2
    assert err.endswith(f"evalkit {command}: the machine failed (No space left on device); free disk, memory, "
                        f"/dev/shm, open files or processes, and {remedy}")  # fmt: skip


def test_a_system_that_starts_no_thread_has_failed_and_other_errors_of_a_run_are_not_hidden(called):
    """Python says it by a RuntimeError without a number."""

    def app(what):
        raise RuntimeError(what)

    code, err = called(lambda: app("can't start new thread"), "list")
    assert (code, err.partition(";")[0]) == (2, "evalkit: evalkit list: the machine failed (can't start new thread)")
    with pytest.raises(RuntimeError, match="another"):
        run(lambda: app("another"))


def test_an_error_of_the_system_without_a_path_is_not_hidden():
    with pytest.raises(BrokenPipeError):
        run(lambda: os.write(os.dup(_closed_pipe()), b"x"))


def _closed_pipe():
    reading, writing = os.pipe()
    os.close(reading)
    return writing


def test_a_terminal_without_unicode_shows_escapes(monkeypatch):
    terminal = io.TextIOWrapper(io.BytesIO(), "ascii")
    monkeypatch.setattr(sys, "stdout", terminal)
    run(lambda: terminal.write("error ─●─"))
    terminal.flush()
    assert terminal.buffer.getvalue() == rb"error \u2500\u25cf\u2500"


def test_commands_draw_without_a_screen_whatever_matplotlib_is_told(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "nonsense")
    run(lambda: None)
    assert os.environ["MPLBACKEND"] == "agg"


@pytest.mark.parametrize(("given", "threads"), [(None, "1"), ("4", "4")])
def test_the_linear_algebra_of_a_command_has_one_thread_unless_the_user_sets_another_number(
    monkeypatch, given, threads
):
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "")  # so that the value before is restored
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    if given:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", given)
    run(lambda: None)
    assert os.environ["OPENBLAS_NUM_THREADS"] == threads
