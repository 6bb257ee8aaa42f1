"""The C library and its binding: the tests of the library under sanitizers, and the input that the binding rejects."""

import math
import re
import shutil
import subprocess
import sys
import textwrap
import threading
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from evalkit.core import se2
from evalkit.core.pose import Pose
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit_baselines import embedded
from evalkit_baselines.embedded import compiled, mapper, pipeline, registration, scanlog

FOLDER = Path(compiled.__file__).parent
TOOLS = [tool for tool in ("cmake", "ctest", "cc") if shutil.which(tool) is None]

needs_core = pytest.mark.skipif(bool(why := compiled.compiled_missing()), reason=why or "the core is here")
PRECISIONS = ["double", "float"]
PARAMETERS = {
    "epsilon": 1e-4, "max_iterations": 40, "error": 0, "error_before": False, "one_to_one": True,
    "max_correspondence": 0.3, "min_pairs": 3,
}  # fmt: skip
MAP = {"resolution": 0.05, "l_occ": 0.8, "l_free": -0.8, "l_min": -5.0, "l_max": 5.0, "range_max": 12.0}
EXTENT = (-64, -64, 128, 128)
NO_LOG = "the file is not an evalkit scan log of this version or is truncated"
HEADER_BYTES = 4 + 2 * 4 + 5 * 8  # of a scan log (scanlog.h)
TABLES = (registration.PARAMETERS, frontend.PARAMETERS, mapper.PARAMETERS)
LAB = {p.name: p.default for p in registry.dataset("lab").parameters} | {"laps": 0.12, "seed": 5}


PARTS = ("refusals", "scan", "index", "icp", "grid", "pipeline", "scanlog", "drive", "slam_solve", "sizes", "status")
"""Tests of the core that compile and run in moments without optimisation."""

needs_tools = pytest.mark.skipif(bool(TOOLS), reason=f"not found: {', '.join(TOOLS)}; the core's own tests need them")


def build_core(folder, options, targets=()):
    options = [*options, "-DEK_WERROR=ON", "-DCMAKE_BUILD_TYPE=Debug"]
    run_tool("cmake", "-S", str(FOLDER), "-B", str(folder), *options)
    run_tool("cmake", "--build", str(folder), *(["--target", *targets] if targets else []))


def run_tool(*command):
    answer = subprocess.run(command, capture_output=True, text=True, timeout=1200, check=False)
    assert answer.returncode == 0, f"{' '.join(command)}\n{answer.stdout[-4000:]}\n{answer.stderr[-4000:]}"
    return answer.stdout


@pytest.fixture(scope="module")
def core_programs(tmp_path_factory):
    """Return the folder of evalkit-run and of the quickest tests, unoptimised, compiled without a warning."""
    if TOOLS:
        pytest.skip(f"not found: {', '.join(TOOLS)}; the core's own programs need them")
    folder = tmp_path_factory.mktemp("core")
    targets = ["evalkit-run", *(f"test_{part}" for part in PARTS)]
    build_core(folder, ["-DEK_BUILD_FLOAT=OFF", "-DCMAKE_C_FLAGS_DEBUG=-O0"], targets)
    return folder


@pytest.mark.parametrize("part", PARTS)
def test_the_quickest_tests_of_the_core_pass(core_programs, part):
    run_tool(str(core_programs / f"test_{part}"))


@needs_tools
@pytest.mark.parametrize("source", sorted((FOLDER / "fuzz").glob("*.c")), ids=lambda source: source.stem)
def test_every_fuzzer_compiles(source):
    folders = (f"-I{FOLDER / name}" for name in ("include", "src", "."))
    run_tool(
        "cc",
        "-std=c99",
        "-D_POSIX_C_SOURCE=200809L",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-fsyntax-only",
        *folders,
        str(source),
    )


@needs_tools
@pytest.mark.parametrize("option", ["", "-ffast-math", "-ffinite-math-only", "-Ofast"])
def test_the_core_is_not_compiled_without_infinite_numbers_and_nan(option):
    words = ["cc", "-std=c99", *option.split(), "-fsyntax-only", f"-I{FOLDER / 'include'}", FOLDER / "src" / "scan.c"]
    ended = subprocess.run(words, capture_output=True, text=True, check=False)
    refused = "compile without -ffast-math, -Ofast and /fp:fast" in ended.stderr
    assert (ended.returncode != 0, refused) == (bool(option), bool(option))


