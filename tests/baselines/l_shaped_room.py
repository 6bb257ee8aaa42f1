"""Two scans of an L-shaped room with a known motion between them, for the tests of registrations."""

import numpy as np

from evalkit.core.pose import Pose

TRUTH = Pose(0.06, -0.04, np.radians(2.0))
"""``target_from_source``."""


def room(n=1200, noise_m=0.0, seed=0):
    """Return points (n, 2) on the walls of the room; ``seed`` may be a generator."""
    rng = np.random.default_rng(seed)
    corners = np.array([[-4.0, -3.0], [4.0, -3.0], [4.0, 1.0], [0.0, 1.0], [0.0, 4.0], [-4.0, 4.0]])
    sides = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(sides, axis=1)
    side = rng.choice(len(sides), n, p=lengths / lengths.sum())
    return corners[side] + rng.uniform(size=(n, 1)) * sides[side] + rng.normal(0.0, noise_m, (n, 2))


def compute_error_m(match):
    """Return the error of a match of two scans in metres at the far end of the room."""
    left = TRUTH.inverse() @ match.target_from_source
    return np.hypot(left.x, left.y) + 4.0 * abs(left.theta)
