"""The reference of each twin runs without the compiled core: compared with itself, the core would always be right."""

import subprocess
import sys

import pytest

from evalkit.plugins import registry

REFERENCES = sorted({registry.backend(name).reference for name in registry.names("backends")} - {""})

PROGRAM = """
import sys
from itertools import islice

import numpy as np

sys.modules["evalkit_baselines.embedded"] = None  # each import of it fails

from evalkit.core import se2
from evalkit.odometry.frontend import complete_parameters, make_odometry
from evalkit.plugins import registry

spec, room = registry.backend(sys.argv[1]), registry.dataset("room").make(seed=0)
assert spec.missing() == ""
odometry = make_odometry(spec, complete_parameters(sys.argv[1], spec, {}))
frames = list(islice(room.frames(), 40))
found = np.array([odometry.update(frame).pose.row for frame in frames])
true = room.truth().trajectory.at([frame.scan.stamp_ns for frame in frames])
true, found = se2.between(true[0], true), se2.between(found[0], found)
print(np.hypot(*true[-1, :2]), np.abs(se2.between(true, found)).max())
"""


def test_the_references_of_the_twins_are_the_methods_of_the_paper():
    assert REFERENCES == ["paper", "paper-map-line", "paper-slam"]


@pytest.mark.parametrize("name", REFERENCES)
def test_a_reference_finds_its_way_without_the_compiled_core(name):
    ended = subprocess.run([sys.executable, "-c", PROGRAM, name], capture_output=True, text=True, check=False)
    assert not ended.returncode, ended.stderr
    driven_m, off = map(float, ended.stdout.split())
    assert driven_m > 1.0
    assert off < 0.05  # m, rad
