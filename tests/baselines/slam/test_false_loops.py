"""No false loop is accepted, every return is closed, and the corrected path is within 3 cm."""

import runpy
from pathlib import Path

import pytest

pytest.importorskip("evalkit_baselines.embedded._core64")

script = runpy.run_path(str(Path(__file__).with_name("false_loops.py")))


@pytest.mark.parametrize("world", [*script["ALIASING"], "loop", "office"])
def test_closures_are_true_and_correct_the_path(world):
    count = script["Count"]()
    script["drive"](count, world, 9001, "embedded-slam")
    assert count.false == 0
    assert count.closed == count.returns > 0
    assert count.ate_m[0] < 0.03
