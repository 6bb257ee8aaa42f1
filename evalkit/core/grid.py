"""An occupancy grid in log-odds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evalkit.core.arrays import Bools, Ints, freeze
from evalkit.core.se2 import Floats


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Log-odds (H, W) of occupancy, and which cells were observed by at least one beam.

    Row 0 is the lowest y, column 0 the lowest x; ``(origin_x, origin_y)`` is the lower left *corner* of cell (0, 0) in
    the world frame (m). 0 is as likely occupied as free: p = 1 / (1 + exp(-l)) (paper, eq. 11).
    """

    log_odds: NDArray[np.float32]
    observed: Bools
    resolution_m: float
    origin_x: float
    origin_y: float

    def __post_init__(self) -> None:
        freeze(self, "log_odds", self.log_odds, (None, None), np.float32)
        freeze(self, "observed", self.observed, self.log_odds.shape, np.bool_)
        if not self.resolution_m > 0.0:
            raise ValueError(f"resolution_m: expected a positive number, got {self.resolution_m}")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.log_odds.shape
        return rows, columns

    def probability(self) -> Floats:
        """Return the probability of occupancy (H, W); 0.5 for unobserved cells."""
        with np.errstate(over="ignore"):  # unbounded log-odds: exp is inf where the probability is 0
            return np.asarray(1.0 / (1.0 + np.exp(-self.log_odds.astype(np.float64))))

    def occupied(self, threshold: float = 0.65) -> Bools:
        """Return the observed cells (H, W) with a probability above the threshold (map_server's default)."""
        return np.asarray(self.observed & (self.log_odds > _log_odds_of(threshold)))

    def free(self, threshold: float = 0.196) -> Bools:
        """Return the observed cells (H, W) with a probability below the threshold (map_server's default)."""
        return np.asarray(self.observed & (self.log_odds < _log_odds_of(threshold)))

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top (m) in the world."""
        rows, columns = self.shape
        right, top = self.origin_x + columns * self.resolution_m, self.origin_y + rows * self.resolution_m
        return self.origin_x, right, self.origin_y, top

    def find_cells(self, points: Floats) -> tuple[Ints, Ints, Bools]:
        """Return row and column (N,) of the cell of each point (N, 2) (m), and which points (N,) lie on the grid.

        A point beside the grid has row and column 0.
        """
        cells = np.floor((points - [self.origin_x, self.origin_y]) / self.resolution_m).astype(np.int64)
        rows, columns = cells[:, 1], cells[:, 0]
        height, width = self.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        return np.where(inside, rows, 0), np.where(inside, columns, 0), inside

    def centres(self, cells: Bools) -> Floats:
        """Return the centres (N, 2) in the world (m) of the cells in a mask (H, W)."""
        rows, columns = np.divmod(np.flatnonzero(cells), self.shape[1])  # a third of the time of np.argwhere
        cell = np.stack([columns, rows], axis=-1).astype(np.float64)
        return np.asarray([self.origin_x, self.origin_y] + (cell + 0.5) * self.resolution_m)


def _log_odds_of(probability: float) -> np.float64:
    """Return the log-odds of a probability as float64, so that equal float32 values do not exceed it by rounding."""
    with np.errstate(divide="ignore"):
        return np.float64(np.log(probability) - np.log1p(-probability))