@pytest.mark.slow(40)
@pytest.mark.thorough
@needs_tools
@pytest.mark.parametrize("checks", ["-DEK_BUILD_FLOAT=OFF", "-DEK_SANITIZE=ON"])
def test_the_tests_of_the_core_pass_without_a_warning(tmp_path, checks):
    build_core(tmp_path, [checks, "-DCMAKE_C_FLAGS_DEBUG=-O1", "-DEK_BUILD_PROGRAMS=OFF"])
    assert "100% tests passed" in run_tool("ctest", "--test-dir", str(tmp_path), "--output-on-failure")


NEXT_SCANS = """#include <math.h>
#include <stdio.h>
int next_scan(ek_real *ranges, ek_real *angles, size_t *beams, int64_t *first_beam_ns)
{
    static int number;
    const double ahead = 0.1 * number; /* in a room of 8 m x 6 m */
    for (int k = 0; k < 300; k++) {
        const double angle = 2.0 * 3.14159265358979 * k / 300.0, c = cos(angle), s = sin(angle);
        const double across = ((c > 0.0 ? 4.0 : -4.0) - ahead) / c, up = (s > 0.0 ? 3.0 : -3.0) / s;
        angles[k] = (ek_real)angle;
        ranges[k] = (ek_real)(across < up ? across : up);
    }
    *beams = 300u;
    *first_beam_ns = 100000000 * (int64_t)number;
    return number++ < 5;
}
void take_pose(ek_pose pose)
{
    printf("%.9g %.9g %.9g\\n", (double)pose.x, (double)pose.y, (double)pose.theta);
}
int main(void)
{
    puts(run());
    return 0;
}
"""


@needs_tools
def test_the_program_and_the_sources_of_the_readme_give_the_poses_of_a_drive(tmp_path):
    """0.1 m ahead in each scan. The program compiles without a warning in either precision."""
    readme = (FOLDER / "README.md").read_text(encoding="utf-8")
    block = re.search(r"## Use\n\n((?:    .*\n|\n)+)", readme)
    names = re.search(r"^Sources of a pipeline, all in `src`: ([^.]+)\.", readme, re.MULTILINE)
    (tmp_path / "use.c").write_text(textwrap.dedent(block[1]) + NEXT_SCANS)
    sources = [str(FOLDER / "src" / f"{name}.c") for name in re.split(r",\s+", names[1])]
    words = ["cc", "-std=c99", "-O0", "-Wall", "-Wextra", "-Werror", f"-I{FOLDER / 'include'}", str(tmp_path / "use.c")]
    run_tool(*words, "-DEK_FLOAT", "-fsyntax-only")
    run_tool(*words, *sources, "-lm", "-o", str(tmp_path / "use"))
    *poses, status = run_tool(str(tmp_path / "use")).splitlines()
    assert status == "no error"
    found = np.array([[float(number) for number in line.split()] for line in poses])
    assert found == pytest.approx(np.array([[0.1 * k, 0.0, 0.0] for k in range(5)]), abs=0.02)


def test_every_header_begins_with_its_name_and_purpose():
    headers = sorted((FOLDER / "include" / "ek").glob("*.h"))
    assert headers
    for header in headers:
        assert header.read_text(encoding="utf-8").startswith(f"/* {header.name} - "), header.name


def small_pipeline(core):
    return core.Pipeline(
        core.Icp(**PARAMETERS), scan_to_scan=True, scan_to_map=True, deskew=True, local_radius=0.0, keyframes=3,
        keyframe_distance=0.5, keyframe_angle=0.3, min_inliers=10, beams=32,
    )  # fmt: skip


def call_or_message(call):
    """Return the result and "", or None and the error message."""
    try:
        return call(), ""
    except ValueError as error:
        return None, str(error)


