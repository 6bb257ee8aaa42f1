"""Injected faults of registrations and odometries are detected and named; equal implementations are equivalent."""

import importlib
import json
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evalkit.cli import app
from evalkit.commands.validate.equivalence.comparison import NotEquivalent, assert_equivalent, equivalence
from evalkit.commands.validate.equivalence.divergence import first_divergence
from evalkit.commands.validate.equivalence.lockstep import Question, answer
from evalkit.commands.validate.equivalence.margins import Margin
from evalkit.commands.validate.rules.scenes import drive
from evalkit.core import se2
from evalkit.core.errors import BackendFailed, EvalkitError, UnknownName
from evalkit.core.ground_truth import Truth
from evalkit.core.match import Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame
from evalkit.plugins import defaults, registry
from evalkit.plugins.protocols import NoAnswer
from evalkit.plugins.specs import BackendSpec, DatasetSpec, OdometrySpec
from evalkit_baselines import open3d_icp, paper
from evalkit_baselines.paper import icp
from evalkit_baselines.paper.icp import Icp

sys.path.append(str(Path(__file__).parents[3] / "misfits"))
answer_faults, injected = map(importlib.import_module, ("answer_faults", "injected_faults"))

TIGHT = {"epsilon": 1e-10, "max_iterations": 200}
FEW = 6


class Drive:
    """The drive through the L-shaped room of the rules, as a sequence."""

    def __init__(self, change: Callable[[Frame], Frame] = lambda frame: frame) -> None:
        self._frames = [change(frame) for frame in drive(scans=12).frames]

    def __len__(self) -> int:
        return len(self._frames)

    def frames(self) -> Iterator[Frame]:
        return iter(self._frames)

    def truth(self) -> Truth:
        return Truth("unknown")

    def notes(self) -> dict[str, int]:
        return {}


def sequence(change: Callable[[Frame], Frame] = lambda frame: frame) -> DatasetSpec:
    return DatasetSpec(lambda: Drive(change), "a drive", "", "", "", "MIT")


ROOM = sequence()


def with_fault(make: Callable[..., object], spec: BackendSpec = paper.SPEC) -> BackendSpec:
    return replace(spec, make=make)


class WrongCentroid(Icp):
    def _step(self, source, target, normals, share):
        x, y, theta = super()._step(source, target, normals, share)
        x, y = icp._centroid(target) - icp._centroid(source)
        return np.array([x, y, theta])


class Backwards(Icp):
    def _step(self, source, target, normals, share):
        return se2.inverse(super()._step(source, target, normals, share))


class GuessInDegrees(Icp):
    def register(self, target, source, guess):
        return super().register(target, source, Pose(guess.x, guess.y, math.radians(guess.theta)))


class WrongSign(answer_faults.Clockwise, Icp): ...


class Inverse(answer_faults.Inverse, Icp): ...


class Exchanged(Icp):
    def register(self, target, source, guess):
        return super().register(source, target, guess)


class OneMore(Icp):
    def register(self, target, source, guess):
        match = super().register(target, source, guess)
        more = replace(self, epsilon=0.0, max_iterations=match.iterations + 1)
        return replace(Icp.register(more, target, source, guess), converged=match.converged)


class OneFewer(Icp):
    def register(self, target, source, guess):
        match = super().register(target, source, guess)
        last = match.history[-2]
        return Match(last.target_from_source, True, match.iterations - 1, last.error, last.inliers, match.history[:-1])


class Raises(Icp):
    def register(self, target, source, guess):
        raise ZeroDivisionError("no pairs")


class Untraced:
    def __init__(self, registration: Icp) -> None:
        self._registration = registration

    def register(self, target, source, guess):
        return replace(self._registration.register(target, source, guess), history=())


class Fixed:
    def __init__(self, match: Match) -> None:
        self._match = match

    def register(self, target, source, guess):
        return self._match


