"""The reader of study files."""

from __future__ import annotations

from bounds import check_file_reader

from evalkit.commands.study.config import load_study

SEED = b"""title = "Fuzz"
seeds = [0, 1]
[method]
use = "paper"
[sequence]
use = "lab"
scans = 10
[[response]]
metric = "ate_rmse_m"
scale = "log"
lost = 1.0
[[factor]]
sets = "method.keyframes"
levels = [5, 10, 20]
[[factor]]
name = "noise"
levels.small = { "sequence.people" = 0 }
levels.large = { "sequence.people" = 4 }
[[design]]
name = "plane"
kind = "grid"
factors = ["method.keyframes", "noise"]
[[design]]
kind = "latin"
points = 4
factors = ["noise"]
deal = true
"""


def seeds() -> list[bytes]:
    """Return valid studies."""
    return [SEED]


def swollen() -> list[bytes]:
    """Return enormous designs, deep tables and long texts."""
    head = SEED[: SEED.index(b"[[design]]")]
    return [
        head + b'[[design]]\nkind = "sobol"\npoints = 1000000000\nfactors = ["noise"]\n',
        head + b'[[design]]\nkind = "latin"\npoints = 1000000000\nfactors = ["noise"]\n',
        head + b'[[design]]\nkind = "optimal"\npoints = 1000000000\nfactors = ["noise"]\n',
        head + b'[[design]]\nkind = "fractional"\nresolution = 1000000000\nfactors = ["noise"]\n',
        head + b'[[design]]\nkind = "curves"\nseed = "x"\nfactors = ["noise"]\n',
        head + b'[[design]]\nkind = "curves"\nfactors = [[]]\n',
        head + b'[[design]]\nkind = "curves"\nfactors = ["noise"]\n[design.with]\n' + b"a." * 5_000 + b"a = 1\n",
        head + b'[[design]]\nkind = "' + b"x" * 1_000_000 + b'"\n',
        SEED.replace(b"[5, 10, 20]", b"[" + b"5, " * 50_000 + b"]"),
        SEED.replace(b"scans = 10", b"scans = 1000000000"),
    ]


def read_input(data: bytes) -> None:
    """Read a study and build its tasks."""
    check_file_reader(lambda path: load_study(path, "evalkit study fuzz.toml").tasks(), data, "fuzz.toml")