ANY_NUMBER = st.floats(width=64, allow_nan=True, allow_infinity=True) | st.sampled_from([0.0, 1e6, -1e6, 1.0])
ANY_POINTS = st.integers(0, 30).flatmap(
    lambda n: arrays.arrays(np.float64, (n, 2), elements=ANY_NUMBER | st.floats(-3.0, 3.0))
)


@needs_core
@pytest.mark.parametrize("precision", PRECISIONS)
@settings(max_examples=200)
@given(
    ANY_POINTS,
    ANY_POINTS,
    st.tuples(ANY_NUMBER, ANY_NUMBER, ANY_NUMBER),
    st.integers(-2, 2**40),
    st.integers(-2, 2**40),
    st.integers(-1, 4),
    ANY_NUMBER | st.floats(0.0, 1e19),
)
def test_for_any_input_a_registration_is_valid_or_raises(precision, target, source, guess, most, least, error, reach):
    core = compiled.load_core(precision)
    with np.errstate(over="ignore"):
        target, source = target.astype(core.REAL), source.astype(core.REAL)
    parameters = PARAMETERS | {"max_iterations": min(most, 50), "min_pairs": least, "error": error}
    parameters["max_correspondence"] = reach
    answer, refused = call_or_message(lambda: core.Icp(**parameters).register(core.Index(target), source, guess, True))
    assert refused.partition(": ")[0] in ("", "parameters", "target", "registration")
    if answer is None:
        return
    row, converged, iterations, left, inliers, history = answer
    assert np.isfinite(row).all()
    assert 0 <= inliers <= len(source)
    assert len(history) == iterations <= 50
    assert np.isnan(left) or left >= 0.0
    for _, pairs_told, _, pairs in history:
        assert pairs.shape == (pairs_told, 2)
        assert (pairs >= 0).all()
        assert (pairs < [len(source), len(target)]).all()
    assert isinstance(converged, bool)


@needs_core
@pytest.mark.parametrize("precision", PRECISIONS)
@settings(max_examples=150)
@given(ANY_POINTS, ANY_POINTS, st.tuples(ANY_NUMBER, ANY_NUMBER, ANY_NUMBER))
def test_for_any_input_a_map_is_updated_or_stays_unchanged(precision, hits, misses, pose):
    core = compiled.load_core(precision)
    grid = core.Grid(extent=EXTENT, **MAP)
    grid.add((0.0, 0.0, 0.0), np.ones((1, 2), dtype=core.REAL), np.zeros((0, 2), dtype=core.REAL))
    before = grid.cells()
    with np.errstate(over="ignore"):
        hits, misses = hits.astype(core.REAL), misses.astype(core.REAL)
    _, refused = call_or_message(lambda: grid.add(pose, hits, misses))
    if refused:
        assert refused.startswith("scan: ")
        assert np.array_equal(grid.cells(), before)
        return
    known = grid.cells()[grid.cells() != -32768]
    assert (np.abs(known.astype(int)) <= 5000).all()
    assert grid.ignored_beams <= len(hits) + len(misses)


@needs_core
@pytest.mark.parametrize("precision", PRECISIONS)
@settings(max_examples=100)
@given(
    arrays.arrays(np.float64, st.integers(0, 40), elements=ANY_NUMBER | st.floats(0.2, 10.0)),
    st.integers(-(2**63), 2**63 - 3),
    st.integers(-1, 2**63 - 1),
    st.none() | st.tuples(ANY_NUMBER, ANY_NUMBER, ANY_NUMBER),
    st.none() | st.tuples(ANY_NUMBER, ANY_NUMBER, ANY_NUMBER),
    st.tuples(ANY_NUMBER, ANY_NUMBER),
)
def test_for_any_input_the_pipeline_returns_a_finite_pose_or_raises(
    precision, ranges, stamp, step, odom, moved, limits
):
    core = compiled.load_core(precision)
    pipeline = small_pipeline(core)
    with np.errstate(over="ignore"):
        ranges = ranges.astype(core.REAL)
    angles = np.linspace(-3.0, 3.0, len(ranges), dtype=core.REAL)
    scan = {"time_increment_ns": step, "ranges": ranges, "angles": angles, "odom_from_base": odom}
    for later, scan_limits in enumerate(((0.1, 12.0), limits, (0.1, 12.0))):
        now = {"stamp_ns": stamp + later, "range_limits": scan_limits, "start_from_end": moved}
        answer, refused = call_or_message(partial(pipeline.update, base_from_sensor=(0.1, 0.0, 0.0), **scan, **now))
        assert refused.startswith("scan: ") if answer is None else np.isfinite(answer[0]).all()


