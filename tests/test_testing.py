"""The assertions for the tests of a plug-in: one error with every broken rule, each with its reason."""

import importlib
import pickle
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from evalkit.commands.validate.rules import dataset_rules, runner
from evalkit.commands.validate.rules import rule as rule_module
from evalkit.commands.validate.rules.rule import RuleReport, RuleResult
from evalkit.core.errors import BadParameter, DataMissing, NotInstalled, UnknownName
from evalkit.core.match import Match
from evalkit.plugins.address import Address, spec_at, stop_loading
from evalkit.plugins.parameters import resolve_parameters
from evalkit.plugins.specs import RegistrationSpec
from evalkit.testing import RulesBroken, backend_rules, check_backend, check_dataset, check_rule

pytestmark = pytest.mark.slow

sys.path.append(str(Path(__file__).parent / "misfits"))  # as a package under development would be
backends = importlib.import_module("faulty_backends")
datasets = importlib.import_module("faulty_datasets")


class Perfect:
    """Returns the guess and reports a perfect result."""

    def register(self, target, source, guess):
        return Match(guess, True, 1, 0.0, len(source))


OF_THIS_FILE = RegistrationSpec(make=Perfect, summary="", citation="", licence="MIT")


def test_a_correct_back_end_passes_by_name_and_as_a_spec(monkeypatch):
    """By two of the rules; tests/commands/validate/rules checks all of them."""
    rules = runner.RULES["registration"]
    monkeypatch.setitem(runner.RULES, "registration", {name: rules[name] for name in ("starts", "wall")})
    for given in ("faulty_backends:SOUND", backends.SOUND):
        outcomes = {one.rule: one.outcome for one in check_backend(given).results}
        assert outcomes == dict.fromkeys(("starts", "wall", "alive", "in-time"), "passed")


def test_one_error_lists_every_broken_rule_with_its_sentence_and_observation():
    with pytest.raises(RulesBroken) as caught:
        check_backend(OF_THIS_FILE)  # it is in this file, which other processes cannot import by name
    said = str(caught.value)
    assert "OF_THIS_FILE breaks 3 of 41 rules" in said
    assert (
        "  moves: A guess 5 cm and 2 degrees off is corrected on noisy planar scans.\n      the guess was returned"
        in said
    )
    assert "  recovers: " in said
    assert "  converged: " in said
    assert "direction" not in said
    assert isinstance(caught.value, AssertionError)


def test_parameters_are_given_by_name():
    with pytest.raises(RulesBroken, match="SIGSEGV"):
        check_backend("faulty_backends:PARAMETERISED", stop=13)
    with pytest.raises(BadParameter):
        check_backend("faulty_backends:PARAMETERISED", stop="never")


def test_a_spec_without_a_name_in_a_module_is_rejected():
    with pytest.raises(NotInstalled, match="has no name in any module"):
        check_backend(replace(OF_THIS_FILE, summary="another"))


@pytest.mark.parametrize(
    ("source", "remedy"),
    [("import nowhere_to_be_found", "install that; a plug-in imports its library in the code that `make` calls"),
     ("import numpy.nowhere", "install that; "), ("", "give a registered name, or module:SPEC")],
)  # fmt: skip
def test_a_module_that_lacks_a_library_says_where_to_import_it(tmp_path, monkeypatch, source, remedy):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "lacking.py").write_text(source)
    monkeypatch.delitem(sys.modules, "lacking", raising=False)
    with pytest.raises(NotInstalled, match=re.escape(f"; {remedy}")):
        spec_at(Address("lacking:SPEC", "lacking", "SPEC"), RegistrationSpec, lambda _name: None)


def test_the_error_can_be_pickled():
    error = RulesBroken("x", (RuleResult("order", "It holds.", "failed", "it does not"),), 22)
    assert (
        str(pickle.loads(pickle.dumps(error)))
        == str(error)
        == ("x breaks 1 of 22 rules\n  order: It holds.\n      it does not")
    )


def test_an_empty_data_set_breaks_one_rule_and_those_on_frames_are_not_judged():
    results = dataset_rules.check(datasets.spec(datasets.Empty), 50, {}).results
    of_outcome = {what: [one.rule for one in results if one.outcome == what] for what in ("failed", "passed")}
    assert of_outcome == {"failed": ["opens"], "passed": ["parameters", "notes"]}
    unjudged = {one.rule: one.observed for one in results if one.outcome == "not judged"}
    assert set(unjudged.values()) == {"there is no frame, see the rule opens"}
    assert {"again", "stamps", "length", "angles", "odometry", "mounting", "truth"} <= unjudged.keys()


