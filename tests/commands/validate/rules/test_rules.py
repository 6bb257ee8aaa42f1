"""The rules of back ends: shipped back ends pass, and each faulty one breaks the rule named for its fault."""

import importlib
import importlib.util
import json
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import psutil
import pytest

from evalkit import cli
from evalkit.commands.validate.rules import (
    endurance,
    odometry_fixture,
    odometry_rules,
    odometry_state_rules,
    process_state,
    range_rules,
    registration_rules,
    runner,
    state_rules,
)
from evalkit.commands.validate.rules.registration_fixture import RegistrationFixture
from evalkit.commands.validate.rules.rule import RuleReport, check_rule
from evalkit.core.errors import BackendFailed, BadParameter, NotInstalled, UnknownName
from evalkit.core.scan import Cloud
from evalkit.execution.usage import Usage
from evalkit.plugins import registry
from evalkit.plugins.parameters import resolve_parameters

pytestmark = pytest.mark.slow(40)

sys.path.append(str(Path(__file__).parents[3] / "misfits"))  # as a package under development would be
faulty = importlib.import_module("faulty_backends")


def result_of(make, rule, **options):
    """Return the result of one rule, checked in this process."""
    if hasattr(make, "register"):
        return check_rule(registration_rules.RULES[rule], RegistrationFixture(make))
    return check_rule(odometry_rules.RULES[rule], odometry_fixture.OdometryFixture(make, **options))


def outcomes(checked):
    return {one.rule: one.outcome for one in checked.results}


class CountingClock:
    """The clocks of the module time, except that of a thread: it counts the functions that are called, as 1 us each.

    Another program can slow down a call, but does not change this count.
    """

    monotonic, process_time, perf_counter_ns = time.monotonic, time.process_time, time.perf_counter_ns

    def __init__(self, call_count):
        self._call_count = call_count

    def thread_time_ns(self):
        return 1000 * self._call_count.calls

    def clock_gettime_ns(self, _clock):
        """Of a program that another test has started."""
        return 0


@pytest.fixture
def few_calls(monkeypatch, call_count):
    """Let the rules on memory make fewer calls, those on the clock wait for less time, and ask of fewer points.

    The times of calls are numbers of functions, with which a rule is broken on a busy machine as on an idle one.
    """
    monkeypatch.setattr(endurance, "time", CountingClock(call_count))
    monkeypatch.setattr(range_rules, "LARGE", 5000)
    monkeypatch.setattr(endurance, "BUDGET_S", 0.15)
    monkeypatch.setattr(endurance, "PROGRAM_BUDGET_S", 0.3)
    monkeypatch.setattr(endurance, "INSTANCES", 40)
    for rules in (state_rules, odometry_state_rules):
        monkeypatch.setattr(rules, "LATER_S", 0.2)
    monkeypatch.setattr(state_rules, "PAUSES_S", (0.0,))
    with call_count.counting():
        yield


def with_children():
    """The rule that cannot be checked here while a browser or a program of other tests is a child of this process."""
    return {"files"} if psutil.Process().children() else set()


def follows_every_rule(name, checked, not_here=frozenset()):
    """Whether no rule is broken, and only those that do not concern this back end are excused."""
    assert [f"{one.rule}: {one.observed}" for one in checked.broken] == []
    excused = {one.rule for one in checked.results if one.outcome == "not applicable"}
    unreported = {"corrections"} & excused  # a SLAM need not report them
    expected = {
        "wheel-odometry": {"moves", "without-odometry"}, "kinematic-icp": {"without-odometry"},
        "ndt": {"ends"}, "small-gicp": {"ends"},  # cells and samples leave points out
    }  # fmt: skip
    assert excused - unreported == expected.get(name, set()) | not_here


IN_A_PROCESS = [
    pytest.param(name, marks=() if name in ("wheel-odometry", "embedded") else pytest.mark.thorough)
    for name in registry.names("backends")
]


@pytest.mark.parametrize("name", IN_A_PROCESS)
def test_every_shipped_back_end_follows_every_rule(name):
    """But the one on the clock of the machine, ``slowdown``: the next test checks it by counted calls."""
    spec = registry.backend(name)
    if why := spec.missing():
        pytest.skip(why)
    rules = [rule for rule in runner.RULES[spec.kind] if rule != "slowdown"]
    follows_every_rule(name, runner.check(name, only=rules, limit_s=300.0))


