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

    SIGTERM ends it as Ctrl-C does, with exit code 143 instead of 130; both print "interrupted". Where the program that
    reads its output has ended, the exit code is 141, as of SIGPIPE.
    """
    os.environ["MPLBACKEND"] = "agg"  # commands draw into files only
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # else importing NumPy takes 0.3 s of CPU time to start threads
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # instead of an error in a terminal that is not UTF-8
    terminated: list[int] = []

    def end(number: int, frame: FrameType | None) -> None:
        terminated.append(number)
        signal.default_int_handler(number, frame)  # end by exception, so that running workers are stopped

    signal.signal(signal.SIGTERM, end)
    try:
        _require_text(sys.argv[1:])
        app()
    except SystemExit as ended:
        sys.exit(_find_exit_code(ended, signal.SIGTERM if terminated else signal.SIGINT))
    except EvalkitError as error:
        _exit(str(error))
    except OSError as error:
        command = " ".join(sys.argv[1:2])
        remedy = MachineFault.REMEDY if command == "compare" else f"{MachineFault.FREE} the command"
        if fault := MachineFault.of(f"evalkit {command}", error, remedy):
            _exit(str(fault))
        if error.filename is None:
            raise
        _exit(plain(f"{error.filename}: {error.strerror}; check the path"))


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
