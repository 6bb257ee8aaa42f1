"""Run a command-line program with the exit codes and the error line of evalkit."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from io import TextIOWrapper
from types import FrameType
from typing import Any, NoReturn

from evalkit.core.errors import BadParameter, EvalkitError, MachineFault, plain
from evalkit.terminal.console import err

CLOSED_PIPE = 141
"""Exit code of a program that writes to a pipe which is closed: 128 and the number of SIGPIPE."""


def run(app: Callable[[], Any]) -> None:
    """Run a program; an EvalkitError or an error of the system becomes one line on standard error and exit code 2.

    SIGTERM and a closed terminal (SIGHUP) end it as Ctrl-C does, with exit codes 143 and 129 instead of 130; all print
    "interrupted". Where the program that reads its output has ended, the exit code is 141, as of SIGPIPE.
    """
    os.environ["MPLBACKEND"] = "agg"  # commands draw into files only
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # else importing NumPy takes 0.3 s of CPU time to start threads
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # instead of an error in a terminal that is not UTF-8
    ended_by = _interrupt_by_signals()
    try:
        _require_text(sys.argv[1:])
        app()
    except SystemExit as ended:
        sys.exit(_find_exit_code(ended, ended_by[-1]))
    except EvalkitError as error:
        _exit(str(error))
    except (OSError, RuntimeError) as error:
        command = " ".join(sys.argv[1:2])
        remedy = MachineFault.REMEDY if command == "compare" else f"{MachineFault.FREE} the command"
        if fault := MachineFault.of(f"evalkit {command}", error, remedy):
            _exit(str(fault))
        if not isinstance(error, OSError) or error.filename is None:
            raise
        _exit(plain(f"{error.filename}: {error.strerror}; check the path"))


def _interrupt_by_signals() -> list[signal.Signals]:
    """Let SIGTERM and SIGHUP interrupt as Ctrl-C does; the last of the returned list is the signal that did."""
    ended_by = [signal.SIGINT]

    def end(number: int, frame: FrameType | None) -> None:
        ended_by.append(signal.Signals(number))
        if number != signal.SIGTERM:  # a shell that ends sends it as well as the terminal
            signal.signal(number, signal.SIG_IGN)
        signal.default_int_handler(number, frame)  # end by exception, so that running workers are stopped

    for number in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):  # Windows has no terminal that closes
        if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup asks
            signal.signal(number, end)
    return ended_by


def _find_exit_code(ended: SystemExit, ending: signal.Signals) -> Any:
    """Return the exit code of an ended program; of one that was interrupted, which is printed, that of a signal."""
    if isinstance(ended.__context__, BrokenPipeError):  # typer and rich exit with 1, as after a failed run
        return CLOSED_PIPE
    if ended.code != 128 + signal.SIGINT:
        return ended.code
    err.print("evalkit: interrupted", style="red")
    return 128 + ending


def _require_text(words: list[str]) -> None:
    """Raise BadParameter for a word that is not UTF-8: no page or table could name that file."""
    for index, word in enumerate(words, 1):
        try:
            word.encode()
        except UnicodeEncodeError:
            raise BadParameter("evalkit", f"argument {index}", word, "UTF-8; rename the file") from None


def _exit(message: str) -> NoReturn:
    err.print(f"evalkit: {message}", style="red")
    sys.exit(2)
