"""Run a SLAM on recordings and print the errors on their relations: ``tests/baselines/slam/recordings.py``.

``intel-exact``: the drive "exact" of intel, the 3,361 scans with exact stamps. ``--band N`` repeats each N times with
noise of 0.1 mm on every range: it changes which closures are found, so that one run is an anecdote. ``--rough N``:
further runs with noise of 3 mm, up to 60 scans missing at the start, and 2 % of the others.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from evalkit.core.ground_truth import Relations
from evalkit.core.scan import Frame
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.relations import compute_estimated_motions, select_part, symmetric_errors
from evalkit.plugins import registry
from evalkit.plugins.protocols import Slam

NUISANCE_M, ROUGH_M = 1e-4, 0.003
RECORDINGS = ("fr079", "intel", "intel-exact")
HEAD = (
    "recording", "scans", "n", "coverage", "online all / short", "corrected all / short", "closures", "corrections",
    "lost", "ms median / worst",
)  # fmt: skip


def main() -> int:
    """Print a row for each run."""
    parser = argparse.ArgumentParser(description="Errors of a SLAM on recordings.")
    parser.add_argument("--method", default="paper-slam", choices=("paper-slam", "embedded-slam"))
    parser.add_argument(
        "--set", nargs="*", default=[], metavar="NAME=VALUE", help="numbers for parameters of the method"
    )
    parser.add_argument("recordings", nargs="*", default=list(RECORDINGS), help=f"of {', '.join(RECORDINGS)}")
    parser.add_argument("--band", type=int, default=0, help="further runs with noise of 0.1 mm")
    parser.add_argument("--rough", type=int, default=0, help="further runs with noise of 3 mm and missing scans")
    arguments = parser.parse_args()
    spec = registry.backend(arguments.method)
    given = {name: float(value) for name, value in (one.split("=") for one in arguments.set)}
    parameters = {each.name: type(each.default)(given.get(each.name, each.default)) for each in spec.parameters}
    sys.stdout.write(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}\n")
    for name in arguments.recordings:
        dataset, _, drive = name.partition("-")
        sequence = registry.dataset(dataset).make(**({"drive": drive} if drive else {}))
        relations, frames = sequence.truth().relations, list(sequence.frames())
        if relations is None:
            raise ValueError(f"{name} has no relations")
        for seed in range(arguments.band + 1):
            slam = spec.make(**parameters)
            run(name if not seed else f"{name}, noise {seed}", slam, shaken(frames, seed), relations)
        for seed in range(arguments.rough):
            run(f"{name}, rough {seed}", spec.make(**parameters), roughened(frames, seed), relations)
    return 0


def shaken(frames: Sequence[Frame], seed: int) -> list[Frame]:
    """Return the frames with noise of 0.1 mm on every range; seed 0: unchanged."""
    if not seed:
        return list(frames)
    return add_noise(frames, NUISANCE_M, np.random.default_rng(seed))


def roughened(frames: Sequence[Frame], seed: int) -> list[Frame]:
    """Return the frames without some, with noise of 3 mm on every range."""
    rng = np.random.default_rng(100 + seed)
    begin, kept = int(rng.integers(0, 60)), rng.random(len(frames)) >= 0.02
    return add_noise([frame for frame, keep in zip(frames[begin:], kept[begin:], strict=True) if keep], ROUGH_M, rng)


def add_noise(frames: Sequence[Frame], sigma_m: float, rng: np.random.Generator) -> list[Frame]:
    """Return the frames with noise on every range, within the limits of the lidar."""
    limits = [(frame.scan.range_min_m, frame.scan.range_max_m) for frame in frames]
    noisy = [frame.scan.ranges + sigma_m * rng.standard_normal(len(frame.scan.ranges)) for frame in frames]
    kept = [np.where(np.isfinite(one), np.clip(one, *limit), one) for one, limit in zip(noisy, limits, strict=True)]
    return [replace(frame, scan=replace(frame.scan, ranges=ranges)) for frame, ranges in zip(frames, kept, strict=True)]


def run(name: str, slam: Slam, frames: Sequence[Frame], relations: Relations) -> None:
    """Run once and print the row."""
    estimates, spent = [], []
    for frame in frames:
        begun = time.process_time()
        estimates.append(slam.update(frame))
        spent.append(1e3 * (time.process_time() - begun))
    final = slam.trajectory()
    online = Trajectory(final.stamps_ns, np.array([one.pose.row for one in estimates]), "start", "base")
    parts = []
    for estimate in (online, final):
        motions, covered = compute_estimated_motions(estimate, relations)
        error = symmetric_errors(motions, relations.first_from_second[covered])[:, 0]
        short = select_part(relations, "short")[covered]
        parts.append(f"{error.mean():.4f} / {error[short].mean():.4f}")
    closures = slam.loop_closures()
    cells = (
        name, f"{len(frames):,}", f"{covered.sum():,}", f"{100.0 * covered.mean():.1f} %", *parts,
        f"{sum(one.accepted for one in closures)} of {len(closures)}", str(sum(bool(e.corrected) for e in estimates)),
        str(sum(e.accepted is False and bool(e.stages) for e in estimates)),
        f"{np.median(spent):.2f} / {max(spent):.1f}",
    )  # fmt: skip
    sys.stdout.write(f"| {' | '.join(cells)} |\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
