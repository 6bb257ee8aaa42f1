"""The reader of experiment files."""

from __future__ import annotations

from bounds import check_file_reader

from evalkit.config.experiment_file import load_experiment

SEED = b"""title = "Fuzz"
description = "a plan"
[mapper]
use = "log-odds"
scans = 40
resolution_m = 0.1
[limits]
run_s = 10
memory_mib = 512
[[method]]
use = "wheel-odometry"
label = "wheels"
[[method]]
use = "paper"
s2s.one_to_one = false
keyframes = 5
[[sequence]]
use = "lab"
seeds = [0, 1]
"""


def seeds() -> list[bytes]:
    """Return valid experiments."""
    return [SEED, b'[[method]]\nuse = "paper"\n[[sequence]]\nuse = "corridor"\nlabel = "c"\n']


def swollen() -> list[bytes]:
    """Return deep tables, long texts and many methods."""
    one = b'[[method]]\nuse = "paper"\n[[sequence]]\nuse = "lab"\n'
    return [
        one + b"x = " + b"[" * 5_000,
        one + b"x = " + b"{a=" * 5_000,
        one + b"a." * 5_000 + b"a = 1\n",
        one + b"[" + b"a." * 20_000 + b"a]\nb = 1\n",
        one.replace(b'"lab"', b'"' + b"x" * 1_000_000 + b'"'),
        one + b'label = "' + b"x" * 1_000_000 + b'"\n',
        one + b"x" * 100_000 + b" = 1\n",
        one + b"scans = " + b"9" * 4_000 + b"\n",
        one + b"seeds = [" + b"1," * 100_000 + b"]\n",
        one + b"seeds = [" + b"-1," * 100_000 + b"]\n",
        b"[limits]\nrun_s = " + b"9" * 1_000 + b"\n" + one,
        b'[[method]]\nuse = "paper"\nlabel = "\\u001b[2J"\n' * 2 + b'[[sequence]]\nuse = "lab"\n',
        b"".join(b'[[method]]\nuse = "paper"\nlabel = "%d"\n' % k for k in range(2_000))
        + b'[[sequence]]\nuse = "lab"\n',
        b'title = "' + b"\\u2028" * 20_000,
    ]


def read_input(data: bytes) -> None:
    """Read an experiment and list its runs."""
    check_file_reader(lambda path: list(load_experiment(path).runs()), data, "fuzz.toml")