class Alternating:
    """A registration that is off by one millimetre, alternately in both directions."""

    def __init__(self, made: Iterator[int]) -> None:
        self._made, self._icp = made, Icp()

    def register(self, target, source, guess):
        match = self._icp.register(target, source, guess)
        off = Pose(1e-3 if (next(self._made) // 2) % 2 else -1e-3, 0.0, 0.0)
        return replace(match, target_from_source=match.target_from_source @ off)


class TiesToTheHigher(Icp):
    def _pairs(self, association, moved, target, *_views):
        nearest, distance = association.find(moved)
        at = np.flatnonzero(np.isfinite(distance))[::-1]
        at = np.sort(at[icp.select_closest(nearest[at], distance[at], len(target))])
        return at, nearest[at]


def validate_lockstep(folder, *words: str) -> int:
    try:
        app(["validate", *words, "--only", "lockstep", "--out", str(folder)], standalone_mode=True)
    except SystemExit as end:
        return int(end.code or 0)
    except EvalkitError:  # main() turns it into exit code 2
        return 2
    return 0


def option(**options: object) -> Callable[..., Icp]:
    return lambda **given: Icp(**{**given, **options})


def test_a_registration_is_equal_to_itself_in_every_pair_of_every_iteration():
    found = equivalence("paper", "paper", ROOM, scans=FEW)
    assert found.equivalent
    assert (found.first, dict(found.classes), found.unanswered) == (None, {}, 0)
    assert (found.level, found.n, found.questions) == ("pairs of every iteration", 5, 15)
    assert all(abs(one.worst) < 1e-15 for one in found.intervals)


NEAR = {"max_correspondence_m": 0.2}

FAULTS = {
    "transposed rotation": (injected.Transposed, {}, "different pose", "rotation is transposed"),
    "translation without rotation": (WrongCentroid, {}, "different pose", "translation leaves out the rotation"),
    "inverted step": (Backwards, {}, "different pose", "step is inverted"),
    "guess read as degrees": (GuessInDegrees, {}, "units pairs", "guess's angle is interpreted as degrees"),
    "answer in degrees": (injected.Degrees, {}, "units answer", "angle is in degrees"),
    "sign of the angle": (WrongSign, {}, "sign answer", "angle has the wrong sign"),
    "inverse answer": (Inverse, {}, "different answer", "inverse"),
    "exchanged clouds": (Exchanged, {}, "different pairs", "target and source are exchanged"),
    "rounded to float32": (injected.Rounded, {}, "precision pose", "within rounding to float32"),
    "one iteration more": (OneMore, {}, "stop rule iterations", "A stops after"),
    "one iteration fewer": (OneFewer, {}, "stop rule iterations", "B stops after"),
    "fewer iterations allowed": (option(max_iterations=2), TIGHT, "iteration cap iterations", "B ends unconverged"),
    "no one-to-one filter": (option(one_to_one=False), {}, "outlier rule pairs", "one-to-one filter: B"),
    "twice the distance": (option(max_correspondence_m=0.4), NEAR, "outlier rule pairs", "maximum distance"),
    "mean squared": (option(error="mean-squared"), {}, "cost cost", "B the root mean square distance after the step"),
    "error before": (option(error_at="before"), {}, "cost cost", "B the mean distance before the step"),
    "no answer": (Raises, {}, "different answer", "B raises ZeroDivisionError: no pairs"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_an_injected_fault_is_detected_and_named(name):
    make, parameters, found_as, words = FAULTS[name]
    found = equivalence("paper", with_fault(make), ROOM, set_a=parameters, set_b=parameters, scans=4)
    assert found.first is not None
    assert f"{found.first.kind} {found.first.quantity}" == found_as, str(found)
    assert words in found.first.what
    assert found.classes[found.first.kind] > 0
    assert not found.equivalent


UNTRACED = {
    "answer in degrees": (injected.Degrees, "units"),
    "inverse answer": (Inverse, "different"),
    "sign of the angle": (WrongSign, "sign"),
    "one iteration more": (OneMore, "stop rule"),
    "no one-to-one filter": (option(one_to_one=False, max_iterations=1), "outlier rule"),
    "rounded to float32": (injected.Rounded, "precision"),
    "fewer iterations allowed": (option(max_iterations=2), "iteration cap"),
}


@pytest.mark.parametrize("name", UNTRACED)
def test_a_fault_is_classified_without_iterations(name):
    make, kind = UNTRACED[name]
    parameters = {"epsilon": 0.0, "max_iterations": 1} if "filter" in name else {}
    spec = with_fault(lambda **given: Untraced(make(**given)))
    found = equivalence("paper", spec, ROOM, set_a=parameters, set_b=parameters, scans=4)
    assert found.level == "answers"
    assert found.first is not None
    assert found.first.kind == kind


def test_ties_are_distinguished_from_outlier_rules():
    def doubled(frame):
        scan = frame.scan
        again = replace(scan, ranges=np.repeat(scan.ranges, 2), angles=np.repeat(scan.angles, 2), time_increment_ns=0)
        return replace(frame, scan=again, start_from_end=None)

    found = equivalence("paper", with_fault(TiesToTheHigher), sequence(doubled), scans=4)
    assert found.first is not None
    assert (found.first.kind, found.first.iteration, found.first.quantity) == ("nearest-neighbour tie", 1, "pairs")


def test_a_point_between_two_targets_is_a_tie():
    question = Question(2, "s2s", Cloud([[0, 0], [2, 0], [0, 4], [3, 5]]), Cloud([[1, 0], [0, 4], [3, 5]]), Pose())
    a = Icp(max_iterations=1, max_correspondence_m=0.0, trace=True).register(question.target, question.source, Pose())
    step = a.history[0]
    others = step.pairs.copy()
    others[0, 1] = 1 - others[0, 1]
    b = replace(a, history=(replace(step, pairs=others),))
    found = first_divergence(answer(Fixed(b), question, a), Margin())
    assert found is not None
    assert (found.kind, found.quantity) == ("nearest-neighbour tie", "pairs")
    others[0, 1] = 2
    found = first_divergence(answer(Fixed(b), question, a), Margin())
    assert found is not None
    assert found.kind == "different"
    assert "B does not take the nearest neighbour (source point 0: 1 m against 4.123 m" in found.what


def test_rounding_to_float32_is_equivalent_within_its_budget_and_not_below():
    assert equivalence("paper", with_fault(injected.Rounded), ROOM, scans=FEW, margin="float32").equivalent
    found = equivalence("paper", with_fault(injected.Rounded), ROOM, scans=FEW)
    assert not found.equivalent
    assert set(found.classes) == {"precision"}
    assert not equivalence("paper", with_fault(OneFewer), ROOM, scans=FEW, margin="float32").equivalent


def test_perturbed_inputs_reveal_a_larger_correspondence_limit():
    options = {"set_a": {"max_correspondence_m": 0.5}, "set_b": {"max_correspondence_m": 1.0}, "scans": FEW}
    calm = equivalence("paper", "paper", ROOM, **options, disturbed=False)
    assert calm.equivalent
    assert calm.first is None
    found = equivalence("paper", "paper", ROOM, **options)
    assert found.first is not None
    assert found.first.kind == "outlier rule"
    assert found.first.stage == "s2m-disturbed"


def test_differences_that_cancel_are_not_equivalent():
    made = iter(range(1000))
    found = equivalence(
        "paper",
        with_fault(lambda **given: Alternating(made)),
        ROOM,
        scans=12,
        margin=Margin(8e-4, 1e-9),
        disturbed=False,
    )
    signed = {one.quantity: one.inside for one in found.intervals}
    assert signed["s2s x"]
    assert not signed["s2s |translation|"]
    assert not found.equivalent


def test_a_failure_of_the_first_back_end_raises_an_error_with_its_label():
    with pytest.raises(BackendFailed, match="A: scan 2: raises ZeroDivisionError"):
        equivalence(with_fault(Raises), "paper", ROOM, scans=FEW)


def test_the_assertion_error_contains_the_comparison():
    assert assert_equivalent("paper", "paper", ROOM, scans=4).equivalent
    with pytest.raises(NotEquivalent, match="first divergence: scan 2, s2s, iteration 1, pose: different"):
        assert_equivalent("paper", with_fault(injected.Transposed), ROOM, scans=4)


def test_open3d_is_equivalent_to_the_paper_with_the_same_outlier_rule():
    if why := open3d_icp.POINT_TO_POINT.missing():
        pytest.skip(why)
    found = equivalence(
        "paper", "open3d-icp", ROOM, scans=FEW, margin=Margin(1e-9, 1e-9), disturbed=False,
        set_a={**TIGHT, "epsilon": 1e-12, "one_to_one": False, "error": "rmse", "max_correspondence_m": 0.2},
        set_b={"max_iterations": 200, "relative_fitness": 1e-12, "relative_rmse": 1e-12, "max_correspondence_m": 0.2},
    )  # fmt: skip
    assert found.level == "answers"
    assert found.equivalent, str(found)


@pytest.mark.parametrize(("name", "margin"), [("embedded", Margin()), ("embedded-f32", "float32")])
def test_the_compiled_core_is_equivalent_to_the_python_implementation(name, margin):
    if name not in registry.names("backends"):
        pytest.skip(f"no back end named '{name}' is registered")
    if why := registry.backend(name).missing():
        pytest.skip(why)
    found = equivalence("paper", name, ROOM, scans=12, margin=margin)
    assert found.equivalent, str(found)


class Wanderer:
    def __init__(self, change: Callable[[Pose], Pose] = lambda pose: pose, silent_at: int = -1) -> None:
        self._change, self._silent_at, self._asked = change, silent_at, 0

    def update(self, frame):
        self._asked += 1
        if self._asked == self._silent_at:
            raise NoAnswer("too dark")
        pose = Pose(0.1 * (self._asked - 1), 0.02 * self._asked - 0.02, 0.05 * (self._asked - 1))
        return OdometryEstimate(self._change(pose))


def wanderer(**options: object) -> BackendSpec:
    return OdometrySpec(lambda: Wanderer(**options), "", "", "MIT")


WANDERERS = {
    "inverse": (Pose.inverse, "different", "inverse"),
    "degrees": (lambda pose: Pose(pose.x, pose.y, math.degrees(pose.theta)), "units", "angle is in degrees"),
    "sign": (lambda pose: Pose(pose.x, -pose.y, pose.theta), "sign", "y has the wrong sign"),
    "rounding": (lambda pose: Pose.of(np.float32(pose.row)), "precision", ""),
    "another": (lambda pose: pose @ Pose(0.02, 0.01, 0.0), "different", "0.022 m"),
}


def test_an_odometry_is_equal_to_itself():
    found = equivalence(wanderer(), wanderer(), ROOM, scans=FEW)
    assert found.equivalent
    assert (found.level, found.first) == ("trajectories", None)


@pytest.mark.parametrize("name", WANDERERS)
def test_odometries_are_compared_by_their_poses(name):
    change, kind, words = WANDERERS[name]
    found = equivalence(wanderer(), wanderer(change=change), ROOM, scans=FEW)
    assert found.first is not None
    assert found.first.kind == kind
    assert words in found.first.what
    assert not found.equivalent


def test_a_scan_that_only_one_odometry_answers_is_unanswered():
    found = equivalence(wanderer(), wanderer(silent_at=3), ROOM, scans=FEW)
    assert (found.unanswered, found.equivalent) == (1, False)
    assert str(found.first) == "scan 3, trajectory, pose: different: B no answer: too dark"


def test_unknown_names_and_parameters_are_rejected():
    with pytest.raises(UnknownName, match="no backend named 'papper'"):
        equivalence("papper", "paper", ROOM)
    with pytest.raises(UnknownName, match="no parameter named 'epsilom'"):
        equivalence("paper", "paper", ROOM, set_b={"epsilom": 1.0})
    with pytest.raises(ValueError, match="margin metres: expected a positive number, got 0"):
        Margin(metres=0.0)


def test_every_result_can_be_written_as_json():
    found = equivalence("paper", with_fault(Raises), ROOM, scans=4)
    told = json.loads(json.dumps(found.as_json(), allow_nan=False))
    assert told["equivalent"] is False
    assert told["first"]["kind"] == "different"
    assert told["classes"] == {"different": 9}
    assert found.unanswered == 9


def test_the_command_exits_with_0_for_equivalent_1_for_different_and_2_for_usage(capsys, tmp_path):
    short = ("--on", "room laps=0.04", "--seeds", "1", "--scans", "4")
    assert validate_lockstep(tmp_path, "paper", *short, "--reference", "paper") == 0
    assert "paper is equivalent to paper (reference) within 1e-09 m" in capsys.readouterr().out
    filters = ("--set", "one_to_one=false", "--set-reference", "one_to_one=true")
    assert validate_lockstep(tmp_path, "paper-tight", *short, *filters, "--json") == 1
    report = json.loads(capsys.readouterr().out)
    assert report["levels"][0]["checks"][0]["data"]["first"]["kind"] == "outlier rule"
    assert (
        validate_lockstep(tmp_path, "log-odds", *short, "--set", "l_free=-0.4", "--set-reference", "l_free=-0.8") == 1
    )
    assert "increment" in capsys.readouterr().out
    assert validate_lockstep(tmp_path, "papper") == 2
    assert validate_lockstep(tmp_path, "paper", "--margin", "float16") == 2


def test_the_default_sequence_is_a_short_simulated_one():
    result = equivalence("paper", "paper", scans=3)
    assert (result.sequence, result.equivalent) == (defaults.find_simulated_dataset(), True)
