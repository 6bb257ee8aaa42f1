"""The rules for back ends: the shipped ones keep them, and every fault is caught by the rule named for it."""

import importlib
import importlib.util
import json
import re
import signal
import sys
from pathlib import Path

import pytest

from evalkit import cli
from evalkit.commands.validate.rules import odometry_rules, registration_rules
from evalkit.commands.validate.rules import runner as conformance
from evalkit.commands.validate.rules.rule import verdict
from evalkit.core.errors import BackendFailed, BadParameter, NotInstalled, UnknownName
from evalkit.plugins import registry

sys.path.append(str(Path(__file__).parents[3] / "misfits"))  # as a package under development would be
faulty = importlib.import_module("faulty_backends")


def found(make, rule, **bench):
    """What one rule finds, in this process."""
    if hasattr(make, "register"):
        return verdict(registration_rules.RULES[rule], registration_rules.Bench(make))
    return verdict(odometry_rules.RULES[rule], odometry_rules.Bench(make, **bench))


def outcomes(checked):
    return {one.rule: one.outcome for one in checked.verdicts}


@pytest.mark.parametrize("name", registry.names("backends"))
def test_every_shipped_back_end_keeps_every_rule(name):
    if why := registry.backend(name).missing():
        pytest.skip(why)
    checked = conformance.check(name)
    assert [f"{one.rule}: {one.observed}" for one in checked.broken] == []
    excused = {one.rule for one in checked.verdicts if one.outcome == "not applicable"}
    assert excused == ({"moves", "without-odometry"} if name == "wheel-odometry" else set())


