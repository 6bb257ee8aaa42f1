"""What the harness costs around a back end's call: microseconds per scan of a run in a process of its own."""

from __future__ import annotations

import sys
import tempfile
import threading
from pathlib import Path

import numpy as np

from evalkit import frontend, registry, runner
from evalkit.experiment import Limits
from evalkit.worker import Request

SCANS = 700


def main() -> None:
    """Runs wheel odometry, which costs nothing itself, and the paper's ICP, and prints what is around their calls."""
    print(f"harness around the timed call, us per scan (synthetic lab, about {SCANS} scans)")
    print(f"{'back end':16} {'median':>8} {'p99':>8} {'its own call':>14}")
    for name in ("wheel-odometry", "paper"):
        spec = registry.backend(name)
        lab = registry.dataset("lab")
        parameters = {p.name: p.default for p in lab.parameters}
        request = Request(name, frontend.complete_parameters(name, spec, {}), "lab", parameters)
        with tempfile.TemporaryDirectory() as folder:
            run = runner.run(request, (name, "lab"), Path(folder), Limits(), lambda _: None, threading.Event())
        if run.status != "complete":
            sys.exit(f"{name}: {run.status}: {run.reason}")
        around = run.steps["harness_ns"][1:] / 1e3
        own = np.median(run.steps["wall_ns"]) / 1e3
        print(f"{name:16} {np.median(around):8.1f} {np.percentile(around, 99):8.1f} {own:14.1f}")


if __name__ == "__main__":
    main()
