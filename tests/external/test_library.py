"""Shared libraries as back ends: the examples work, broken libraries fail with a reason."""

import gc
import shutil
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evalkit.config.limits import Limits
from evalkit.core.errors import BackendFailed, BadParameter, UnknownName
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame, Scan
from evalkit.execution import run_process
from evalkit.execution.one_run import Request
from evalkit.external import INCLUDE, elf, library
from evalkit.plugins import registry
from evalkit.plugins.parameters import resolve_parameters
from evalkit.results import descriptions
from evalkit.results.final_files import CLOSURES, FINAL, PATHS, parse_final, parse_paths

EXAMPLES = INCLUDE / "examples"
STRICT = ["-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
LIGHT = {"keyframes": 3, "local_map_voxel_m": 0.02}


def compile_file(output, compiler, *words):
    if shutil.which(compiler) is None:
        pytest.skip(f"no compiler '{compiler}' here")
    subprocess.run([compiler, *STRICT, *map(str, words), "-o", str(output), "-lm"], check=True)
    return output


@pytest.fixture(scope="session")
def build_folder(tmp_path_factory):
    """Folder in which the examples are built."""
    return tmp_path_factory.mktemp("examples")


@pytest.fixture(scope="session")
def c_library(build_folder):
    c = EXAMPLES / "c"
    words = ("-std=c99", "-shared", "-fPIC", "-I", INCLUDE, c / "library.c", c / "icp.c")
    return f"lib:{compile_file(build_folder / 'libicp.so', 'cc', *words)}"


@pytest.fixture(scope="session")
def c_program(build_folder):
    c = EXAMPLES / "c"
    return f"exec:{compile_file(build_folder / 'icp', 'cc', '-std=c99', c / 'program.c', c / 'icp.c')}"


@pytest.fixture(scope="session")
def cpp_library(build_folder):
    words = ("-std=c++17", "-shared", "-fPIC", "-I", INCLUDE, EXAMPLES / "cpp" / "odometry.cpp")
    return f"lib:{compile_file(build_folder / 'libodometry.so', 'c++', *words)}"


@pytest.fixture(scope="session")
def python_program():
    return f"exec:{sys.executable} {EXAMPLES / 'python' / 'icp.py'}"


GOOD = """
#include <math.h>
#include <stdlib.h>
#include "evalkit_backend.h"
static const char *said;
int32_t evalkit_abi(void) { return EVALKIT_ABI; }
int32_t evalkit_kind(void) { return EVALKIT_ODOMETRY; }
void *evalkit_create(const char *const *n, const char *const *v, size_t c)
{ (void)n; (void)v; (void)c; return malloc(1); }
int32_t evalkit_update(void *self, const evalkit_frame *frame, evalkit_pose *answer)
{ (void)self; *answer = *frame->odom_from_base; return 0; }
void evalkit_destroy(void *self) { free(self); }
const char *evalkit_last_error(void *self) { (void)self; return said; }
"""


@pytest.fixture
def build_variant(tmp_path):
    """Build GOOD with one piece replaced; returns its method name."""

    def build(old="", new=""):
        assert old in GOOD
        (tmp_path / "small.c").write_text(GOOD.replace(old, new) if old else GOOD)
        words = ("-std=c99", "-shared", "-fPIC", "-Wno-unused-variable", "-I", INCLUDE, tmp_path / "small.c")
        return f"lib:{compile_file(tmp_path / 'small.so', 'cc', *words)}"

    return build


@pytest.mark.parametrize("which", ["c_library", "c_program", "python_program"])
def test_an_external_registration_corrects_the_drift_of_the_wheels(which, request, run_backend):
    outcome, steps = run_backend(request.getfixturevalue(which), **LIGHT)
    assert (outcome.status, outcome.reason) == ("complete", "")
    answered = np.stack([steps["x"], steps["y"], steps["theta"]], axis=1)
    assert np.abs(answered - run_backend.truth).max() < 0.03  # wheel odometry alone: 0.2 m at the end
    assert steps["s2m_inliers"][1:].min() > 50
    assert steps["s2m_error"][1:].max() < 0.05


def test_a_library_that_is_described_in_a_results_folder_is_not_loaded(build_variant, tmp_path):
    mark = f'__attribute__((constructor)) static void mark(void) {{ fclose(fopen("{tmp_path}/mark", "w")); }}'
    name = build_variant("static const char *said;", f"#include <stdio.h>\nstatic const char *said;\n{mark}")
    known = registry.backend(name)
    assert (tmp_path / "mark").exists()
    descriptions.save(tmp_path / "results", [name])
    (tmp_path / "mark").unlink()
    with descriptions.only_stored_in(tmp_path / "results"):
        assert registry.backend(name).digest == known.digest
    with descriptions.only_stored_in(tmp_path / "elsewhere"):
        assert registry.backend(name).broken == descriptions.UNKNOWN
    assert not (tmp_path / "mark").exists()


def test_an_external_odometry_corrects_the_drift_of_the_wheels(cpp_library, run_backend):
    outcome, steps = run_backend(cpp_library)
    assert (outcome.status, outcome.reason) == ("complete", "")
    answered = np.stack([steps["x"], steps["y"], steps["theta"]], axis=1)
    assert np.abs(answered - run_backend.truth).max() < 0.05
    assert steps["device_ns"].tolist() == [0] * len(steps)  # a library reports none


def make_odometry(name, **given):
    spec = registry.backend(name)
    assert not spec.missing() + spec.broken
    return spec.make(**resolve_parameters(name, spec.parameters, given))


def test_one_method_gives_one_result_as_a_library_and_as_programs(c_library, c_program, python_program):
    rng = np.random.default_rng(5)
    target = rng.uniform(-3, 3, (80, 2))
    motion = Pose(0.05, -0.03, 0.04)
    source = motion.inverse().transform(target)
    answers = [
        make_odometry(name).register(Cloud(target), Cloud(source), Pose())
        for name in (c_library, c_program, python_program)
    ]
    for answer in answers:
        assert answer.target_from_source.row == pytest.approx(motion.row, abs=1e-12)
        assert (answer.converged, answer.inliers) == (True, 80)
        assert answer.iterations == answers[0].iterations
        assert answer.error == pytest.approx(answers[0].error, abs=1e-12)


@pytest.mark.parametrize("which", ["c_library", "c_program", "python_program"])
def test_without_points_the_guess_is_kept_and_nothing_converges(which, request):
    follower = make_odometry(request.getfixturevalue(which))
    empty, guess = Cloud(np.zeros((0, 2))), Pose(1.0, 2.0, 0.5)
    for target, source in ((empty, empty), (Cloud(np.eye(2)), empty), (empty, Cloud(np.eye(2)))):
        answer = follower.register(target, source, guess)
        assert answer.target_from_source.row.tolist() == [1.0, 2.0, 0.5]
        assert (answer.converged, answer.inliers, np.isnan(answer.error)) == (False, 0, True)


def test_a_traced_library_reports_every_iteration_with_the_same_result(c_library):
    rng = np.random.default_rng(6)
    target = rng.uniform(-3, 3, (60, 2))
    source = Pose(0.1, 0.05, -0.05).transform(target)
    plain = make_odometry(c_library).register(Cloud(target), Cloud(source), Pose())
    traced = make_odometry(c_library, trace=True).register(Cloud(target), Cloud(source), Pose())
    assert plain.history == ()
    assert len(traced.history) == traced.iterations == plain.iterations
    assert traced.history[-1].target_from_source == traced.target_from_source == plain.target_from_source
    errors = [iteration.error for iteration in traced.history]
    assert errors[0] > errors[-1] == traced.error


def test_settings_after_the_file_name_are_the_defaults(c_library):
    once = registry.backend(f"{c_library} max_iterations=1 max_correspondence_m=2")
    defaults = {parameter.name: parameter.default for parameter in once.parameters}
    assert defaults == {"max_correspondence_m": 2.0, "max_iterations": 1, "trace": False}
    cloud = Cloud(np.random.default_rng(7).uniform(-1, 1, (20, 2)))
    assert once.make(**defaults).register(cloud, cloud, Pose(0.3)).iterations == 1
    with pytest.raises(UnknownName, match="no parameter named 'most'"):
        registry.backend(f"{c_library} most=1")
    with pytest.raises(BadParameter, match="'max_iterations': found 'many'"):
        registry.backend(f"{c_library} max_iterations=many")
    with pytest.raises(BadParameter, match="NAME=VALUE"):
        registry.backend(f"{c_library} fast")


def test_a_library_may_reject_its_parameters_with_its_own_message(c_library):
    with pytest.raises(BackendFailed, match="evalkit_create returned NULL: max_correspondence_m must be more than 0"):
        make_odometry(c_library, max_correspondence_m=-1.0)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("return EVALKIT_ABI", "return 2", "has version 2 of the interface, expected 1"),
        ("return EVALKIT_ODOMETRY", "return 7", "evalkit_kind returned 7"),
        ("return EVALKIT_ODOMETRY", "return EVALKIT_REGISTRATION", "lacks the function evalkit_register"),
        ("void *evalkit_create", "void *evalkit_make", "lacks the function evalkit_create"),
        ("int32_t evalkit_abi", "int32_t evalkit_abi_version", "lacks the function evalkit_abi"),
        (
            "#include <math.h>",
            "__attribute__((constructor)) static void begin(void) { __builtin_trap(); }",
            "loading it",
        ),
        ("#include <math.h>", "extern int absent(void); int (*needed)(void) = absent;", "undefined symbol: absent"),
    ],
)
def test_an_incompatible_library_fails_with_a_reason(build_variant, run_backend, old, new, said):
    outcome, steps = run_backend(build_variant(old, new))
    assert outcome.status == "failed"
    assert said in outcome.reason
    assert len(steps) == 0


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("return malloc(1)", 'said = "no device"; return NULL', "evalkit_create returned NULL: no device"),
        ("*answer = *frame->odom_from_base;", "(void)frame; (void)answer;", "pose that is not finite: (nan, nan, nan)"),
        ("= *frame->odom_from_base; return 0", '= frame->base_from_sensor; said = "lost"; return 3', "error 3: lost"),
    ],
)
def test_a_failing_library_gives_its_own_message_as_the_reason(build_variant, run_backend, old, new, said):
    outcome, _ = run_backend(build_variant(old, new))
    assert outcome.status == "failed"
    assert said in outcome.reason