@needs_core
@pytest.mark.parametrize("precision", PRECISIONS)
def test_arrays_of_another_type_raise_instead_of_being_converted(precision):
    core = compiled.load_core(precision)
    good = np.zeros((4, 2), dtype=core.REAL)
    other = np.float32 if core.REAL == "float64" else np.float64
    for wrong in (
        good.astype(other),
        good.astype(int),
        good[:, :1],
        good.T,
        np.zeros((8, 4), dtype=core.REAL)[::2, ::2],
        [[0.0, 0.0]],
    ):
        with pytest.raises(TypeError):
            core.Index(wrong)
    good.flags.writeable = False
    assert len(core.Index(good)) == 4


@needs_core
def test_parameters_and_extents_outside_their_ranges_raise():
    core = compiled.load_core("double")
    for name, wrong in (("epsilon", -1.0), ("epsilon", np.nan), ("max_iterations", 0), ("max_iterations", -(2**40)),
                        ("min_pairs", 1), ("error", 3), ("max_correspondence", np.inf)):  # fmt: skip
        with pytest.raises(ValueError, match="parameters: a parameter is outside its range"):
            core.Icp(**PARAMETERS | {name: wrong})
    for extent in ((1, 0, 128, 128), (0, 0, 0, 128), (0, 0, 2**31, 32), (2**40, 0, 32, 32)):
        with pytest.raises(ValueError, match="map: a parameter is outside its range"):
            core.Grid(extent=extent, **MAP)
    grid = core.Grid(extent=EXTENT, **MAP)
    grid.add((0.0, 0.0, 0.0), np.ones((1, 2)), np.zeros((0, 2)))
    before = grid.cells()
    with pytest.raises(ValueError, match="map: "):
        grid.move((0, 0, 31, 32), 12.0)
    assert np.array_equal(grid.cells(), before)
    scan = {"stamp_ns": 0, "time_increment_ns": 0, "odom_from_base": None, "start_from_end": None}
    pipeline = small_pipeline(core)
    with pytest.raises(ValueError, match="ranges and angles differ"):
        pipeline.update(
            ranges=np.ones(3), angles=np.ones(2), base_from_sensor=(0.0, 0.0, 0.0), range_limits=(0.1, 12.0), **scan
        )


