"""Intervals and the float32 margin, compared with hand calculations."""

import math

import numpy as np
import pytest

from evalkit.commands.validate.equivalence.margins import Scale, float32_margin, interval


def test_the_float32_margin_matches_its_derivation():
    margin = float32_margin(Scale(reach_m=10.0, points=300, radius_m=5.0))
    step = 2.0**-24 * 10.0 * (3.0 + 10.0)
    assert margin.metres == pytest.approx(3.0 * (step + 10.0 * step / 5.0))
    assert margin.radians == pytest.approx(3.0 * step / 5.0)


def test_small_samples_use_students_t():
    one = interval("x", "m", [1.0, 2.0, 3.0, 4.0], [1, 2, 3, 4], margin=5.0)
    half = 2.353363 * math.sqrt(5.0 / 3.0) / 2.0  # t of 95 % with 3 degrees of freedom, from a table
    assert (one.low, one.high) == pytest.approx((2.5 - half, 2.5 + half), abs=1e-5)
    assert one.inside
    assert (one.worst, one.worst_scan) == (4.0, 4)
    assert not interval("x", "m", [1.0, 2.0, 3.0, 4.0], [1, 2, 3, 4], margin=3.9).inside
    assert not interval("x", "m", [0.0], [1], margin=1.0).inside


def test_blocks_give_the_interval_of_independent_values():
    values = np.random.default_rng(4).normal(0.3, 1.0, 2000)
    one = interval("x", "m", values, range(2000), margin=1.0)
    half = 1.645 * values.std() / math.sqrt(2000)
    assert one.method == "moving blocks"
    assert (one.low, one.high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.15 * half)