def test_a_library_linked_with_fast_math_leaves_small_numbers_to_the_others(tmp_path):
    c = INCLUDE / "examples" / "c"
    words = ["-shared", "-fPIC", "-ffast-math", "-I", INCLUDE, c / "library.c", c / "icp.c", "-lm"]
    file = compile_file(tmp_path / "fast.so", "cc", *words)
    load = "import sys; from pathlib import Path; from evalkit.external import abi; abi.load('x', Path(sys.argv[1]))"
    code = f"{load}; print(float.fromhex('0x1p-1074') * float(len(sys.argv) - 1) > 0.0)"
    done = subprocess.run([sys.executable, "-c", code, str(file)], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"


def test_an_instance_of_a_library_is_destroyed_once_when_nothing_refers_to_it(build_variant, tmp_path):
    destroyed = tmp_path / "destroyed"
    noted = f'FILE *file = fopen("{destroyed}", "a"); fputc(42, file); fclose(file); free(self);'
    name = build_variant("void evalkit_destroy(void *self) { free(self); }",
                         f"#include <stdio.h>\nvoid evalkit_destroy(void *self) {{ {noted} }}")  # fmt: skip
    one, other = make_odometry(name), make_odometry(name)
    assert not destroyed.exists()
    del one
    gc.collect()
    assert destroyed.read_text() == "*"
    del other
    gc.collect()
    assert destroyed.read_text() == "**"


def test_a_library_that_crashes_ends_only_its_own_run(build_variant, tmp_path):
    name = build_variant(
        "*answer = *frame->odom_from_base;", "(void)frame; *(volatile int *)answer = 0; __builtin_trap();"
    )
    request = Request(name, {}, "room", {**defaults("room"), "laps": 0.02})
    run = run_process.run(request, tmp_path, Limits(600, 300, 2048), lambda _: None, threading.Event())
    assert run.status == "crashed"
    assert "SIGILL" in run.reason or "SIGTRAP" in run.reason


def defaults(dataset):
    return {parameter.name: parameter.default for parameter in registry.dataset(dataset).parameters}


def test_a_library_that_hangs_when_loaded_fails(build_variant, run_backend, monkeypatch):
    monkeypatch.setattr(library, "LOADING_S", 0.5)
    begin = "#include <unistd.h>\n__attribute__((constructor)) static void begin(void) { sleep(120); }"
    outcome, _ = run_backend(build_variant("#include <math.h>", begin))
    assert (outcome.status, "was not loaded within 0.5 s" in outcome.reason) == ("failed", True)


def test_nothing_is_left_of_a_process_that_a_library_starts_when_it_is_described(build_variant, tmp_path, has_ended):
    left = tmp_path / "left"
    begin = f"""
    #include <stdio.h>
    #include <unistd.h>
    __attribute__((constructor)) static void begin(void) {{
        int ends[2];
        char said;
        if (pipe(ends)) return;
        if (fork()) {{
            close(ends[1]);
            if (read(ends[0], &said, 1) < 0) return;  /* until the child has written its number, or has ended */
            close(ends[0]);
            return;
        }}
        setsid();
        FILE *file = fopen("{left}", "w");
        fprintf(file, "%d", getpid());
        fclose(file);
        close(ends[1]);
        sleep(900);
    }}"""
    spec = registry.backend(build_variant("#include <math.h>", begin + "\n#include <math.h>"))
    assert spec.broken == ""
    assert has_ended(int(left.read_text()))


def test_a_file_that_is_not_a_library_of_this_machine_is_reported(tmp_path, foreign_elf):
    if sys.platform != "linux":
        pytest.skip("this system does not use ELF")
    path = tmp_path / "libmine.so"
    assert f"no such file: {path};" in registry.backend(f"lib:{path}").missing()
    assert registry.backend(f"lib:{tmp_path}").missing().startswith(f"a folder, not a library: {tmp_path};")
    path.write_bytes(foreign_elf)
    assert "libmine.so is built for 64-bit RISC-V, and this machine is 64-bit" in registry.backend(f"lib:{path}").broken
    assert registry.backend(f"lib:{path}").missing() == ""
    path.write_text("INPUT ( libmine.so.1 )")
    assert "is not a shared library (it begins with b'INPUT ( ')" in registry.backend(f"lib:{path}").broken
    own = Path(sys.executable).read_bytes()[:64]
    path.write_bytes(own[:16] + (b"\x01\x00" if own[5] == 1 else b"\x00\x01") + own[18:])
    assert "an object file or a program" in registry.backend(f"lib:{path}").broken


def test_the_static_memory_of_a_library_is_the_size_of_its_sections(tmp_path):
    compiler, size = shutil.which("cc"), shutil.which("size")
    if sys.platform != "linux" or compiler is None:
        pytest.skip("no compiler that makes ELF files")
    path = tmp_path / "libsized.so"
    (tmp_path / "sized.c").write_text("int filled[2500] = {1}; int empty[250000]; int f(void) { return filled[0]; }\n")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", path, tmp_path / "sized.c"], check=True)
    found = elf.read_sizes(path)
    assert 10_000 <= found.data < 12_000
    assert 1_000_000 <= found.bss < 1_001_000
    assert 0 < found.text < 10_000
    if size is not None:
        told = subprocess.run([size, path], check=True, capture_output=True, text=True).stdout.splitlines()[1].split()
        assert [found.text, found.data, found.bss] == [int(word) for word in told[:3]]
    path.write_bytes(path.read_bytes()[:200])
    assert elf.read_sizes(path) is None
    path.write_text("#!/bin/sh\n")
    assert elf.read_sizes(path) is None


def test_elf_headers_are_read_in_both_byte_orders():
    assert elf.read_machine(b"\x7fELF\x01\x02\x01" + bytes(9) + b"\x00\x03\x00\x08") == "32-bit MIPS"
    assert elf.read_machine(b"\x7fELF\x02\x01\x01" + bytes(9) + b"\x03\x00\xb7\x00") == "64-bit AArch64"
    assert elf.read_machine(b"\x7fELF\x02\x01\x01" + bytes(9) + b"\x03\x00\x99\x99") == "64-bit machine 0x9999"
    assert elf.read_machine(b"#!/bin/sh\nexec ./icp\n") == elf.read_machine(b"") == ""


def test_the_cache_key_contains_the_content_of_the_library(build_variant):
    name = build_variant()
    before = registry.hash_run_code(name, "room")
    build_variant("said;", "said = 0;\nint another_build;")
    assert registry.hash_run_code(name, "room") != before
    assert replace(registry.backend(name), digest="").kind == "odometry"


SLAM = """
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "evalkit_backend.h"
typedef struct { evalkit_pose pose[1000]; int64_t stamp[1000]; size_t count; } wheels;
int32_t evalkit_abi(void) { return EVALKIT_ABI; }
int32_t evalkit_kind(void) { return EVALKIT_SLAM; }
void *evalkit_create(const char *const *n, const char *const *v, size_t c)
{ (void)n; (void)v; (void)c; return calloc(1, sizeof(wheels)); }
int32_t evalkit_update(void *self, const evalkit_frame *frame, evalkit_pose *answer)
{
    wheels *w = self;
    w->stamp[w->count] = frame->stamp_ns;
    *answer = w->pose[w->count++] = *frame->odom_from_base;
    return 0;
}
int32_t evalkit_trajectory(void *self, evalkit_pose *poses, size_t count)
{
    wheels *w = self;
    memcpy(poses, w->pose, count * sizeof *poses);
    for (size_t i = 1; i < count; i++) poses[i].y += 0.01;
    return 0;
}
size_t evalkit_loop_closures(void *self, evalkit_loop_closure *closures, size_t room)
{
    wheels *w = self;
    if (room) closures[0] = (evalkit_loop_closure){w->stamp[5], w->stamp[1], {0.1, 0.2, 0.3}, 1, "score 0.9"};
    return 1;
}
int32_t evalkit_corrected(void *self) { return ((wheels *)self)->count == 6; }
void evalkit_destroy(void *self) { free(self); }
"""


@pytest.fixture
def build_slam(tmp_path):
    """Build SLAM with one piece replaced; returns its method name."""

    def build(old="", new=""):
        assert old in SLAM
        (tmp_path / "slam.c").write_text(SLAM.replace(old, new) if old else SLAM)
        words = ("-std=c99", "-shared", "-fPIC", "-Wno-unused", "-I", INCLUDE, tmp_path / "slam.c")
        return f"lib:{compile_file(tmp_path / 'slam.so', 'cc', *words)}"

    return build


def test_a_library_corrects_its_poses_and_reports_its_loop_closures(build_slam, run_backend, tmp_path):
    name = build_slam()
    assert registry.backend(name).kind == "slam"
    outcome, steps = run_backend(name)
    assert (outcome.status, outcome.reason) == ("complete", "")
    assert steps["corrected"].tolist() == [int(index == 5) for index in range(len(steps))]
    (folder,) = (path.parent for path in tmp_path.glob(f"*/{FINAL}"))
    files = {name: (folder / name).read_bytes() for name in (FINAL, CLOSURES)}
    final, closures = parse_final(files, steps["stamp_ns"])
    assert final.poses[1:, 1] == pytest.approx(steps["y"][1:] + 0.01, abs=1e-12)
    stamps = steps["stamp_ns"].tolist()
    assert closures == (LoopClosure(stamps[5], stamps[1], Pose(0.1, 0.2, 0.3), True, "score 0.9"),)
    (path,) = parse_paths((folder / PATHS).read_bytes(), steps["stamp_ns"])
    assert (path.stamp_ns, path.stamps_ns.tolist()) == (stamps[5], stamps[:5])
    assert path.moved_m == pytest.approx([0.0, *[0.01] * 4], abs=1e-12)


@pytest.mark.parametrize("again", ["closure != 0", "closure == 0"])
def test_a_library_says_of_each_closure_whether_it_found_a_lost_track_again(build_slam, again):
    function = f"int32_t evalkit_found_again(void *self, size_t closure) {{ return {again}; }}\n"
    spec = registry.backend(build_slam("int32_t evalkit_corrected", f"{function}int32_t evalkit_corrected"))
    slam = spec.make()
    for number in range(6):
        frame = Frame(Scan(number, np.ones(1), np.zeros(1), 0.1, 9.0), odom_from_base=Pose(0.1 * number))
        slam.update(frame)
    (found,) = slam.loop_closures()
    assert found.found_again is (again == "closure == 0")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("int32_t evalkit_trajectory", "int32_t evalkit_path", "lacks the function evalkit_trajectory"),
        ("memcpy(poses, w->pose, count * sizeof *poses);", "(void)w; return 4;", "evalkit_trajectory returned error 4"),
        ("count * sizeof *poses", "3 * sizeof *poses", "evalkit_trajectory set no finite pose at index 3 of 40"),
        (
            "    return 1;",
            "    return (size_t)1 << 40;",
            "evalkit_loop_closures returned 1099511627776, at most 100000",
        ),
        ("w->stamp[5], w->stamp[1]", "w->stamp[1], w->stamp[5]", "other_stamp_ns: expected a time before"),
        ("w->stamp[5], w->stamp[1]", "w->stamp[5] + 1, w->stamp[1]", "set stamp_ns at index 0 to 500000001, which no"),
    ],
)
def test_a_library_with_a_wrong_correction_fails_with_a_reason(build_slam, run_backend, old, new, said):
    outcome, _ = run_backend(build_slam(old, new))
    assert outcome.status == "failed"
    assert said in outcome.reason


def test_a_slam_library_needs_neither_loop_closures_nor_reports_of_corrections(build_slam, run_backend):
    name = build_slam("size_t evalkit_loop_closures", "size_t other_closures").removeprefix("lib:")
    source = Path(name).with_suffix(".c")
    source.write_text(source.read_text().replace("evalkit_corrected", "other_corrected"))
    words = ("-std=c99", "-shared", "-fPIC", "-Wno-unused", "-I", INCLUDE, source)
    outcome, steps = run_backend(f"lib:{compile_file(Path(name), 'cc', *words)}")
    assert outcome.status == "complete"
    assert set(steps["corrected"].tolist()) == {-1}
