"""A library that is linked with ``serve.c`` is a program with the same answers, to the bit."""

import shutil
import subprocess

import numpy as np
import pytest

from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.external import INCLUDE
from evalkit.plugins import registry

C = INCLUDE / "examples" / "c"


@pytest.mark.skipif(shutil.which("cc") is None, reason="no compiler 'cc' here")
def test_a_library_gives_its_own_answers_as_a_program(tmp_path):
    library, program = tmp_path / "libicp.so", tmp_path / "icp"
    words = ["cc", "-std=c99", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I", str(INCLUDE)]
    sources = [str(C / "library.c"), str(C / "icp.c")]
    subprocess.run([*words, "-shared", "-fPIC", *sources, "-o", str(library), "-lm"], check=True)
    subprocess.run([*words, str(C / "serve.c"), *sources, "-o", str(program), "-lm"], check=True)
    specs = [registry.backend(name) for name in (f"lib:{library}", f"exec:{program}")]
    own = {one.name: one for one in specs[0].parameters if one.name != "trace"}
    declared = {one.name: one for one in specs[1].parameters}
    assert {name: declared[name].default for name in own} == {name: one.default for name, one in own.items()}
    rng = np.random.default_rng(3)
    target = Cloud(rng.uniform(-3.0, 3.0, (40, 2)))
    source = Cloud(target.points[:25] + rng.normal(0.0, 0.02, (25, 2)))
    given = {name: one.default for name, one in own.items()} | {"max_iterations": 7, "trace": True}
    made = [specs[0].make(**given), specs[1].make(**given, answer_timeout_s=300.0)]
    first, second = (one.register(target, source, Pose(0.02, -0.01, 0.03)) for one in made)
    assert first.target_from_source == second.target_from_source
    assert (first.converged, first.iterations, first.error, first.inliers) == (
        second.converged, second.iterations, second.error, second.inliers,
    )  # fmt: skip
    assert len(first.history) == first.iterations
    assert [(one.target_from_source, one.error, one.inliers) for one in first.history] == [
        (one.target_from_source, one.error, one.inliers) for one in second.history
    ]


@pytest.mark.skipif(shutil.which("cc") is None, reason="no compiler 'cc' here")
@pytest.mark.parametrize("source", ["serve.c", "program.c"])
def test_an_error_that_is_no_number_is_no_number_with_fast_arithmetic_too(tmp_path, source):
    """Points 1 km apart make no pairs within 2 m, so that there is no error to answer."""
    sources = [C / source, C / "icp.c", *([C / "library.c"] if source == "serve.c" else [])]
    program = tmp_path / "icp"
    words = ["cc", "-std=c99", "-O3", "-ffast-math", "-I", INCLUDE]
    subprocess.run([*map(str, [*words, *sources, "-o", program]), "-lm"], check=True)
    spec = registry.backend(f"exec:{program}")
    made = spec.make(**{one.name: one.default for one in spec.parameters} | {"max_correspondence_m": 2.0})
    near = Cloud(np.random.default_rng(1).uniform(-3.0, 3.0, (20, 2)))
    match = made.register(near, Cloud(near.points + 1000.0), Pose(0.0, 0.0, 0.0))
    assert (match.converged, match.inliers) == (False, 0)
    assert not np.isfinite(match.error)