@pytest.mark.parametrize(
    ("make", "rule", "said"),
    [
        (faulty.Guess, "moves", "the guess came back unchanged, 19 cm off half a room away"),
        (faulty.Guess, "recovers", "22.4 mm|36.1 mm"),
        (faulty.Identity, "metres", "0.3 m came back as 0"),
        (faulty.Identity, "equivariance", "from the answer moved with the target"),
        (faulty.IgnoresTheGuess, "equivariance", "from the answer moved with the target"),
        (faulty.Inverse, "direction", "is source_from_target"),
        (faulty.Degrees, "radians", "these are 17.2 degrees, taken for radians"),
        (faulty.Clockwise, "radians", "it has the wrong sign"),
        (faulty.Millimetres, "metres", "0.3 m came back as 300: the answer is in millimetres"),
        (faulty.Biased, "identity", r"30.0 mm and 0.00 deg from the identity"),
        (faulty.Biased, "inverse", "from the inverse"),
        (faulty.ByIndex, "order", "from the answer in the first order"),
        (faulty.Halves, "duplicates", "from the answer with every point once"),
        (faulty.Stateful, "stateless", "has another answer after other questions"),
        (faulty.Random, "deterministic", "has another answer of a fresh object"),
        (faulty.WritesPolitely, "read-only", "it tries to write into a cloud's points .*read-only.*: work on a copy"),
        (faulty.WritesRudely, "read-only", "are not the same after the call"),
        (faulty.Liar, "converged", "says converged on 0 pairs, and is 100 m wrong"),
        (faulty.NoPairs, "inliers", "inliers 0; where there are few, evalkit's front end keeps its guess"),
        (faulty.Unbounded, "wall", "flies off"),
        (faulty.Nan, "few-points", "one point: target_from_source is None"),
        (faulty.Matrix, "starts", "register.. answers a ndarray"),
        (faulty.Raises, "recovers", "raises RuntimeError: the licence has run out"),
        (faulty.Leaks, "memory", "kB more per call, at most 100 kB"),
        (faulty.StartsElsewhere, "first", "the first answer is .10.000 m, -5.000 m, 1.0000 rad"),
        (faulty.Stands, "follows", "with true wheel odometry: 59.1 cm and 34.4 deg off"),
        (faulty.Wheels, "moves", "is the scan looked at"),
        (faulty.LastBeam, "first-beam", "are .1.00 of a scan's duration away"),
        (faulty.OfTheSensor, "mounting", "with the lidar turned by 90 degrees"),
        (faulty.OfOtherScans, "first-beam", "of a scan's duration away"),
        (faulty.TurnsRight, "radians", "it has the wrong sign"),
        (faulty.DegreesOdometry, "radians", "taken for radians"),
        (faulty.MillimetresOdometry, "metres", "came back as 600: the answer is in millimetres"),
        (faulty.Backwards, "metres", "base_from_start instead of start_from_base"),
        (faulty.NeedsHits, "no-hits", "raises ValueError"),
        (faulty.NeedsHits, "no-hits-first", "raises ValueError"),
        (faulty.DividesByTime, "all-at-once", "raises ZeroDivisionError"),
        (faulty.Wheels, "without-odometry", "raises AttributeError"),
        (faulty.Wheels, "odometry-gap", "raises AttributeError"),
        (faulty.Shared, "fresh", "they share state"),
        (faulty.Shared, "deterministic", "has another answer at scan 1"),
        (faulty.WritesScans, "read-only", "it tries to write into a scan .*read-only.*: work on a copy"),
        (faulty.LeaksScans, "memory", "kB more per call"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)  # fmt: skip
def test_each_fault_is_caught_by_the_rule_named_for_it(make, rule, said):
    one = found(make, rule)
    assert one.outcome == "failed"
    assert re.search(said, one.observed), one.observed


@pytest.mark.parametrize(
    ("make", "library"), [(faulty.RawOpen3DPlane, "open3d"), (faulty.RawSmallGicpPlane, "small_gicp")]
)
def test_a_point_to_plane_that_z_0_has_made_blind_is_caught_because_it_does_not_move(make, library):
    if importlib.util.find_spec(library) is None:
        pytest.skip(f"{library} is not here")
    one = found(make, "moves")
    assert one.outcome == "failed"
    assert "were left" in one.observed or "the guess came back unchanged" in one.observed
    assert found(make, "identity").outcome == "passed"


def test_a_sound_back_end_breaks_nothing():
    broken = [rule for rule in registration_rules.RULES if found(faulty.Sound, rule).outcome != "passed"]
    assert broken == []


def test_an_exception_for_too_little_is_allowed_but_told():
    class Refuses(faulty.Sound):
        def register(self, target, source, guess):
            if len(source) < 3:
                raise ValueError("too few points")
            return super().register(target, source, guess)

    one = found(Refuses, "empty")
    assert one.outcome == "passed"
    assert "empty source: raises ValueError: too few points" in one.observed
    assert "an exception ends a run that meets this" in one.observed


def test_an_odometry_may_leave_out_scans_if_it_says_so():
    broken = {rule: one.observed for rule in odometry_rules.RULES
              if (one := found(faulty.Seldom, rule, role="baseline")).outcome == "failed"}  # fmt: skip
    assert set(broken) == {"without-odometry", "odometry-gap"}  # it falls over where the wheels do


def test_a_crash_costs_its_own_question_and_no_other():
    checked = conformance.check("faulty_backends:SEGFAULT", only=("starts", "empty", "few-points", "wall"))
    assert outcomes(checked) == {
        "starts": "passed", "empty": "failed", "few-points": "passed", "wall": "passed", "alive": "failed",
        "in-time": "passed",
    }  # fmt: skip
    crash = "the process was ended by SIGSEGV; it said last: about to read nothing"
    assert [one.observed for one in checked.broken] == [crash, f"empty: {crash}"]


def test_a_back_end_that_ends_the_process_is_caught():
    checked = conformance.check("faulty_backends:EXITS", only=("few-points",))
    assert checked.broken[0].observed == "the process ended itself with code 3"


def test_a_hang_is_ended_and_named():
    checked = conformance.check("faulty_backends:HANGS", only=("wall", "inliers"), limit_s=3.0)
    assert outcomes(checked) == {"wall": "failed", "inliers": "passed", "alive": "passed", "in-time": "failed"}
    assert checked.broken[1].observed == "wall: no answer for 3 s"


def test_a_back_end_that_takes_all_memory_is_ended():
    checked = conformance.check("faulty_backends:HOGS", only=("empty",), memory_mib=300)
    assert checked.broken[0].observed == "used more than 300 MiB"


def test_a_leak_is_seen_from_a_process_of_its_own():
    checked = conformance.check("faulty_backends:LEAKS", only=("memory",))
    assert outcomes(checked)["memory"] == "failed"


def test_nothing_more_is_asked_of_what_does_not_start():
    for name, said in (("RAISES", "licence"), ("MATRIX", "ndarray"), ("ALWAYS_SEGFAULT", "SIGSEGV")):
        checked = conformance.check(f"faulty_backends:{name}", only=("starts", "wall", "order"))
        assert said in checked.verdicts[0].observed
        assert [one.observed for one in checked.verdicts[1:3]] == ["it does not start"] * 2


def test_after_three_ends_the_rest_is_not_asked():
    checked = conformance.check("faulty_backends:ALWAYS_SEGFAULT", only=("identity", "recovers", "metres", "wall"))
    assert outcomes(checked) | {"alive": "", "in-time": ""} == {
        "identity": "failed", "recovers": "failed", "metres": "failed", "wall": "not applicable", "alive": "",
        "in-time": "",
    }  # fmt: skip
    reason = next(one.observed for one in checked.verdicts if one.rule == "wall")
    assert reason == "given up after 3 ends of its process"


def test_what_is_absent_is_said_and_not_checked():
    with pytest.raises(NotInstalled, match="pip install nothing"):
        conformance.check("faulty_backends:MISSING")
    with pytest.raises(NotInstalled, match=r"no libabsent\.so.*install libabsent"):
        conformance.check("faulty_backends:ABSENT", only=("starts",))


def test_wrong_names_and_values_are_refused_before_anything_runs():
    with pytest.raises(UnknownName, match="wheel-odometry"):
        conformance.check("wheel-odometri")
    with pytest.raises(UnknownName, match=r"no rule named 'wal' \(did you mean 'wall'"):
        conformance.check("faulty_backends:SOUND", only=("wal",))
    with pytest.raises(BadParameter, match="stop"):
        conformance.check("faulty_backends:PARAMETERISED", {"stop": 0})
    with pytest.raises(NotInstalled, match="no_such_module"):
        conformance.check("no_such_module:SPEC")
    with pytest.raises(NotInstalled, match="is a int, expected a BackendSpec"):
        conformance.check("faulty_backends:NO_SPEC")


def test_parameters_reach_the_back_end():
    for stop, outcome in ((1, "passed"), (13, "failed")):
        checked = conformance.check("faulty_backends:PARAMETERISED", {"stop": stop}, only=("starts",))
        assert outcomes(checked)["starts"] == outcome


def test_verdicts_are_told_as_they_come():
    heard = []
    checked = conformance.check("faulty_backends:WHEELS", only=("starts", "first"), heard=heard.append)
    assert tuple(heard) == checked.verdicts


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("SOUND", "--rule", "wall"), 0, "faulty_backends:SOUND: 0 of 3 rules broken"),
        (("PARAMETERISED", "--rule", "starts", "--set", "stop=13"), 1, "2 of 3 rules broken"),
        (("PARAMETERISED", "--set", "stop=x"), 2, "parameter 'stop': found 'x', expected"),
        (("MISSING",), 2, "cannot be checked here; not installed: pip install nothing"),
        (("SOUND", "--rule", "wal"), 2, "no rule named 'wal'"),
    ],
)
def test_the_command_tells_by_its_exit_code(evalkit, words, code, said):
    ended, shown = evalkit("validate", f"faulty_backends:{words[0]}", "--only", "rules", *words[1:])
    assert ended == code
    assert said in shown


