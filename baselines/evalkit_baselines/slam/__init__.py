"""SLAM with the paper's ICP: pose graph, loop closure, and the system made of them, ``paper-slam``."""

from evalkit_baselines.slam.paper_slam import SPEC as SPEC
