"""Comparative evaluation of 2D lidar registration: one harness for many back ends, one report."""

from evalkit.types import Cloud, Frame, Iteration, Match, OccupancyGrid, Pose, Scan, Trajectory

__all__ = ["Cloud", "Frame", "Iteration", "Match", "OccupancyGrid", "Pose", "Scan", "Trajectory", "__version__"]

__version__ = "0.1.0"