@needs_core
def test_a_table_that_is_too_large_or_finds_no_memory_is_refused_with_the_numbers():
    core = compiled.load_core("double")
    for tiles in (-1, 2**26 // 6 + 1, 2**40):
        with pytest.raises(ValueError, match=rf"table: found {tiles} tiles, expected 0 to 11184810"):
            core.Index(np.zeros((4, 2)), table=tiles)
    script = (
        "import numpy as np, resource; from evalkit_baselines.embedded.compiled import load_core\n"
        "core = load_core('double'); resource.setrlimit(resource.RLIMIT_AS, (2**32, 2**32))\n"
        "try: core.Index(np.zeros((4, 2)), table=2**26 // 6)\n"
        "except MemoryError as error: print(error)\n"
    )
    answer = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    number, words = answer.stdout.strip().split(" ", 1)
    assert int(number) > 2**26 * 100  # as many blocks of at least 100 bytes
    assert words == "bytes of memory are not free"


@needs_core
def test_a_shifted_map_keeps_the_cells_inside_both_extents():
    core, none = compiled.load_core("double"), np.zeros((0, 2))
    grid = core.Grid(extent=EXTENT, **MAP)
    rng = np.random.default_rng(0)
    grid.add((0.1, 0.2, 0.3), rng.uniform(-3.0, 3.0, (60, 2)), none)
    before = grid.cells()
    grid.move((-32, -96, 64, 128), 20.0)
    after = grid.cells()
    assert np.array_equal(after[32:128, :], before[0:96, 32:96])
    assert (after[:32] == -32768).all()


@needs_core
@pytest.mark.parametrize("kept", [{}, {"table": 5000}, {"neighbours": 8}])
def test_threads_may_use_the_same_objects(kept):
    core = compiled.load_core("double")
    rng = np.random.default_rng(0)
    targets = [core.Index(rng.uniform(-3.0, 3.0, (n, 2)), **kept) for n in (4000, 300)]
    source, answers = rng.uniform(-3.0, 3.0, (500, 2)), [[], []]
    shared, own = (core.Icp(**PARAMETERS, lines="neighbours" in kept) for _ in range(2))

    def ask(which, icp):
        for _ in range(30):
            answers[which].append(icp.register(targets[which], source, (0.0, 0.0, 0.0))[:5])

    threads = [threading.Thread(target=ask, args=(which, icp)) for which in (0, 1) for icp in (shared, own)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [len(set(told)) for told in answers] == [1, 1]
    assert [len(told) for told in answers] == [60, 60]


@needs_core
@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_table_of_neighbours_changes_no_result(precision):
    core = compiled.load_core(precision)
    rng = np.random.default_rng(1)
    points, source = (rng.uniform(-3.0, 3.0, (n, 2)).astype(core.REAL) for n in (4000, 500))
    icp = core.Icp(**PARAMETERS | {"epsilon": 0.0, "max_iterations": 15})
    indices = [core.Index(points, table=table) for table in (0, 1, 5000)]
    for guess in rng.uniform(-0.2, 0.2, (12, 3)):
        answers = [icp.register(index, source, tuple(guess))[:5] for index in indices]
        assert answers[0] == answers[1] == answers[2]


CONSUMER = """
#include <stdio.h>
#include "ek/pipeline.h"
static void tell(const ek_pipeline_parameters *parameters) {
    size_t bytes;
    if (ek_pipeline_bytes(parameters, &bytes) == EK_OK) printf("%zu\\n", bytes);
}
int main(void) {
    ek_pipeline_parameters p = ek_pipeline_default();
    tell(&p);
    p.frontend.points = 1600;
    p.grid.columns = p.grid.rows = 512;
    tell(&p);
    p.map = 0;
    tell(&p);
    p.map = 1;
    p.frontend.points = 360;
    p.frontend.keyframes = 5;
    p.frontend.cells = 8192;
    p.grid.columns = p.grid.rows = 256;
    p.grid.resolution = EK_R(0.1);
    p.scan.range_max = p.grid.range_max = EK_R(8.0);
    tell(&p);
    p = ek_pipeline_default();
    p.map = 0;
    p.frontend.points = 1600;
    p.frontend.map_voxel = EK_R(0.1);
    p.frontend.scan_to_scan.metric = p.frontend.scan_to_map.metric = EK_METRIC_LINE;
    tell(&p);
    p.frontend.points = 360;
    p.frontend.map_radius = EK_R(8.0);
    p.frontend.voxels = 4096;
    tell(&p);
    return 0;
}
"""
PROJECT = """
cmake_minimum_required(VERSION 3.18)
project(robot C)
find_package(evalkit_embedded REQUIRED)
foreach(bits 64 32)
  add_executable(robot${bits} robot.c)
  target_link_libraries(robot${bits} PRIVATE evalkit::ek${bits})
endforeach()
"""


@pytest.mark.thorough
@pytest.mark.skipif(bool(TOOLS), reason=f"not found: {', '.join(TOOLS)}; the core's own tests need them")
def test_another_project_finds_the_installed_core_and_uses_the_memory_stated_in_the_readme(tmp_path):
    (tmp_path / "robot.c").write_text(CONSUMER)
    (tmp_path / "CMakeLists.txt").write_text(PROJECT)
    core, there, robot = (str(tmp_path / name) for name in ("core", "installed", "robot"))
    debug = ["-DCMAKE_BUILD_TYPE=Debug"]
    for command in (
        ["cmake", "-S", str(FOLDER), "-B", core, "-DEK_BUILD_TESTS=OFF", "-DEK_BUILD_PROGRAMS=OFF", *debug],
        ["cmake", "--build", core],
        ["cmake", "--install", core, "--prefix", there],
        ["cmake", "-S", str(tmp_path), "-B", robot, f"-DCMAKE_PREFIX_PATH={there}", *debug],
        ["cmake", "--build", robot],
    ):
        answer = subprocess.run(command, capture_output=True, text=True, timeout=1200, check=False)
        assert answer.returncode == 0, f"{' '.join(command)}\n{answer.stdout[-4000:]}\n{answer.stderr[-4000:]}"
    told = [subprocess.check_output([f"{robot}/robot{bits}"], text=True).split() for bits in (64, 32)]
    table = (FOLDER / "README.md").read_text(encoding="utf-8").partition("## Memory")[2].splitlines()[4:10]
    assert [row.split(" | ")[1:] for row in table] == [
        [_bytes(int(double)), f"{_bytes(int(single))} |"] for double, single in zip(*told, strict=True)
    ]


def _bytes(count):
    return f"{count / 1e6:.1f} MB" if count >= 1e6 else f"{count / 1e3:.0f} kB"


@needs_core
@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_defaults_of_the_core_equal_those_of_python(precision):
    values = compiled.load_core(precision).defaults()
    icp, front_end, grid = ({p.name: p.default for p in table} for table in TABLES)
    icp["error"], icp["error_before"] = registration.ERRORS.index(icp["error"]), icp.pop("error_at") == "before"
    icp["lines"] = icp.pop("metric") == "line"
    del icp["trace"]  # not in the core's parameters of the registration
    neighbours = {"line_neighbours": icp.pop("line_neighbours")}  # of the front end there
    for stage in ("icp", "scan_to_scan", "scan_to_map"):
        assert values[stage] == pytest.approx(icp, rel=1e-6)
    stages = {name: front_end[name] for name in pipeline.FRONT_END if name != "local_map"} | neighbours
    stages["keyframe_angle_rad"] = math.radians(stages.pop("keyframe_angle_deg"))
    assert values["frontend"] == pytest.approx(stages, rel=1e-6)
    grid["widest_gap_rad"] = math.radians(3.0)
    assert values["grid"] == pytest.approx(grid, rel=1e-6)


def read_tum(path):
    rows = np.loadtxt(path)
    return np.column_stack([rows[:, 1:3], 2.0 * np.arctan2(rows[:, 6], rows[:, 7])])


def as_stored(frame):
    """The frame with ranges and angles as a scan log stores them, in single precision."""
    ranges, angles = (values.astype("<f4").astype(float) for values in (frame.scan.ranges, frame.scan.angles))
    return replace(frame, scan=replace(frame.scan, ranges=ranges, angles=angles))


@needs_core
@pytest.mark.parametrize(
    ("options", "spec", "method"),
    [
        ([], embedded.SPEC, "embedded"),
        (["--line", "--polygon"], embedded.PIPELINE_LINE, "embedded-pipeline-line"),
    ],
)
def test_evalkit_run_gives_the_poses_of_the_method(core_programs, tmp_path, options, spec, method):
    log, poses = tmp_path / "log", tmp_path / "poses.tum"
    frames = list(islice(registry.dataset("lab").make(**LAB).frames(), 90))
    assert scanlog.write_scan_log(log, frames) == 90
    run_tool(str(core_programs / "evalkit-run"), *options, str(log), str(poses))
    odometry = frontend.make_odometry(spec, frontend.complete_parameters(method, spec, {}))
    expected = [odometry.update(as_stored(frame)).pose.row for frame in frames]
    found = read_tum(poses)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-7)
    assert np.hypot(*np.diff(found[:, :2], axis=0).T).sum() > 1.0  # a moving robot, not one at rest


@needs_core
def test_evalkit_run_gives_the_corrected_poses_of_the_slam(core_programs, tmp_path):
    """A drive that closes a loop: the poses are those after the correction, which the poses at the time were not."""
    sequence = {p.name: p.default for p in registry.dataset("loop").parameters} | {"speed_mps": 0.8, "rate_hz": 5.0}
    frames = list(registry.dataset("loop").make(**sequence | {"laps": 1.3, "seed": 1}).frames())
    scanlog.write_scan_log(tmp_path / "log", frames)
    run_tool(str(core_programs / "evalkit-run"), "--slam", str(tmp_path / "log"), str(tmp_path / "poses.tum"))
    spec = registry.backend("embedded-slam")
    # memory for this log, as evalkit-run takes it; it decides what is computed only where it is used up
    sizes = {"beams": len(frames[0].scan.ranges), "keyframes": len(frames)}
    slam = spec.make(**{p.name: p.default for p in spec.parameters} | sizes)
    online = np.array([slam.update(as_stored(frame)).pose.row for frame in frames])
    final = slam.trajectory().poses
    np.testing.assert_allclose(read_tum(tmp_path / "poses.tum"), final, rtol=0.0, atol=1e-7)
    assert any(closure.accepted for closure in slam.loop_closures())
    assert np.abs(online - final)[:, :2].max() > 1e-3


def turn_in_room(beams=360, scans=40, turn=0.2, period_ns=100_000_000):
    """Sweeps of a robot that turns in place by `turn` (rad) a sweep in a room of 6 x 4 m, each beam at its own time."""
    first = next(iter(registry.dataset("room").make().frames()))
    angles = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    for number in range(scans):
        bearings = angles + turn * (number + np.arange(beams) / beams)
        with np.errstate(divide="ignore"):
            ranges = np.minimum(3.0 / np.abs(np.cos(bearings)), 2.0 / np.abs(np.sin(bearings)))
        scan = replace(
            first.scan, stamp_ns=number * period_ns, time_increment_ns=period_ns // beams, ranges=ranges, angles=angles
        )
        wheels = Pose(0.0, 0.0, se2.wrap(turn * number))
        turned = Pose(0.0, 0.0, turn * (1.0 - 1.0 / beams))
        yield replace(first, scan=scan, base_from_sensor=Pose(), odom_from_base=wheels, start_from_end=turned)


@needs_core
def test_the_map_of_a_slam_is_drawn_from_its_path(core_programs, tmp_path):
    """Sweeps of a turning robot, deskewed, draw walls within a cell (0.05 m) of the sides of the room."""
    scanlog.write_scan_log(tmp_path / "log", turn_in_room())
    run_tool(str(core_programs / "evalkit-run"), "--slam", *(str(tmp_path / end) for end in ("log", "tum", "map")))
    cells = np.frombuffer((tmp_path / "map").read_bytes()[-(1024 * 1024) :], dtype=np.uint8).reshape(1024, 1024)
    rows, columns = np.nonzero(cells[::-1] == 0)
    x, y = 0.05 * (columns - 511.5), 0.05 * (rows - 511.5)
    off = np.minimum(np.abs(np.abs(x) - 3.0), np.abs(np.abs(y) - 2.0))
    assert len(x) > 400
    assert off.max() < 0.05


@needs_core
def test_the_map_of_an_outline_has_the_walls_of_the_beams_and_frees_more(core_programs, tmp_path):
    """Every third beam of a scan, twice at one place: neighbouring beams skip cells, which the outline frees."""
    frame = next(iter(registry.dataset("lab").make(**LAB).frames()))
    scan = replace(frame.scan, ranges=frame.scan.ranges[::3], angles=frame.scan.angles[::3])
    again = replace(scan, stamp_ns=scan.stamp_ns + 100_000_000)
    scanlog.write_scan_log(tmp_path / "log", [replace(frame, scan=one) for one in (scan, again)])
    maps = {}
    for name, options in (("beams", []), ("outline", ["--polygon"])):
        run_tool(str(core_programs / "evalkit-run"), *options, *(str(tmp_path / end) for end in ("log", "tum", name)))
        maps[name] = np.frombuffer((tmp_path / name).read_bytes()[-(1024 * 1024) :], dtype=np.uint8)
    assert np.array_equal(maps["beams"] == 0, maps["outline"] == 0)
    assert (maps["outline"] == 254).sum() > (maps["beams"] == 254).sum() > 0


@pytest.mark.parametrize(
    ("names", "says"),
    [
        (("absent", "poses"), "absent: the scan log cannot be opened: No such file or directory"),
        (("text", "poses"), f"text: {NO_LOG}"),
        (("empty", "poses"), "empty: a scan log without scans"),
        (("torn", "poses"), "torn: scan 2: the file is not an evalkit scan log of this version or is truncated"),
        (
            ("--slam", "torn", "poses", "map"),
            "torn: scan 2: the file is not an evalkit scan log of this version or is truncated",
        ),
        (("--slam", "empty", "poses"), "empty: a scan log without scans"),
        (("--slam", "log", "/dev/full", "map"), "/dev/full: poses cannot be written: No space left on device"),
        (("log", "no/poses"), "no/poses: cannot be opened for the poses: No such file or directory"),
        (("log", "/dev/full"), "/dev/full: poses cannot be written: No space left on device"),
        (("log", "poses", "no/map"), "no/map: cannot be opened for the map: No such file or directory"),
        (("log", "poses", "/dev/full"), "/dev/full: the map cannot be written: No space left on device"),
    ],
)
def test_evalkit_run_names_the_file_and_what_is_wrong_with_it(core_programs, tmp_path, names, says):
    if "/dev/full" in names and not Path("/dev/full").exists():
        pytest.skip("no /dev/full on this system")
    frames = list(islice(registry.dataset("lab").make(**LAB).frames(), 2))
    scanlog.write_scan_log(tmp_path / "log", frames)
    content = (tmp_path / "log").read_bytes()
    (tmp_path / "torn").write_bytes(content[:-1])
    (tmp_path / "empty").write_bytes(content[:HEADER_BYTES])
    (tmp_path / "text").write_text("no log")
    command = [str(core_programs / "evalkit-run"), *names]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (answer.returncode, answer.stderr) == (1, f"evalkit-run: {says}\n")
    if "torn" in names:
        assert len((tmp_path / "poses").read_text().splitlines()) == 1  # of the scan before
        assert not (tmp_path / "map").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["nosuch", "log"], "no dataset named 'nosuch'"),
        (["lab", "no/log"], "no/log: cannot be written: No such file or directory"),
        (["lab", "log", "--every", "0"], "--every: found '0', expected a whole number from 1 on"),
        (["lab", "log", "--limit", "0"], "--limit: found '0', expected a whole number from 1 on"),
        (["lab", "log", "--limit", "-1"], "--limit: found '-1', expected a whole number from 1 on"),
    ],
)
def test_a_scan_log_that_cannot_be_written_is_a_usage_error(tmp_path, monkeypatch, capsys, words, says):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["scanlog", *words])
    with pytest.raises(SystemExit, match="2"):
        scanlog.main()
    assert says in capsys.readouterr().err
    assert not (tmp_path / "log").exists()


