"""Names beside the points of a figure."""

from itertools import combinations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text

from evalkit.commands.export.figures import label_points


def place(points):
    """Return the boxes of the names in pixels, in the order of the points."""
    figure = Figure(figsize=(7.0, 3.0), layout="constrained")
    axes = figure.subplots()
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    label_points(axes, points, ["black"] * len(points), 7.0)
    names = [child for child in axes.get_children() if isinstance(child, Annotation)]
    assert [name.get_text() for name in names] == [name for name, _ in points]
    figure.draw_without_rendering()
    return axes, [Text.get_window_extent(name) for name in names]  # without the line to the point


def test_a_name_alone_is_to_the_right_and_at_the_right_edge_to_the_left():
    for x, is_right in ((0.3, True), (0.97, False)):
        axes, (box,) = place([("embedded-slam", (x, 0.5))])
        middle = axes.transData.transform((x, 0.5))[0]
        assert (box.x0 > middle) == is_right
        assert (box.x1 < middle) != is_right


def test_names_of_points_close_together_do_not_overlap_and_stay_in_the_axes():
    points = [(f"open3d-plane {row}", (0.5 + 0.01 * row, 0.5 + 0.01 * (row % 2))) for row in range(6)]
    axes, boxes = place(points)
    assert all(not one.overlaps(other) for one, other in combinations(boxes, 2))
    assert all(axes.bbox.contains(*corner) for box in boxes for corner in np.array(box.corners()))