QUICK = ("embedded", "embedded-pipeline", "kiss-icp", "open3d-icp", "paper", "wheel-odometry")
HERE = [pytest.param(name, marks=[pytest.mark.thorough] * (name not in QUICK)) for name in registry.names("backends")]


@pytest.mark.parametrize("name", HERE)
def test_every_shipped_back_end_follows_every_rule_that_needs_no_other_process_over_few_calls(name, few_calls):
    spec = registry.backend(name)
    if why := spec.missing():
        pytest.skip(why)
    complete = resolve_parameters(name, spec.parameters, {})
    results = runner._check_here(spec, complete, runner.RULES[spec.kind], seed=0)
    follows_every_rule(name, RuleReport(name, results), {"process", *runner.PROCESS_RULES} | with_children())


@pytest.mark.parametrize(
    ("make", "rule", "said"),
    [
        (faulty.Guess, "moves", "the guess was returned unchanged, 19 cm off at 4 m"),
        (faulty.Guess, "recovers", "22.4 mm|36.1 mm"),
        (faulty.Identity, "metres", "0.3 m was returned as 0"),
        (faulty.Identity, "equivariance", "moved with the target, .*: the guess changes nothing"),
        (faulty.IgnoresTheGuess, "equivariance", "moved with the target, .*: the guess changes nothing"),
        (faulty.Inverse, "direction", "rad. is source_from_target; target_from_source is"),
        (faulty.InverseOffByACell, "direction", "is nearer to source_from_target, .*; target_from_source is"),
        (faulty.Correction, "direction", "is the correction of the guess .0.335 m, .*; target_from_source is"),
        (faulty.LeftCorrection, "direction", "is the correction of the guess .0.335 m, "),
        (faulty.Degrees, "radians", r"as -1.66\d+, that is 17.19 - 3 \* 2 pi: is the angle in degrees\?"),
        (faulty.Clockwise, "radians", "it has the wrong sign, as in a mirror: .* or do angles turn clockwise"),
        (faulty.Millimetres, "metres", "0.3 m was returned as 300: the answer is in millimetres"),
        (faulty.Biased, "identity", r"30.0 mm and 0.00 deg from the identity"),
        (faulty.Biased, "inverse", "from the inverse"),
        (faulty.ByIndex, "order", "from the answer in the first order"),
        (faulty.Halves, "duplicates", "from the answer with every point once"),
        (faulty.Stateful, "stateless", "has another answer after other questions"),
        (faulty.Random, "deterministic", "has another answer from a new object"),
        (faulty.WritesWithNumpy, "read-only", "it writes to the points of a cloud .*read-only.*: use a copy"),
        (faulty.WritesWithNumpy, "starts", r"read-only \(faulty_backends.py, line \d+\): .*, work on a copy"),
        (faulty.WritesThroughPointer, "read-only", "the points of a cloud changed in the call"),
        (faulty.AlwaysConverged, "converged", "reports converged on 0 pairs, 100 m off"),
        (faulty.WithoutTheLast, "ends", "the last of 150 source points, moved by 1 cm, changes nothing"),
        (faulty.NoPairs, "inliers", "inliers 0; with too few, evalkit's front end keeps the guess"),
        (faulty.Unbounded, "wall", "the answer is far off"),
        (faulty.Nan, "few-points", "one point: target_from_source is None"),
        (faulty.NanPose, "few-points", "one point: raises ValueError: pose: not finite: .*; return the guess with"),
        (faulty.Matrix, "starts", "register.. returns a ndarray"),
        (faulty.Raises, "recovers", "raises RuntimeError: the licence has run out"),
        (faulty.Leaks, "memory", "one object grows by .* bytes with each question, in .* calls and again in twice"),
        (faulty.StartsElsewhere, "first", "the first answer is .10.000 m, -5.000 m, 1.0000 rad"),
        (faulty.Stands, "follows", "with true wheel odometry: 59.1 cm and 34.4 deg off after .* rad.$"),
        (faulty.RemarksInOneText, "starts", "remarks.. returned 'no room for 3 loops', expected a tuple of texts"),
        (faulty.SinceTheLastScan, "follows", "the answer is the motion since the scan before: return start_from_base"),
        (faulty.OfTheWheels, "follows", "the answer is odom_from_base: return start_from_base"),
        (faulty.Wheels, "moves", "are the scans used"),
        (faulty.LastBeam, "first-beam", "are .1.00 of a scan's duration away"),
        (faulty.OfTheSensor, "mounting", "with the lidar turned by 90 degrees"),
        (faulty.OfOtherScans, "first-beam", "of a scan's duration away"),
        (faulty.TurnsRight, "radians", r"it has the wrong sign\?$"),
        (faulty.Mirrored, "radians", "it has the wrong sign, as in a mirror: does y point to the right"),
        (faulty.DegreesOdometry, "radians", r"2 pi: is the angle in degrees\?"),
        (faulty.MillimetresOdometry, "metres", "was returned as 600: the answer is in millimetres"),
        (faulty.Backwards, "metres", "base_from_start instead of start_from_base"),
        (faulty.NeedsHits, "no-hits", "raises ValueError"),
        (faulty.NeedsHits, "no-hits-first", "raises ValueError"),
        (faulty.DividesByTime, "all-at-once", "raises ZeroDivisionError"),
        (faulty.Wheels, "without-odometry", "raises AttributeError"),
        (faulty.Wheels, "odometry-gap", "raises AttributeError"),
        (faulty.Shared, "fresh", "they share state"),
        (faulty.Shared, "deterministic", "has another answer at scan 1"),
        (faulty.WritesScans, "read-only", "it writes to a scan .*read-only.*: use a copy"),
        (faulty.Remembers, "slowdown", "us after .* calls; .*: every call costs more than the one before"),
        (faulty.LeaksScans, "memory", "one object grows by .* bytes with each scan of a standing robot"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)  # fmt: skip
def test_each_fault_breaks_the_rule_named_for_it(make, rule, said, few_calls):
    one = result_of(make, rule)
    assert one.outcome == "failed"
    assert re.search(said, one.observed), one.observed


@pytest.mark.parametrize(
    ("make", "library"), [(faulty.RawOpen3DPlane, "open3d"), (faulty.RawSmallGicpPlane, "small_gicp")]
)
def test_point_to_plane_with_vertical_normals_breaks_the_rule_moves(make, library):
    if importlib.util.find_spec(library) is None:
        pytest.skip(f"{library} is not here")
    one = result_of(make, "moves")
    assert one.outcome == "failed"
    assert "remained" in one.observed or "the guess was returned unchanged" in one.observed
    assert result_of(make, "identity").outcome == "passed"


def test_a_correct_back_end_breaks_no_rule(few_calls):
    questions = RegistrationFixture(faulty.Sound)  # asks the long questions once for all rules
    outcome = {name: check_rule(rule, questions).outcome for name, rule in registration_rules.RULES.items()}
    left = {rule for rule, one in outcome.items() if one != "passed"}
    assert left == {"process"} | with_children()  # this object has no address
    assert outcome["process"] == "not applicable"


def test_the_first_point_may_be_left_out_where_a_point_inside_is_as_well():
    """As by a method that trims the worst pairs: it may trim the first point and none of the nine asked at first."""

    class LeavesOutTwo(faulty.Sound):
        def register(self, target, source, guess):
            return super().register(target, Cloud(np.delete(source.points, (0, 7), axis=0)), guess)

    one = result_of(LeavesOutTwo, "ends")
    reason = "not every point of the source decides its answer: number 8 does not"
    assert (one.outcome, one.observed) == ("not applicable", reason)


def test_an_answer_in_degrees_is_not_taken_for_the_inverse():
    one = result_of(faulty.Degrees, "direction")
    assert one.outcome == "passed"
    assert one.observed.endswith("rad) are nearer to those of target_from_source, (0.300 m, 0.000 m, 0.3000 rad)")


def test_only_an_answer_near_that_of_the_wheels_is_asked_whether_the_scans_are_used(few_calls):
    said = result_of(faulty.Backwards, "moves").observed
    assert said.startswith("wheel odometry 20 % too long is 60 cm off at 4 m, the answer")
    assert "are the scans used" not in said


def test_an_exception_for_clouds_without_pairs_breaks_converged_and_the_answer_to_return_is_named():
    class RefusesFarClouds(faulty.Sound):
        def register(self, target, source, guess):
            if np.ptp(np.concatenate([target.points, source.points])[:, 0]) > 50.0:
                raise ValueError("no pairs")
            return super().register(target, source, guess)

    one = result_of(RefusesFarClouds, "converged")
    what = "clouds without pairs: return a Match with converged=False, because an exception ends a run"
    assert (one.outcome, one.observed) == ("failed", f"raises ValueError: no pairs; {what}")


def test_a_library_that_turns_out_missing_belongs_to_the_missing_of_the_spec():
    class Lazy(faulty.Sound):
        def register(self, target, source, guess):
            importlib.import_module("nowhere_to_be_found")

    observed = result_of(Lazy, "starts").observed
    assert observed.endswith(
        "'nowhere_to_be_found'; let `missing` of the spec say so, with the command that installs it"
    )


def test_an_exception_for_too_few_points_is_allowed_and_observed():
    class Refuses(faulty.Sound):
        def register(self, target, source, guess):
            if len(source) < 3:
                raise ValueError("too few points")
            return super().register(target, source, guess)

    one = result_of(Refuses, "empty")
    assert one.outcome == "passed"
    assert "empty source: raises ValueError: too few points" in one.observed
    assert "in a run, an exception ends the run" in one.observed


def test_an_odometry_may_skip_scans_with_no_answer(few_calls):
    questions = odometry_fixture.OdometryFixture(faulty.Seldom, role="baseline")
    results = {name: check_rule(rule, questions) for name, rule in odometry_rules.RULES.items()}
    broken = {name: one.observed for name, one in results.items() if one.outcome == "failed"}
    assert set(broken) == {"without-odometry", "odometry-gap"}  # it fails without wheel odometry


def test_a_crash_breaks_its_own_rule_and_no_other():
    checked = runner.check("faulty_backends:SEGFAULT", only=("starts", "empty", "few-points", "wall"))
    assert outcomes(checked) == {
        "starts": "passed", "empty": "failed", "few-points": "passed", "wall": "passed", "alive": "failed",
        "in-time": "passed",
    }  # fmt: skip
    crash = "the process was terminated by SIGSEGV; last output: about to read nothing"
    assert [one.observed for one in checked.broken] == [crash, f"empty: {crash}"]


def test_a_back_end_that_ends_the_process_is_caught():
    checked = runner.check("faulty_backends:EXITS", only=("few-points",))
    assert checked.broken[0].observed == "the process exited with code 3"


@pytest.mark.parametrize(
    ("fault", "step"),
    [
        (
            "WRITES_THROUGH_POINTER",
            "a call whose clouds are read-only: does it write to them, or keep those of an earlier",
        ),
        ("READS_BEHIND", "a call with no memory behind its clouds: does it access what is behind them"),
    ],
)
def test_a_crash_beside_protected_memory_says_in_which_call_it_was(fault, step):
    checked = runner.check(f"faulty_backends:{fault}", only=("bounds",))
    assert checked.broken[0].observed.startswith("the process was terminated by SIG")
    assert f", in {step}" in checked.broken[0].observed


def test_a_hang_is_terminated_and_breaks_the_rule_in_time():
    checked = runner.check("faulty_backends:HANGS", only=("wall", "inliers"), limit_s=6.0)
    assert outcomes(checked) == {"wall": "failed", "inliers": "passed", "alive": "passed", "in-time": "failed"}
    assert checked.broken[1].observed == "wall: no answer for 6 s"


class Watched:
    """A child process of which a usage is known after each 0.8 s; ``notes``: of how many it has noted its progress."""

    def __init__(self, folder, notes):
        self._results, self._notes = folder / runner.RESULTS, notes

    def watch(self):
        for number in range(8):
            if number < self._notes:
                with self._results.open("a") as file:
                    file.write(json.dumps({"begun": "large"}) + "\n")
            yield Usage(0.8 * number, 0.8 * number, 0)


@pytest.mark.parametrize(("notes", "ended"), [(8, (False, "")), (2, (True, "no answer for 1 s"))])
def test_the_limit_of_a_rule_of_several_long_calls_counts_for_each(tmp_path, notes, ended):
    """Eight calls of 0.8 s with a limit of 1 s."""
    watching = runner._RuleRunner({}, {}, 1.0, 2048, lambda _: None)
    assert watching._watch(Watched(tmp_path, notes), tmp_path) == ended


def test_a_rule_of_several_long_calls_notes_its_progress_before_each(monkeypatch):
    monkeypatch.setattr(range_rules, "LARGE", 500)
    done = []

    class Noted(faulty.Sound):
        def register(self, target, source, guess):
            done.append("call")
            return super().register(target, source, guess)

    fixture = RegistrationFixture(Noted)
    fixture.note_progress = partial(done.append, "note")
    assert check_rule(registration_rules.RULES["large"], fixture).outcome == "passed"
    assert done == 8 * ["note", "call"]


def test_a_back_end_that_exhausts_the_memory_is_terminated():
    checked = runner.check("faulty_backends:HOGS", only=("empty",), memory_mib=300)
    assert checked.broken[0].observed == "used more than 300 MiB"


@pytest.mark.thorough  # tests/planted/test_planted.py finds a leak in a process of its own in less time
def test_a_leak_is_detected_in_a_separate_process():
    checked = runner.check("faulty_backends:LEAKS", only=("memory",))
    assert outcomes(checked)["memory"] == "failed"


def test_calls_of_a_slow_program_are_counted_by_elapsed_time_because_they_cost_this_process_none(monkeypatch):
    monkeypatch.setattr(endurance, "PROGRAM_BUDGET_S", 0.1)
    programs = []

    def start():
        programs.append(subprocess.Popen(["sleep", "60"]))

    try:
        found = endurance.measure_resource_use(start, lambda _: partial(time.sleep, 0.005), process_state.StateWatch())
    finally:
        for one in programs:
            one.kill()
            one.wait()
    assert found.size * endurance.BATCHES == 40  # the fewest: 0.1 s are 20 calls of 5 ms; by CPU time thousands


def test_a_rule_that_takes_long_is_reported_while_it_runs(monkeypatch):
    monkeypatch.setattr(runner, "SLOW_S", 0.0)
    slow = []
    runner.check("faulty_backends:SOUND", only=("starts", "later"), report_slow=slow.append)
    assert slow[-1] == "later"  # it waits three seconds
    monkeypatch.setattr(runner, "SLOW_S", 60.0)
    runner.check("faulty_backends:SOUND", only=("starts",), report_slow=slow.append)
    assert slow[-1] == "later"


def test_a_back_end_that_does_not_start_is_not_checked_further():
    for name, said in (("RAISES", "licence"), ("MATRIX", "ndarray"), ("ALWAYS_SEGFAULT", "SIGSEGV")):
        checked = runner.check(f"faulty_backends:{name}", only=("starts", "wall", "order"))
        assert said in checked.results[0].observed
        assert [one.observed for one in checked.results[1:3]] == ["it does not start"] * 2
        crashed = name == "ALWAYS_SEGFAULT"
        assert [one.outcome for one in checked.results[3:]] == [
            "failed" if crashed else "not judged",
            "not judged",
        ]


def test_a_file_that_is_no_library_has_no_rules(tmp_path):
    file = tmp_path / "x.o"
    file.write_bytes(b"no library")
    with pytest.raises(BackendFailed, match=r"x\.o: cannot be checked here; x\.o is no"):
        runner.check(f"lib:{file}", only=("wall",))


def test_after_three_ended_processes_the_other_rules_are_skipped():
    checked = runner.check("faulty_backends:ALWAYS_SEGFAULT", only=("identity", "recovers", "metres", "wall"))
    assert outcomes(checked) | {"alive": "", "in-time": ""} == {
        "identity": "failed", "recovers": "failed", "metres": "failed", "wall": "not judged", "alive": "",
        "in-time": "",
    }  # fmt: skip
    reason = next(one.observed for one in checked.results if one.rule == "wall")
    assert reason == "its process had ended 3 times"


PROGRAM = """
import json, sys, time
def say(**answer): print(json.dumps(answer), flush=True)
for line in sys.stdin:
    q = json.loads(line)
    sources, targets = len(q.get("source", ())) // 2, len(q.get("target", ())) // 2
    if q["ask"] == "hello": say(protocol=1, kind="registration", summary="the guess", device=DEVICE, parameters=[])
    elif q["ask"] == "create": say()
    elif FAULT
    else: say(pose=q["guess"], converged=False, iterations=0, error_m=None, inliers=sources)
"""


@pytest.fixture
def check_program(tmp_path):
    """Check rules on a program that returns the guess except where the given fault applies."""

    def check(fault, *only, device="", **parameters):
        file = tmp_path / "program.py"
        file.write_text(PROGRAM.replace("FAULT", fault).replace("DEVICE", repr(device)), encoding="utf-8")
        return runner.check(f"exec:{sys.executable} -I -S {file}", parameters, only=only)

    return check


IN_THIS_PROCESS = ("read-only", "floating-point", "signals", "locale", "folder", "bounds")
ON_THIS_MACHINE = ("memory", "slowdown", "open-files", "threads")


@pytest.mark.parametrize(
    ("device", "judged", "unknown"),
    [("", ON_THIS_MACHINE, IN_THIS_PROCESS), ("a board", (), IN_THIS_PROCESS + ON_THIS_MACHINE)],
)
def test_what_does_not_show_here_is_not_judged_of_a_program_and_of_a_device(check_program, device, judged, unknown):
    checked = check_program("False: pass", *IN_THIS_PROCESS, *ON_THIS_MACHINE, device=device)
    found = outcomes(checked)
    assert {name for name in found if found[name] == "not applicable"} == set(unknown)
    assert all(found[name] == "passed" for name in judged)


def test_a_program_that_refuses_large_clouds_fails_the_rules_that_ask_for_them_alone(check_program):
    refuses = "targets > 1024: say(failed=f'{targets} points, at most 1024 fit')"
    checked = check_program(refuses, "moves", "order", "wall", "few-points", "converged", "inliers", "call-order")
    assert outcomes(checked) == {
        "moves": "failed", "order": "failed", "wall": "passed", "few-points": "passed", "converged": "failed",
        "inliers": "passed", "call-order": "passed", "alive": "passed", "in-time": "passed",
    }  # fmt: skip
    assert all("reports a failure: 1200 points, at most 1024 fit" in one.observed for one in checked.broken)


@pytest.mark.parametrize(
    ("fault", "breaks", "said"),
    [
        ("sources == 2: time.sleep(120)", "in-time", "two points: raises BackendLate: .* no answer within 5 s"),
        ("sources == 2: sys.exit(3)", "alive", "two points: raises BackendEnded: .* ended with code 3 instead of"),
    ],
)
def test_a_program_that_hangs_or_ends_has_not_refused_a_question(check_program, fault, breaks, said):
    checked = check_program(fault, "few-points", "wall", "inliers", answer_timeout_s=5.0)
    passed = dict.fromkeys(("wall", "inliers", "alive", "in-time"), "passed")
    assert outcomes(checked) == {**passed, "few-points": "failed", breaks: "failed"}
    assert all(re.search(said, one.observed) for one in checked.broken)


def test_a_program_that_does_not_start_again_is_said_to_end_not_to_break_the_next_rule(check_program, tmp_path):
    gone = tmp_path / "gone"
    ends = f"""sources == 2: open({str(gone)!r}, "w"); sys.exit(3)
    elif __import__("os").path.exists({str(gone)!r}): sys.exit(4)"""
    checked = check_program(ends, "few-points", "wall")
    assert outcomes(checked) == {"few-points": "failed", "wall": "failed", "alive": "failed", "in-time": "passed"}
    wall = next(one for one in checked.broken if one.rule == "wall")
    assert "ended with code 4" in wall.observed


def test_a_program_with_an_invalid_answer_is_started_again_for_the_next_rule(check_program):
    """The noisy scene has 1200 targets. The program is ended for it; that end is not held against it."""
    wrong = """targets == 1200: print('{"pose":[nan,0,0],"converged":false}', flush=True)"""
    checked = check_program(wrong, "order", "inliers", "stateless", "wall")
    passed = dict.fromkeys(("inliers", "wall", "alive", "in-time"), "passed")
    assert outcomes(checked) == {**passed, "order": "failed", "stateless": "failed"}
    assert all("the answer has nan in 'pose': JSON has no such number" in one.observed for one in checked.broken)


def test_a_missing_back_end_raises_not_installed():
    with pytest.raises(NotInstalled, match="pip install nothing"):
        runner.check("faulty_backends:MISSING")
    with pytest.raises(NotInstalled, match=r"no libabsent\.so.*install libabsent"):
        runner.check("faulty_backends:ABSENT", only=("starts",))


def test_wrong_names_and_values_are_rejected_before_anything_runs():
    with pytest.raises(UnknownName, match="wheel-odometry"):
        runner.check("wheel-odometri")
    with pytest.raises(UnknownName, match=r"no rule named 'wal' \(did you mean 'wall'"):
        runner.check("faulty_backends:SOUND", only=("wal",))
    with pytest.raises(BadParameter, match="stop"):
        runner.check("faulty_backends:PARAMETERISED", {"stop": 0})
    with pytest.raises(NotInstalled, match="no_such_module"):
        runner.check("no_such_module:SPEC")
    with pytest.raises(NotInstalled, match="is a int, expected a BackendSpec"):
        runner.check("faulty_backends:NO_SPEC")


def test_parameters_are_passed_to_the_back_end():
    for stop, outcome in ((1, "passed"), (13, "failed")):
        checked = runner.check("faulty_backends:PARAMETERISED", {"stop": stop}, only=("starts",))
        assert outcomes(checked)["starts"] == outcome


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("SOUND", "--rule", "wall"), 0, "faulty_backends:SOUND passes every level that was run (rules)"),
        (("PARAMETERISED", "--rule", "starts", "--set", "stop=13"), 1, "2 of 3 rules broken"),
        (("PARAMETERISED", "--only", "rules", "--set", "stop=x"), 2, "parameter 'stop': found 'x', expected"),
        (("MISSING", "--only", "rules"), 2, "cannot be checked here; not installed: pip install nothing"),
        (("SOUND", "--rule", "wal"), 2, "no rule named 'wal'"),
    ],
)
def test_the_exit_code_is_0_for_no_broken_rule_1_for_a_broken_one_and_2_for_usage(evalkit, words, code, said):
    ended, shown = evalkit("validate", f"faulty_backends:{words[0]}", *words[1:])
    assert ended == code
    assert said in shown


