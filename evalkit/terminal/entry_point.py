"""Run a command-line program with the exit codes and the error line of evalkit."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable
from typing import Any

from evalkit.core.errors import EvalkitError, MachineFault
from evalkit.terminal.options import err


def run(app: Callable[[], Any]) -> None:
    """Run a program; an EvalkitError or a fault of the machine becomes one line on standard error and exit code 2."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # end by exception, so that running workers are stopped
    try:
        app()
    except (EvalkitError, OSError) as error:
        known = (
            error if isinstance(error, EvalkitError) else MachineFault.of(f"evalkit {' '.join(sys.argv[1:2])}", error)
        )
        if known is None:
            raise
        err.print(f"evalkit: {known}", style="red", markup=False, highlight=False)
        sys.exit(2)
