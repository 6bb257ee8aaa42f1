"""A map without a trajectory made numbers: held against the true map, and looked at for what it shows by itself."""

from __future__ import annotations

from dataclasses import replace

from evalkit import metrics
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.run_result import RunResult, Score, Scores
from evalkit.metrics.table import Evidence, Unmatched
from evalkit.plugins.protocols import Sequence

OF_THE_MAP_ALONE = ("occupied_percent", "corners", "enclosed_areas", "enclosed_m2", "wall_width_m")
"""Consistency metrics that need neither scans nor probabilities; most metrics against the true map need neither."""

OF_PROBABILITIES = ("map_entropy", "map_log_loss", "map_ssim")
"""Metrics of what a map file does not hold."""

NO_TRAJECTORY = "no trajectory: a map alone was made elsewhere"
NO_PROBABILITIES = "a map file tells occupied, free and unknown, not how probable"

FRAME = "the map stands where its file and its settings say"


def score(run: RunResult, grid: OccupancyGrid, sequence: Sequence) -> Scores:
    """The scores of a map in the world's frame; what needs a trajectory says that there is none."""
    evidence = Evidence(run, sequence.truth(), Unmatched(NO_TRAJECTORY), grid)
    table = metrics.all_metrics()
    against_truth = [one for one in table if one.group == "map against truth" and one.name not in OF_PROBABILITIES]
    meaningful = [*against_truth, *(one for one in table if one.name in OF_THE_MAP_ALONE)]
    scores = {one.name: Score(None, 0, NO_TRAJECTORY) for one in table} | metrics.compute_scores(evidence, meaningful)
    for name in OF_PROBABILITIES:
        scores[name] = replace(scores[name], reason=NO_PROBABILITIES)
    return Scores(scores, Pose(), FRAME, grid)
