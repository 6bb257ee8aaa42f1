"""Keep the path before and after each correction that a SLAM reports, outside the time of its scans."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from evalkit.core.arrays import Ints, spread_indices
from evalkit.core.path_correction import PathCorrection
from evalkit.core.se2 import Floats
from evalkit.odometry.corrections import read_trajectory
from evalkit.plugins.protocols import Slam

MAX_CORRECTIONS = 100
"""Most corrections of a run whose paths are kept: the first ones."""

MAX_POSES = 250
"""Most poses of a path that are kept."""

MAX_ASKING_S = 30.0
"""Once asking for the paths has taken this long (wall clock), no more are kept: a run has a limit of time."""


class PathRecorder:
    """Asks a SLAM for its path after each correction.

    The path before is that after the correction before, continued by the answers since.

    ``read_steps`` returns the records (dtype ``STEP``) of all answers so far. ``left_out``: why the paths of later
    corrections are not kept; "" where those of all are.
    """

    def __init__(self, slam: Slam, read_steps: Callable[[], NDArray[np.void]]) -> None:
        self._slam, self._read_steps = slam, read_steps
        self._path: Floats = np.zeros((0, 3))
        self._asking_s = 0.0
        self.corrections: list[PathCorrection] = []
        self.left_out = ""

    def record(self) -> None:
        """Keep the paths before and after the last answer, which corrected earlier poses."""
        if self.left_out:
            return
        if len(self.corrections) == MAX_CORRECTIONS:
            self.left_out = f"the paths of at most {MAX_CORRECTIONS} corrections are kept"
            return
        if self._asking_s > MAX_ASKING_S:
            self.left_out = f"asking for the paths took more than {MAX_ASKING_S:g} s"
            return
        steps = self._read_steps()
        begun_s = time.perf_counter()
        try:
            path = read_trajectory(self._slam, steps["stamp_ns"]).poses
        except Exception as error:  # noqa: BLE001 - the answers go on; at the end the same error fails the run
            self.left_out = f"no path after scan {len(steps)}: {type(error).__name__}: {error}"
            return
        self._asking_s += time.perf_counter() - begun_s
        known, count = len(self._path), len(steps) - 1
        if count > 0:
            since = np.stack([steps[name][known:count] for name in ("x", "y", "theta")], axis=-1)
            before = np.concatenate([self._path, since])
            rows = _choose_poses(before, path[:count])
            stamps = steps["stamp_ns"]
            self.corrections.append(PathCorrection(int(stamps[-1]), stamps[rows], before[rows], path[rows]))
        self._path = path


def _choose_poses(before: Floats, after: Floats) -> Ints:
    """Return at most ``MAX_POSES`` indices, evenly spread, with the first, the last and that which moved most."""
    moved = np.linalg.norm(after[:, :2] - before[:, :2], axis=1)
    spread = spread_indices(len(before), MAX_POSES - 1)
    return np.array(sorted({*spread.tolist(), int(np.argmax(moved))}), dtype=np.int64)  # np.unique takes 2 MiB