@pytest.mark.parametrize(
    ("make", "rule", "said"),
    [
        (datasets.Refuses, "parameters", "make() rejects its declared parameters"),
        (datasets.Empty, "opens", "there is no frame"),
        (datasets.Blind, "opens", "no beam of 8 frames has a return"),
        (datasets.Once, "again", "frames() called again yields 0 frames instead of 8"),
        (datasets.Unseeded, "again", "frames() called again yields another frame 1"),
        (datasets.IgnoresSeeds, "seeds", "seeds 0 and 1 give the same frames"),
        (datasets.Backwards, "stamps", "frame 2 is stamped -1 ns, the one before 0 ns"),
        (datasets.Boastful, "length", "len() is 100, but the first 50 frames are 8"),
        (datasets.Patchy, "odometry", "1 of 8 frames have start_from_end but no odom_from_base"),
        (datasets.Degrees, "angles", "the angles of a scan span 343.8 rad: are they in degrees?"),
        (datasets.OdometryOfNumbers, "odometry", "odom_from_base is (0.0, 0.0, 0.0), expected an evalkit.Pose or None"),
        (
            datasets.TruthInMillimetres,
            "truth",
            "in the same frames the truth moves by 700 m, the odometry by 0.7 m: is",
        ),
        (datasets.Loose, "mounting", "base_from_sensor changes: 8 different values in 8 frames"),
        (datasets.OtherClock, "truth", "the true trajectory covers 0 % of the frames: are both on the same clock?"),
        (datasets.NoNotes, "notes", "notes() returns a NoneType, expected a mapping of names to counts"),
        (datasets.Words, "notes", "notes() has 'scans out of order': 'many', expected a name and a count"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_each_fault_of_a_data_set_breaks_the_rule_named_for_it(make, rule, said):
    spec = datasets.spec(make)
    one = rule_module.check_rule(
        dataset_rules.RULES[rule], dataset_rules.DatasetFixture(spec, resolve_parameters("", spec.parameters, {}), 50)
    )
    assert one.outcome == "failed"
    assert one.observed.startswith(said)


def test_a_correct_data_set_passes_and_takes_parameters():
    assert check_dataset("faulty_datasets:SOUND", scans=5).broken == ()
    assert check_dataset(datasets.SOUND, frames=3).broken == ()


def test_a_truth_that_begins_after_the_checked_frames_is_compared_with_all_frames():
    report = dataset_rules.check(datasets.spec(datasets.LateTruth), 20, {"scans": 100})
    said = {one.rule: one.observed for one in report.results}
    assert said["truth"] == "the true trajectory covers 70 % of the frames; exact"


def test_one_exception_of_a_data_set_breaks_one_rule_and_the_others_are_not_judged():
    found = dataset_rules.check(datasets.spec(datasets.Unreadable), 20, {})
    assert [(one.rule, one.observed) for one in found.broken] == [("opens", "raises ValueError: line 3")]
    unjudged = {one.rule for one in found.results if one.outcome == "not judged"}
    assert unjudged == {"again", "seeds", "stamps", "length", "angles", "odometry", "mounting", "truth"}


def test_a_shipped_data_set_follows_every_rule():
    assert check_dataset("room", frames=3).broken == ()


def test_missing_data_raise_an_error():
    with pytest.raises(DataMissing, match="get it from somewhere"):
        check_dataset(datasets.MISSING)


SCRIPT = """
from evalkit.core.match import Match
from evalkit.plugins.specs import RegistrationSpec
from evalkit.testing import RulesBroken, check_backend

class Guess:
    def register(self, target, source, guess):
        return Match(guess, True, 1, 0.0, len(source))

SPEC = RegistrationSpec(make=Guess, summary="", citation="", licence="MIT")
try:
    check_backend(SPEC)
except RulesBroken as error:
    print(error)
"""


@pytest.mark.thorough
def test_a_script_without_a_main_guard_checks_its_own_spec(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(SCRIPT)
    done = subprocess.run([sys.executable, str(file)], capture_output=True, text=True, timeout=600, check=True)
    assert re.search("__main__:SPEC breaks [1-9] of 41 rules", done.stdout), done.stdout + done.stderr
    assert "the guess was returned unchanged" in done.stdout


SESSION = """
from evalkit.testing import NotEquivalent, assert_equivalent, backend_rules, check_rule

print([one for one in backend_rules(SPEC) if one in ("order", "in-time")])
print(check_rule(SPEC, "order").outcome, check_rule(SPEC, "in-time").observed)
try:
    check_rule(SPEC, "moves")
except RulesBroken as error:
    print(error)
try:
    assert_equivalent("paper", SPEC, scans=3)
except NotEquivalent as error:
    print(error)
"""


def test_an_interactive_session_checks_its_own_spec():
    code = SCRIPT.partition("try:")[0] + SESSION  # a module __main__ without a file, as in IPython
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=False)
    assert done.stderr == ""
    assert done.stdout.startswith("['order', 'in-time']\npassed checked in this process: another one cannot load")
    assert "__main__:SPEC breaks 1 of 1 rules\n  moves: " in done.stdout
    assert "A = paper, B = __main__:SPEC: not equivalent on " in done.stdout
    assert "answer: different: the guess is returned as the answer" in done.stdout


LOOP = """
from evalkit.core.errors import NotInstalled

class Other(Guess):
    pass

for make in (Guess, Other):
    spec = RegistrationSpec(make=make, summary=make.__name__, citation="", licence="MIT")
    try:
        check_backend(spec)
    except (RulesBroken, NotInstalled) as error:
        print(str(error).splitlines()[0])
"""


@pytest.mark.thorough
def test_a_name_for_several_specs_of_a_script_checks_no_other_spec_than_the_given_one(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(SCRIPT.partition("SPEC =")[0] + LOOP)
    done = subprocess.run([sys.executable, str(file)], capture_output=True, text=True, timeout=600, check=True)
    first, second = done.stdout.splitlines()
    assert first.startswith("__main__:spec breaks")
    assert second.startswith(
        "__main__:spec: is 'Guess' of Guess() when its module is loaded by another process, and was"
    )


def test_an_address_of_a_spec_is_not_that_of_another_one_under_its_name(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(SCRIPT)
    given = Address("x", "__main__", "SPEC", str(file), "'mine' of Mine()")
    with pytest.raises(
        NotInstalled, match=r"^x: is '' of Guess\(\) when .*, and was given as 'mine' of Mine\(\); give"
    ):
        spec_at(given, RegistrationSpec, lambda _name: None)
    assert spec_at(replace(given, holds="'' of Guess()"), RegistrationSpec, lambda _name: None).licence == "MIT"


def test_data_sets_are_checked_as_they_are_given_without_a_name():
    for change, broken in (({}, set()), ({"make": datasets.Boastful}, {"length"})):
        spec = replace(datasets.SOUND, summary="another", **change)
        found = dataset_rules.check(spec, 50, {})
        assert ({one.rule for one in found.broken}, found.label) == (broken, "this data set")


def test_loading_a_file_stops_at_its_own_check(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(SCRIPT)
    found = spec_at(Address("x", "__main__", "SPEC", str(file)), RegistrationSpec, lambda _name: None)
    assert found.licence == "MIT"
    stop_loading()  # nothing is being loaded now


def test_one_rule_at_a_time_for_parametrised_tests(monkeypatch):
    checked = []
    report = RuleReport("x", (RuleResult("order", "", "failed", "no"), RuleResult("wall", "", "passed", "yes")))
    monkeypatch.setattr("evalkit.testing.runner.check", lambda *given: checked.append(given) or report)
    assert {"order", "wall", "alive"} <= set(backend_rules("paper"))
    assert check_rule("paper", "wall", epsilon=0.5).observed == "yes"
    with pytest.raises(RulesBroken, match="order"):
        check_rule("paper", "order", epsilon=0.5)
    assert checked == [("paper", {"epsilon": 0.5})]  # both from one check
    assert str(report) == "x: 1 rules passed, 0 not applicable, 1 broken\n  order: \n      no"
    with pytest.raises(UnknownName, match="did you mean 'wall'"):
        check_rule("paper", "walls", epsilon=0.5)