def test_the_command_prints_the_results_of_rules_as_json(evalkit):
    _, shown = evalkit("validate", "wheel-odometry", "--rule", "moves", "--json")
    answer = json.loads(shown)
    assert (answer["subject"], answer["reference"]) == ("wheel-odometry", "")
    check = answer["levels"][0]["checks"][1]
    assert check["name"] == "rule moves"
    assert check["outcome"] == "not applicable"
    assert check["observed"] == "its role is 'baseline': it does not use the scans"
    assert check["detail"] == "It corrects wheel odometry that is 20 % too long."


def test_the_rules_of_a_data_set_are_checked_by_name_and_as_a_module(evalkit):
    code, shown = evalkit("validate", "room", "--frames", "3", "--set", "laps=0.1", "--json")
    answer = json.loads(shown)
    assert (code, answer["subject"], answer["levels"][0]["checks"][0]["observed"]) == (
        0,
        "room",
        "0 of 11 rules broken",
    )
    code, shown = evalkit("validate", "faulty_datasets:SOUND", "--only", "rules")
    assert code == 0
    code, shown = evalkit("validate", "room", "--only", "lockstep")
    assert code == 2
    assert "'room' is a data set" in shown


@pytest.fixture
def evalkit(monkeypatch, capsys, tmp_path):
    """Return ``evalkit(*words)``, which runs a command and returns its exit code and output."""
    monkeypatch.setattr(signal, "signal", lambda *_handler: None)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["evalkit", *words])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr()
        return ended.value.code, said.out + said.err

    return call


@pytest.mark.parametrize("name", ["poses.tum", "map.yaml"])
def test_a_trajectory_file_has_no_behaviour_to_check(name, tmp_path):
    (tmp_path / name).write_text("")
    with pytest.raises(BackendFailed, match=r"no behaviour to check; compare it with the truth .*evalkit compare"):
        runner.check(f"file:{tmp_path / name}")
