"""Comparative evaluation of 2D lidar registration: one harness for many back ends, one report."""

from evalkit.core.grid import OccupancyGrid
from evalkit.core.match import Iteration, Match
from evalkit.core.odometry_estimate import OdometryEstimate, StageEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame, Scan
from evalkit.core.timing import Cost, Stopwatch
from evalkit.core.trajectory import Trajectory

__all__ = [
    "Cloud",
    "Cost",
    "Frame",
    "Iteration",
    "Match",
    "OccupancyGrid",
    "OdometryEstimate",
    "Pose",
    "Scan",
    "StageEstimate",
    "Stopwatch",
    "Trajectory",
    "__version__",
]

__version__ = "0.1.0"