def test_the_command_answers_json(evalkit):
    _, shown = evalkit("validate", "wheel-odometry", "--only", "rules", "--rule", "moves", "--json")
    answer = json.loads(shown)
    assert answer["label"] == "wheel-odometry"
    assert answer["verdicts"][0] == {
        "rule": "moves", "sentence": "It mends wheels that overstate every motion by 20 %.",
        "outcome": "not applicable", "observed": "its role is 'bar': it is what others have to beat",
    }  # fmt: skip


@pytest.fixture
def evalkit(monkeypatch, capsys):
    """``evalkit(*words)``: exit code, and what is said."""
    monkeypatch.setattr(signal, "signal", lambda *_handler: None)
    monkeypatch.setattr(sys, "path", [*sys.path])

    def call(*words):
        monkeypatch.setattr(sys, "argv", ["evalkit", *words])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr()
        return ended.value.code, said.out + said.err

    return call


@pytest.mark.parametrize("name", ["poses.tum", "map.yaml"])
def test_a_file_of_results_has_no_behaviour_to_check_and_is_told_what_can_be_done_instead(name, tmp_path):
    (tmp_path / name).write_text("")
    with pytest.raises(BackendFailed, match=r"no behaviour to check; hold it against the truth .*evalkit compare"):
        conformance.check(f"file:{tmp_path / name}")