def write_bits(folder, name, poses, cells):
    lines = (f"{stamp} {x.hex()} {y.hex()} {theta.hex()}\n" for stamp, (x, y, theta) in enumerate(poses))
    (folder / f"{name}.bits").write_text("".join(lines))
    (folder / f"{name}.pgm").write_bytes(b"P5\n2 2\n255\n" + bytes(cells))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({}, "3 poses, 0 differ on b"),
        ({"poses": [(0.0, 0.0, 0.0), (0.5, math.nextafter(0.25, 1.0), 0.0), (1.0, 0.5, 0.0)]},
         "3 poses, 1 differ on b, the first in line 2"),
        ({"poses": [(0.0, 0.0, 0.0), (0.5, 0.25, 0.0)]}, "3 poses, 1 differ on b, the first in line 3"),
        ({"poses": []}, "b.bits: absent or empty"),
        ({"cells": (0, 205, 254, 205)}, "differ: byte 15, line 4"),
    ],
)  # fmt: skip
def test_the_comparison_of_processors_fails_for_one_wrong_bit(tmp_path, change, says):
    good = {"poses": [(0.0, 0.0, 0.0), (0.5, 0.25, 0.0), (1.0, 0.5, 0.0)], "cells": (0, 205, 254, 0)}
    write_bits(tmp_path, "a", **good)
    write_bits(tmp_path, "b", **good | change)
    command = [str(FOLDER / "board" / "same_bits"), "a", "b"]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert answer.returncode == bool(change)
    assert says in answer.stdout + answer.stderr
