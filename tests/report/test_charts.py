"""Charts of numbers."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from evalkit.report.html import charts
from evalkit.report.html.charts import Axis, Box, Curve, Points, ShadedSpan

X = np.linspace(0.0, 3.0, 20)
CURVE = Curve("a < b", X, X + 1.0, X, X + 2.0)
TURN = ShadedSpan(1, 2, "turn")
DRAWN = {
    "lines": lambda: charts.lines([CURVE], Axis("t [s]"), Axis("e [m]", "log"), [TURN], {"limit": 2.0}),
    "panels": lambda: charts.panels([([CURVE], Axis("e [m]")), ([CURVE], Axis("f [m]"))], Axis("t [s]")),
    "heat": lambda: charts.heat(
        np.array([[0.1, np.nan], [0.5, 1.0]]), Axis("x"), Axis("y"), [0, 1], [0, 45], Axis("share", low=0, high=1),
        lambda value: f"{value:.1f}", [0.3],
    ),
    "histogram": lambda: charts.histogram({"r": X, "nothing": np.array([np.nan])}, Axis("r [m]"), levels={"s": 1.0}),
    "scatter": lambda: charts.scatter([Points("p", np.stack([X, X], 1), "#000000")], Axis("x [m]"), Axis("y [m]")),
    "bars": lambda: charts.bars(["a", "b"], np.array([1.0, -1.0]), Axis("effect"), np.zeros(2), np.ones(2)),
    "picture": lambda: charts.picture(np.zeros((3, 4)), (0.0, 4.0, 0.0, 3.0), [Points("g", np.ones((2, 2)), "#f00")]),
    "flow": lambda: charts.flow(
        [Box("a", "A", 0, 0), Box("b", "B", 0, 1, "choice")], [("a", "b", ""), ("b", "a", "no")]
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", DRAWN)
def test_equal_numbers_give_equal_bytes(name):
    drawn = DRAWN[name]()
    assert ET.fromstring(drawn).tag.endswith("svg")
    assert drawn == DRAWN[name]()


def test_different_numbers_give_different_drawings():
    other = Curve("a < b", X, X + 1.1, X, X + 2.0)
    assert charts.lines([CURVE], Axis("t"), Axis("e")) != charts.lines([other], Axis("t"), Axis("e"))
