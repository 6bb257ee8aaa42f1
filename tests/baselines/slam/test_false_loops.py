"""No false loop is accepted in worlds whose places look alike, and every return is closed."""

import runpy
from pathlib import Path

import pytest

pytest.importorskip("evalkit_baselines.embedded._core64")

script = runpy.run_path(str(Path(__file__).with_name("false_loops.py")))

WORLDS = ("symmetric-office", *(pytest.param(world, marks=pytest.mark.thorough) for world in ("doors", "wings")))


@pytest.mark.parametrize("world", WORLDS)
def test_no_false_loop_is_accepted_where_places_look_alike(world):
    count = script["Count"]()
    script["drive"](count, world, 9001, "embedded-slam")
    assert count.false == 0
    assert count.closed == count.returns > 0
