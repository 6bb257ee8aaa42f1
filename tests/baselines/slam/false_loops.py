"""Drive worlds in which places look alike and count loop closures: ``python tests/baselines/slam/false_loops.py 100``.

Prints a row for each world: drives, candidates, accepted, false, rejected, precision, recall, and ATE RMSE. A false
closure and a closed return are those of ``evalkit.metrics.loop_closures``, as in the report.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass

import numpy as np

from evalkit.core import se2
from evalkit.core.se2 import Floats
from evalkit.metrics.loop_closures import find_closed_returns, judge_closures, measure_errors
from evalkit.plugins import registry

WORLDS = {"doors": {}, "wings": {}, "symmetric-office": {}, "loop": {"laps": 1.3}, "office": {}, "long-loop": {}}
ALIASING = ("doors", "wings", "symmetric-office")


@dataclass
class Count:
    """Closures of some drives of a world; ``closed`` of ``returns``: the recall."""

    drives: int = 0
    candidates: int = 0
    accepted: int = 0
    false: int = 0
    returns: int = 0
    closed: int = 0
    worst_m: float = 0.0
    ate_m: tuple[float, ...] = ()

    def row(self, world: str) -> str:
        """Return the table's row."""
        true = self.accepted - self.false
        precision = f"{true / self.accepted:.3f}" if self.accepted else "-"
        recall = f"{self.closed / self.returns:.2f}" if self.returns else "-"
        return (
            f"| {world} | {self.drives} | {self.candidates} | {self.accepted} | {self.false} | "
            f"{self.candidates - self.accepted} | {precision} | {recall} | {self.worst_m:.2f} | "
            f"{100.0 * np.median(self.ate_m):.1f} |"
        )


def main() -> int:
    """Drive and print; returns 1 where a false loop was accepted in an aliasing world."""
    parser = argparse.ArgumentParser(description="Count false loop closures.")
    parser.add_argument("drives", type=int, nargs="?", default=2, help="of each world")
    parser.add_argument("--method", default="paper-slam", choices=("paper-slam", "embedded-slam"))
    parser.add_argument("--first-seed", type=int, default=1000)
    parser.add_argument("--worlds", nargs="*", default=list(WORLDS), choices=list(WORLDS))
    arguments = parser.parse_args()
    head = (
        "world",
        "drives",
        "candidates",
        "accepted",
        "false",
        "rejected",
        "precision",
        "recall",
        "worst m",
        "ATE cm",
    )
    sys.stdout.write(f"| {' | '.join(head)} |\n|{'---|' * len(head)}\n")
    false = 0
    for world in arguments.worlds:
        count = Count()
        for seed in range(arguments.first_seed, arguments.first_seed + arguments.drives):
            drive(count, world, seed, arguments.method)
        false += count.false if world in ALIASING else 0
        sys.stdout.write(count.row(world) + "\n")
        sys.stdout.flush()
    return 1 if false else 0


def drive(count: Count, world: str, seed: int, method: str) -> None:
    """Drive once and add to the count."""
    sequence = registry.dataset(world).make(seed=seed, **WORLDS[world])
    spec = registry.backend(method)
    slam = spec.make(**{each.name: each.default for each in spec.parameters})
    for frame in sequence.frames():
        slam.update(frame)
    final, true, loops = slam.trajectory(), sequence.truth().trajectory, slam.loop_closures()
    judged, accepted = judge_closures(loops, true), [one for one in loops if one.accepted]
    closed = find_closed_returns(judged, true)
    count.candidates += len(loops)
    count.accepted += len(accepted)
    count.false += int((~judged.right).sum())
    count.worst_m = max([count.worst_m, *measure_errors(accepted, true)[:, 0].tolist()])
    count.returns += len(closed)
    count.closed += int(closed.sum())
    count.ate_m += (ate(final.poses, true.at(final.stamps_ns)),)
    count.drives += 1


def ate(estimate: Floats, true: Floats) -> float:
    """Return the ATE RMSE (m) after the best rigid alignment."""
    a, b = estimate[:, :2] - estimate[:, :2].mean(axis=0), true[:, :2] - true[:, :2].mean(axis=0)
    spread = a.T @ b
    theta = np.arctan2(spread[0, 1] - spread[1, 0], spread[0, 0] + spread[1, 1])
    return float(np.sqrt(((se2.transform([0.0, 0.0, theta], a) - b) ** 2).sum(axis=1).mean()))


if __name__ == "__main__":
    sys.exit(main())
