"""Without wheel odometry the motion within a sweep is taken from the steps before, and methods do not oscillate."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.odometry.frontend import make_odometry, settable_parameters
from evalkit.plugins import registry

SCANS = 100

pytest.importorskip("evalkit_baselines.embedded._core64")


@cache
def drive():
    sequence = registry.dataset("loop").make(seed=2000, laps=0.1)
    frames = [replace(each, odom_from_base=None, start_from_end=None) for each in list(sequence.frames())[:SCANS]]
    true = sequence.truth().trajectory.at([frame.scan.stamp_ns for frame in frames])
    return frames, se2.between(true[0], true)


@pytest.mark.parametrize("name", ["embedded-map-line", "embedded-pipeline-line", "embedded-slam"])
def test_a_lidar_that_turns_while_it_moves_is_followed_to_5_cm(name):
    frames, true = drive()
    spec = registry.backend(name)
    values = {each.name: each.default for each in settable_parameters(spec)}
    method = spec.make(**values) if spec.kind == "slam" else make_odometry(spec, values)
    found = np.array([method.update(frame).pose.row for frame in frames])
    gap = se2.between(true, found)
    assert frames[0].scan.duration_ns > 0.9 * (frames[1].scan.stamp_ns - frames[0].scan.stamp_ns)
    assert np.hypot(gap[:, 0], gap[:, 1]).max() < 0.05
    assert np.abs(gap[:, 2]).max() < 0.01
