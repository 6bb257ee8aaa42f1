"""The reader of tuning files."""

from __future__ import annotations

from bounds import check_file_reader

from evalkit.commands.tune.config import load_tuning

SEED = b"""title = "Fuzz"
points = 4
seed = 1
[mapper]
use = "log-odds"
scans = 10
[[method]]
use = "wheel-odometry"
[[method]]
use = "paper"
[method.search]
epsilon = { levels = [1e-7, 1e-3], scale = "log" }
keyframes = [5, 10]
[[training]]
use = "lab"
laps = 0.1
seeds = [0, 1]
confirm = [10, 11]
[[check_call-out]]
use = "office"
laps = 0.1
seeds = [0]
[objective]
metric = "ate_rmse_m"
lost = 1.0
"""


def seeds() -> list[bytes]:
    """Return a valid tuning."""
    return [SEED]


def swollen() -> list[bytes]:
    """Return huge budgets, long lists and long texts."""
    return [
        SEED.replace(b"points = 4", b"points = 1000000000"),
        SEED.replace(b"[5, 10]", b"[" + b"5," * 50_000 + b"]"),
        SEED.replace(b"[10, 11]", b"[" + b"-1," * 50_000 + b"]"),
        SEED.replace(b'"ate_rmse_m"', b'"' + b"x" * 1_000_000 + b'"'),
        SEED.replace(b'"log"', b"[" * 3_000),
    ]


def read_input(data: bytes) -> None:
    """Read a tuning."""
    check_file_reader(lambda path: load_tuning(path, "fuzz", "evalkit tune fuzz.toml"), data, "fuzz.toml")
