"""The grid of cells that spans a target, and the cells of points in it: what the field matchers share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from evalkit.core.arrays import Bools, Ints
from evalkit.core.errors import BadParameter
from evalkit.core.se2 import Floats

MAX_CELLS = 64_000_000  # 400 m x 400 m at 5 cm; 256 MB in single precision
FARTHEST_CELL = 2.0**31  # farther out, rounding loses the place within a cell


class Located(NamedTuple):
    """Points in a grid, each of shape (N,).

    ``inside``: the point has four cells around it. ``cell``: number of the lower left of the four, 0 where outside.
    ``u``, ``v``: shares of the way from it to the right and up, 0 to 1.
    """

    inside: Bools
    cell: Ints
    u: Floats
    v: Floats


@dataclass(frozen=True, slots=True, eq=False)
class TargetGrid:
    """Square cells; values belong to their centres. ``low``: indices of the first cell; cell 0 0 begins at (0, 0) m."""

    cell_m: float
    low: tuple[float, float]
    columns: int
    rows: int

    @classmethod
    def around(cls, owner: str, points: Floats, cell_m: float, margin_m: float) -> TargetGrid:
        """Return the grid that spans points (N, 2) and a margin.

        Raises BadParameter in the name of ``owner`` where it has more than ``MAX_CELLS`` cells or lies too far out.
        """
        margin = np.ceil(margin_m / cell_m) + 1.0
        low = np.floor(points.min(axis=0) / cell_m) - margin
        span = np.floor(points.max(axis=0) / cell_m) + margin + 1.0 - low
        if not (span.prod() <= MAX_CELLS and max(np.abs(low).max(), np.abs(low + span).max()) <= FARTHEST_CELL):
            reach = f"larger cells: the target spans {span[0] * cell_m:.3g} m x {span[1] * cell_m:.3g} m"
            raise BadParameter(owner, "cell_m", cell_m, reach)
        return cls(cell_m, (float(low[0]), float(low[1])), int(span[0]), int(span[1]))

    def locate(self, points: Floats) -> Located:
        """Return where points (N, 2) lie between the centres of the cells."""
        x, y = (points / self.cell_m - 0.5 - self.low).T
        inside = (x >= 0.0) & (y >= 0.0) & (x < self.columns - 1) & (y < self.rows - 1)
        if not inside.all():
            x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
        left, low = np.floor(x), np.floor(y)
        return Located(inside, (low * self.columns + left).astype(np.int64), x - left, y - low)

    def contains(self, points: Floats) -> Bools:
        """Return which points (N, 2) lie in a cell."""
        x, y = (points / self.cell_m - self.low).T
        return np.asarray((x >= 0.0) & (y >= 0.0) & (x < self.columns) & (y < self.rows))

    def cell_of(self, points: Floats) -> Ints:
        """Return the numbers (N,) of the cells of points (N, 2) that the grid contains."""
        x, y = (points / self.cell_m - self.low).T
        return np.asarray(y.astype(np.int64) * self.columns + x.astype(np.int64))

    def around_cell(self, cells: Ints) -> Ints:
        """Return the numbers (4, N) of cells and of their neighbours to the right, above, and above to the right."""
        return np.asarray(cells + np.array([[0], [1], [self.columns], [self.columns + 1]]))

    def centres(self, cells: Ints) -> Floats:
        """Return the centres (N, 2) of cells (m)."""
        rows, columns = np.divmod(cells, self.columns)
        return np.asarray((np.stack([columns, rows], axis=1) + 0.5 + self.low) * self.cell_m)

    def interpolate(self, values: Floats, at: Located) -> tuple[Floats, Floats]:
        """Return the bilinear interpolation (N,) of values (4, N) of the cells around points, and its gradient (2, N).

        The gradient is 0 outside; the value there has no meaning.
        """
        v00, v10, v01, v11 = values
        below, above = v10 - v00, v11 - v01
        bottom = v00 + at.u * below
        rise = v01 + at.u * above - bottom
        gradient = np.stack([below + at.v * (above - below), rise]) * (at.inside / self.cell_m)
        return bottom + at.v * rise, gradient
