"""Comparative evaluation of 2D lidar registration: one harness for many back ends, one report.

The values of the API are imported when they are used: the command line starts without NumPy.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from evalkit.api.functions import compare, load, register, run
    from evalkit.api.results import ComparisonResults
    from evalkit.config.experiment import Experiment
    from evalkit.core.grid import OccupancyGrid
    from evalkit.core.loop_closure import LoopClosure
    from evalkit.core.match import Iteration, Match
    from evalkit.core.odometry_estimate import OdometryEstimate, StageEstimate
    from evalkit.core.pose import Pose
    from evalkit.core.scan import Cloud, Frame, Scan
    from evalkit.core.timing import Cost, Stopwatch
    from evalkit.core.trajectory import Trajectory

_MODULES = {
    "api.functions": ("compare", "load", "register", "run"),
    "api.results": ("ComparisonResults",),
    "config.experiment": ("Experiment",),
    "core.grid": ("OccupancyGrid",),
    "core.loop_closure": ("LoopClosure",),
    "core.match": ("Iteration", "Match"),
    "core.odometry_estimate": ("OdometryEstimate", "StageEstimate"),
    "core.pose": ("Pose",),
    "core.scan": ("Cloud", "Frame", "Scan"),
    "core.timing": ("Cost", "Stopwatch"),
    "core.trajectory": ("Trajectory",),
}
"""The names that each module gives to the API."""

__all__ = [
    "Cloud",
    "ComparisonResults",
    "Cost",
    "Experiment",
    "Frame",
    "Iteration",
    "LoopClosure",
    "Match",
    "OccupancyGrid",
    "OdometryEstimate",
    "Pose",
    "Scan",
    "StageEstimate",
    "Stopwatch",
    "Trajectory",
    "__version__",
    "compare",
    "load",
    "register",
    "run",
]

__version__ = "0.1.0"


def __getattr__(name: str) -> object:
    """Import a value of the API on first use (PEP 562)."""
    for module, names in _MODULES.items():
        if name in names:
            value: object = getattr(import_module(f"evalkit.{module}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module 'evalkit' has no attribute '{name}'")
