"""What a package of somebody else calls in its own tests: one error with every broken rule, each with its reason."""

import importlib
import pickle
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from evalkit.commands.validate.rules import dataset_rules
from evalkit.commands.validate.rules.rule import Verdict, verdict
from evalkit.core.errors import BadParameter, DataMissing, NotInstalled
from evalkit.core.match import Match
from evalkit.plugins.parameters import resolve_parameters
from evalkit.plugins.specs import RegistrationSpec
from evalkit.testing import ConformanceError, check_backend, check_dataset

sys.path.append(str(Path(__file__).parent / "misfits"))  # as a package under development would be
backends = importlib.import_module("faulty_backends")
datasets = importlib.import_module("faulty_datasets")


class Perfect:
    """Answers the guess and claims everything."""

    def register(self, target, source, guess):
        return Match(guess, True, 1, 0.0, len(source))


OF_THIS_FILE = RegistrationSpec(make=Perfect, summary="", citation="", licence="MIT")


def test_a_sound_back_end_passes_whether_named_or_given():
    named = check_backend("faulty_backends:SOUND")
    assert named.broken == ()
    assert named.verdicts == replace(check_backend(backends.SOUND), label=named.label).verdicts


def test_one_error_lists_every_broken_rule_with_its_sentence_and_what_was_seen():
    with pytest.raises(ConformanceError) as caught:
        check_backend(OF_THIS_FILE)  # it stands in this file, which no other process can import by name
    said = str(caught.value)
    assert "OF_THIS_FILE breaks 3 of 22 rules" in said
    assert "  moves: A guess 5 cm and 2 degrees off is mended on noisy planar scans.\n      the guess came back" in said
    assert "  recovers: " in said
    assert "  converged: " in said
    assert "direction" not in said
    assert isinstance(caught.value, AssertionError)


def test_parameters_are_given_by_name():
    with pytest.raises(ConformanceError, match="SIGSEGV"):
        check_backend("faulty_backends:PARAMETERISED", stop=13)
    with pytest.raises(BadParameter):
        check_backend("faulty_backends:PARAMETERISED", stop="never")


def test_a_spec_without_a_name_cannot_be_followed_and_says_so():
    with pytest.raises(NotInstalled, match="has no name in any module"):
        check_backend(replace(OF_THIS_FILE, summary="another"))


def test_the_error_survives_the_way_between_processes():
    error = ConformanceError("x", (Verdict("order", "It holds.", "failed", "it does not"),), 22)
    assert (
        str(pickle.loads(pickle.dumps(error)))
        == str(error)
        == ("x breaks 1 of 22 rules\n  order: It holds.\n      it does not")
    )


@pytest.mark.parametrize(
    ("make", "rule", "said"),
    [
        (datasets.Refuses, "parameters", "make() refuses its own parameters"),
        (datasets.Empty, "opens", "there is no frame"),
        (datasets.Blind, "opens", "no beam of 8 frames met anything"),
        (datasets.Once, "again", "frames() called again gives 0 frames instead of 8"),
        (datasets.Unseeded, "again", "frames() called again gives another frame 1"),
        (datasets.DeafToSeeds, "seeds", "seeds 0 and 1 give the same frames"),
        (datasets.Backwards, "stamps", "frame 2 is stamped -1 ns, the one before 0 ns"),
        (datasets.Boastful, "length", "len() says 100, 8 frames came when 50 were asked for"),
        (datasets.Patchy, "odometry", "1 of 8 frames have start_from_end but no odom_from_base"),
        (datasets.Loose, "mounting", "base_from_sensor changes: 8 different ones in 8 frames"),
        (datasets.OtherClock, "truth", "the true trajectory reaches 0 % of the frames: are both on the same clock?"),
        (datasets.Words, "notes", "notes() has 'scans out of order': 'many', expected a name and a count"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_each_fault_of_a_data_set_is_caught_by_the_rule_named_for_it(make, rule, said):
    spec = datasets.spec(make)
    one = verdict(dataset_rules.RULES[rule], dataset_rules.Bench(spec, resolve_parameters("", spec.parameters, {}), 50))
    assert one.outcome == "failed"
    assert one.observed.startswith(said)


def test_a_sound_data_set_passes_and_takes_parameters():
    assert check_dataset("faulty_datasets:SOUND", scans=5).broken == ()
    assert check_dataset(datasets.SOUND, frames=3).broken == ()


def test_a_shipped_data_set_keeps_every_rule():
    assert check_dataset("room", frames=3).broken == ()


def test_data_that_are_not_here_are_said_to_be_missing():
    with pytest.raises(DataMissing, match="get it from somewhere"):
        check_dataset(datasets.MISSING)
