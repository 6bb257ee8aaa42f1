"""Importing the metrics is cheap: names and cards need no heavy library."""

from __future__ import annotations

import subprocess
import sys

HEAVY = ("scipy", "pandas", "matplotlib")


def test_importing_the_metrics_loads_no_heavy_library() -> None:
    code = (
        "import sys\n"
        "from evalkit import metrics\n"
        "from evalkit.metrics import validated\n"
        "assert len({metric.name for metric in metrics.METRICS}) > 50\n"
        "assert validated.load_validation().agreement_of('map_entropy') is not None\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules])\n"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
