"""The examples of a SLAM: short, one method as a library and as a program, with a closed loop and by the rules."""

import shutil
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

from evalkit.commands.validate.rules import odometry_rules, runner, slam_rules
from evalkit.commands.validate.rules.rule import check_rule
from evalkit.commands.validate.rules.scenes import distance_m, drive
from evalkit.core.pose import Pose
from evalkit.external import INCLUDE
from evalkit.odometry.run_odometry import estimate_poses
from evalkit.plugins import registry

EXAMPLES = INCLUDE / "examples"
C, PYTHON = EXAMPLES / "c" / "slam.c", EXAMPLES / "python" / "slam.py"
PROGRAM = f"exec:{sys.executable} {PYTHON}"


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    if shutil.which("cc") is None:
        pytest.skip("no compiler 'cc' here")
    path = tmp_path_factory.mktemp("slam") / "libslam.so"
    words = ["cc", "-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I", INCLUDE]
    subprocess.run([*words, "-shared", "-fPIC", C, EXAMPLES / "c" / "icp.c", "-o", path, "-lm"], check=True)
    return f"lib:{path}"


def make(name, **changed):
    spec = registry.backend(name)
    return spec.make(**{one.name: one.default for one in spec.parameters} | changed)


def correct(name, frames, **changed):
    """Return the corrected poses of a drive and which loop closures are accepted."""
    slam = make(name, **changed)
    estimate_poses(slam, frames)
    return slam.trajectory().poses, [one.accepted for one in slam.loop_closures()]


def test_the_library_and_the_program_close_the_same_loop_alike(library):
    around = drive(32, 2.1, 2.1, odometry_gain=1.02)  # once around a circle of radius 1 m
    poses, closed = correct(library, around.frames)
    other, also_closed = correct(PROGRAM, around.frames)
    assert closed == also_closed == [True]
    np.testing.assert_allclose(poses, other, atol=1e-9)
    open_end, never = correct(library, around.frames, near_m=0.0)
    assert never == []
    error, open_error = (distance_m(Pose.of(one[-1]), Pose.of(around.truth[-1])) for one in (poses, open_end))
    assert error < min(0.05, 0.5 * open_error), open_error


def test_the_examples_are_short_and_correct_as_a_slam_must(library, monkeypatch):
    monkeypatch.setattr(slam_rules, "SCANS", 60)  # once around
    fixture = slam_rules.SlamFixture(partial(make, library))
    own = {name: rule for name, rule in slam_rules.RULES.items() if name not in odometry_rules.RULES}
    results = {name: check_rule(rule, fixture) for name, rule in own.items()}
    assert {name: one.observed for name, one in results.items() if one.outcome == "failed"} == {}
    assert [one.accepted for one in fixture.first_run.closures] == [True]
    for path in (C, PYTHON):
        assert len([line for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]) <= 100


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["library", PROGRAM], ids=["library", "program"])
def test_the_examples_follow_every_rule(request, name):
    rules = [rule for rule in runner.RULES["slam"] if rule != "slowdown"]  # by the clock of the machine
    backend = name if name == PROGRAM else request.getfixturevalue(name)
    assert runner.check(backend, only=rules, limit_s=300.0).broken == ()
