"""Drive worlds in which places look alike and count loop closures: ``python tests/baselines/slam/false_loops.py 100``.

Prints a row for each world: drives, candidates, accepted, false, rejected, precision, recall, and ATE RMSE. A candidate
is true where its motion differs from the truth by less than ``TRUE_M`` and ``TRUE_DEG``. Recall is the share of the
revisited places that a closure connects: of the scans, every tenth, at which the robot is within ``PLACE_M`` and
``PLACE_DEG`` of where it was more than ``LOOP_M`` of driving ago, those with an accepted closure within the last
``LOOP_M`` of driving or the next ``DELAY_M``.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass

import numpy as np

from evalkit.core import se2
from evalkit.core.se2 import Floats
from evalkit.plugins import registry

TRUE_M, TRUE_DEG = 0.5, 5.0
PLACE_M, PLACE_DEG, LOOP_M, DELAY_M = 1.0, 45.0, 20.0, 6.0
WORLDS = {"doors": {}, "wings": {}, "symmetric-office": {}, "loop": {"laps": 1.3}, "office": {}, "long-loop": {}}
ALIASING = ("doors", "wings", "symmetric-office")


@dataclass
class Count:
    """Closures of some drives of a world; ``revisits`` and ``connected``: keyframes for the recall."""

    drives: int = 0
    candidates: int = 0
    accepted: int = 0
    false: int = 0
    revisits: int = 0
    connected: int = 0
    worst_m: float = 0.0
    ate_m: tuple[float, ...] = ()

    def row(self, world: str) -> str:
        """Return the table's row."""
        true = self.accepted - self.false
        precision = f"{true / self.accepted:.3f}" if self.accepted else "-"
        recall = f"{self.connected / self.revisits:.2f}" if self.revisits else "-"
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
    final, true = slam.trajectory(), sequence.truth().trajectory
    world_from_base = true.at(final.stamps_ns)
    row = {int(stamp): at for at, stamp in enumerate(final.stamps_ns)}
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(world_from_base[:, :2], axis=0), axis=1))])
    closed_m = []
    for loop in slam.loop_closures():
        count.candidates += 1
        if loop.accepted:
            first, second = world_from_base[row[loop.other_stamp_ns]], world_from_base[row[loop.stamp_ns]]
            error = se2.between(se2.between(first, second), loop.other_from_base.row)
            metres = float(np.hypot(error[0], error[1]))
            count.accepted += 1
            count.false += not (metres < TRUE_M and abs(error[2]) < np.radians(TRUE_DEG))
            count.worst_m = max(count.worst_m, metres)
            closed_m.append(path[row[loop.stamp_ns]])
    revisited = path[revisits(world_from_base, path)]
    closed = np.array(closed_m)[None, :]
    near = (closed >= revisited[:, None] - LOOP_M) & (closed <= revisited[:, None] + DELAY_M)
    reachable = revisited <= path[-1] - DELAY_M
    count.revisits += int(reachable.sum())
    count.connected += int(near[reachable].any(axis=1).sum()) if closed.size else 0
    count.ate_m += (ate(final.poses, world_from_base),)
    count.drives += 1


def revisits(poses: Floats, path: Floats) -> Floats:
    """Return the rows (K,), every tenth, at which the robot is where it was before."""
    rows = np.arange(0, len(poses), 10)
    gap = np.linalg.norm(poses[rows, None, :2] - poses[None, rows, :2], axis=-1)
    turn = np.abs(se2.wrap(poses[rows, None, 2] - poses[None, rows, 2]))
    far = path[rows, None] - path[None, rows] > LOOP_M
    return rows[((gap <= PLACE_M) & (turn <= np.radians(PLACE_DEG)) & far).any(axis=1)]


def ate(estimate: Floats, true: Floats) -> float:
    """Return the ATE RMSE (m) after the best rigid alignment."""
    a, b = estimate[:, :2] - estimate[:, :2].mean(axis=0), true[:, :2] - true[:, :2].mean(axis=0)
    spread = a.T @ b
    theta = np.arctan2(spread[0, 1] - spread[1, 0], spread[0, 0] + spread[1, 1])
    return float(np.sqrt(((se2.transform([0.0, 0.0, theta], a) - b) ** 2).sum(axis=1).mean()))


if __name__ == "__main__":
    sys.exit(main())
