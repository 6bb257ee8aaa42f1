"""The examples around matchers of other projects, each in its own process or library; skipped where not installed."""

import importlib.util
import math
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from evalkit.commands.validate.rules.scenes import ROOM, WORLD_FROM_START, clear_pair, distance_m, drive
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.external import INCLUDE
from evalkit.io.map_server import write_map
from evalkit.odometry.frontend import complete_parameters, make_odometry
from evalkit.odometry.run_odometry import estimate_poses
from evalkit.plugins import registry

EXAMPLES = INCLUDE / "examples"
MRPT = Path("/usr/include/mrpt")


def needs(module):
    return pytest.mark.skipif(
        importlib.util.find_spec(module) is None, reason=f"not installed: {module}; .ci/oracles installs it"
    )


def end_error_m(name, simulated, **parameters):
    spec = registry.backend(name)
    answers = estimate_poses(make_odometry(spec, complete_parameters(name, spec, parameters)), simulated.frames)
    assert answers[0].tolist() == [0.0, 0.0, 0.0]
    return distance_m(Pose.of(answers[-1]), Pose.of(simulated.truth[-1]))


@needs("karto_scanmatcher")
@pytest.mark.parametrize("mounting", [Pose(), Pose(0.2, 0.1, math.pi / 2)])
def test_karto_halves_the_error_of_slipping_wheels(mounting):
    program = f"exec:{sys.executable} {EXAMPLES / 'python' / 'karto.py'}"
    slipping = drive(odometry_gain=1.2, sweeping=False, base_from_sensor=mounting)
    first, last = (slipping.frames[index].odom_from_base for index in (0, -1))
    assert first is not None
    assert last is not None
    slip = distance_m(first.inverse() @ last, Pose.of(slipping.truth[-1]))
    assert end_error_m(program, slipping) < 0.5 * slip


@needs("amcl")
def test_amcl_stays_on_track_in_the_true_map(tmp_path):
    cell, low = 0.05, -5.0
    occupied = np.zeros((200, 200), dtype=bool)
    for segment in ROOM.segments:
        for share in np.linspace(0.0, 1.0, 400):
            x, y = np.asarray(segment).reshape(2, 2).T @ [1.0 - share, share]
            occupied[int((y - low) / cell), int((x - low) / cell)] = True
    grid = OccupancyGrid(np.where(occupied, 5.0, -5.0), np.ones_like(occupied), cell, low, low)
    write_map(tmp_path / "room", grid)
    start = {"map": f"{tmp_path}/room.yaml", "start_x_m": WORLD_FROM_START.x, "start_y_m": WORLD_FROM_START.y}
    start |= {"start_deg": math.degrees(WORLD_FROM_START.theta)}
    program = f"exec:{sys.executable} {EXAMPLES / 'python' / 'amcl_in_map.py'}"
    assert end_error_m(program, drive(sweeping=False), **start) < 0.25


@pytest.mark.slow  # builds against large headers
@pytest.mark.skipif(
    not MRPT.is_dir() or shutil.which("c++") is None,
    reason="not installed: MRPT, or a C++ compiler; .ci/oracles installs it",
)
def test_mrpt_behind_the_c_interface_recovers_a_known_motion(tmp_path):
    library = tmp_path / "libmrpt_icp.so"
    headers = [word for folder in sorted(MRPT.glob("*/include")) for word in ("-isystem", str(folder))]
    source = [EXAMPLES / "cpp" / "mrpt_icp.cpp", "-lmrpt-slam", "-lmrpt-maps", "-lmrpt-poses", "-lmrpt-system"]
    flags = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-I", INCLUDE, *headers]
    subprocess.run(list(map(str, ["c++", *flags, *source, "-o", library])), check=True)
    spec = registry.backend(f"lib:{library}")
    pair = clear_pair()
    matcher = spec.make(**{each.name: each.default for each in spec.parameters})
    match = matcher.register(pair.target, pair.source, pair.guess)
    assert distance_m(match.target_from_source, pair.truth) < 0.005
    assert match.inliers == len(pair.source)
    two = type(pair.target)(pair.target.points[:2])
    few = matcher.register(two, pair.source, pair.guess)
    assert (few.target_from_source, few.converged, few.inliers) == (pair.guess, False, 0)
