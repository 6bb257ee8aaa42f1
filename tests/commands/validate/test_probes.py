"""What surrounds a validation: options, the quantity that separates wrong answers, drives, maps and pairs by hand."""

import math
from contextlib import nullcontext, suppress
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import typer

from evalkit.cli import app
from evalkit.commands.validate import (
    asked_question,
    command,
    drive_probes,
    printing,
    question_summary,
    run,
    scan_pairs,
)
from evalkit.commands.validate.acceptance import AcceptanceLevel, AcceptanceReport, Check
from evalkit.commands.validate.asked_question import AskedQuestion
from evalkit.commands.validate.equivalence import comparison, lockstep, map_cells
from evalkit.commands.validate.equivalence.divergence import Divergence
from evalkit.commands.validate.equivalence.lockstep import AnswerPair, ComparedBackend, PosePair, Question
from evalkit.commands.validate.equivalence.margins import Margin
from evalkit.commands.validate.equivalence.questions import DrawnQuestion, draw_questions
from evalkit.commands.validate.rules import scenes
from evalkit.core.errors import BackendFailed, BackendRefused, BadParameter, DataMissing, NotInstalled, UnknownName
from evalkit.core.grid import OccupancyGrid
from evalkit.core.match import Iteration, Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.plugins.protocols import NoAnswer
from evalkit.plugins.specs import DatasetSpec, MapperSpec, OdometrySpec, RegistrationSpec
from evalkit_baselines.paper.icp import Icp


def test_options_that_cannot_be_are_refused_with_what_is_expected():
    with pytest.raises(BadParameter, match=r"NAME=REASON, such as order='it samples its points'"):
        command._parse_waivers(["order="])
    assert command._parse_waivers([" order = it samples "]) == {"order": "it samples"}
    with pytest.raises(typer.BadParameter, match="found 2 names, expected one"):
        command._single_name(["a", "b"], "")
    assert (command._single_name(["a"], "rules"), command._single_name([], "determinism")) == ("a", "")
    with pytest.raises(typer.BadParameter, match="'office' is a data set, expected --only rules"):
        command._refuse_only("lockstep", ("", "rules"), "office", "data set")


def test_without_an_excerpt_a_sequence_has_to_be_named(monkeypatch):
    monkeypatch.setattr(command.defaults, "find_excerpts", lambda _: {})
    with pytest.raises(NotInstalled, match="name one with --on"):
        command._default_sequences(quick=True, simulated=False)


@pytest.mark.parametrize("words", [("nosuchmethod",), ("no.such.module:SPEC",), ("paper", "--reference", "nosuch")])
def test_a_name_that_is_unknown_leaves_no_folder(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((UnknownName, NotInstalled)):
        app(["validate", *words, "--only", "registrations", "--quick"])
    assert list(tmp_path.iterdir()) == []


SOME = Cloud(np.array([[1.0, 0.0], [0.0, 1.0], [2.0, 0.5]]))
MATCH = Match(Pose(), True, 3, 0.01, 3)


def asked(heading, points=SOME, what="", family="clear", b=MATCH, **fields):
    question = Question(1, family, points, SOME, Pose(0.0, 0.0, heading))
    given = {"others": (), "effect": "not asked", "repeats": True, "reference": None, "ask": None, **fields}
    return AskedQuestion(DrawnQuestion(family, what, question), AnswerPair(question, MATCH, b), **given)


@pytest.mark.parametrize(
    ("headings", "wrong", "said"),
    [
        (range(15), lambda at: at > 10, "only where the heading of the guess (rad) is above 1, from 1.1 on"),
        (range(15), lambda at: at < 3, "only where the heading of the guess (rad) is below 0.3, up to 0.2"),
        (range(15), lambda at: 5 <= at <= 8, "only where the heading of the guess (rad) is between 0.5 and 0.8"),
        (range(-7, 8), lambda at: abs(at) > 5, "only where the size of the guess's heading (rad) is above 0.5, "
                                               "from 0.6 on"),
        (range(15), lambda at: at % 5 == 0, ""),  # nothing separates them
        (range(15), lambda at: at > 12, ""),  # two are too few
        (range(15), lambda at: at > 3, ""),  # more wrong than right: it is no exception
    ],
)  # fmt: skip
def test_the_quantity_that_separates_wrong_answers_is_named(headings, wrong, said):
    assert question_summary._describe_where([(asked(0.1 * at), bool(wrong(at))) for at in headings]) == said


@pytest.mark.parametrize(("runs_in", "refuses", "answers"), [("program", False, True), ("program", True, False),
                                                            ("evalkit", False, False)])  # fmt: skip
def test_a_program_that_ended_is_started_again_for_the_next_question(runs_in, refuses, answers):
    """Each object ends with a question without a target. A refusal is no end, and no library is loaded again."""

    class Ends(Icp):
        ended = False

        def register(self, target, source, guess):
            if self.ended or not len(target):
                object.__setattr__(self, "ended", True)
                raise (BackendRefused if refuses else BackendFailed)("mine", "no target", "")
            return super().register(target, source, guess)

    side = ComparedBackend("mine", RegistrationSpec(Ends, "", "", "MIT", runs_in=runs_in), {})
    registration, points = side.registrations()["s2m"], Cloud(np.array([[0.0, 0.0], [2.0, 1.0], [1.0, 3.0]]))
    with pytest.raises(BackendFailed):
        registration.register(Cloud(np.zeros((0, 2))), points, Pose())
    with nullcontext() if answers else pytest.raises(BackendFailed):
        assert registration.register(points, points, Pose()).inliers == 3
    for _ in range(lockstep.MAX_STARTS):
        with suppress(BackendFailed):
            registration.register(Cloud(np.zeros((0, 2))), points, Pose())
    with pytest.raises(BackendFailed):
        registration.register(points, points, Pose())


@pytest.mark.parametrize("limit_m", [0.2, 0.3, 0.31, 1.0])
def test_a_drawn_question_has_other_numbers_of_pairs_for_a_limit_that_is_no_parameter(limit_m):
    """Lengths from 2 cm to 3 m in equal ratios, of points whose next target is more than 8 m away."""
    none = ComparedBackend("mine", RegistrationSpec(Icp, "", "", "MIT"), {})
    drawn = [one for one in draw_questions(0, none, none, quick=True) if one.what.startswith("pairs of 2 cm to 3 m")]
    (asked,) = (one.question for one in drawn)
    match = Icp(max_correspondence_m=limit_m).register(asked.target, asked.source, asked.guess)
    assert match.history[0].inliers == sum(0.02 * 150.0 ** (number / 47) < limit_m for number in range(48))


def test_only_other_pairs_in_the_first_iteration_whatever_the_guess_point_to_the_pairs_themselves():
    """A back end that drops a point has a pair less wherever it starts; one with a wrong heading only from one."""

    def answer_with(inliers):
        entry = Iteration(0.01, inliers, Pose(0.5 * (3 - inliers), 0.0, 0.0))
        return Match(entry.target_from_source, True, 1, 0.01, inliers, (entry,))

    def drops(question):
        return AnswerPair(question, answer_with(3), answer_with(2))

    def turns(question):
        return AnswerPair(question, answer_with(3), answer_with(3 if question.guess == Pose() else 2))

    fewer = answer_with(2)
    pairs = Divergence(1, "clear", 1, "pairs", "different", "3 pairs against 2; not both report their pairs")
    cases = [  # divergence, answer, side: numbers of pairs differ, and differ from the identity too
        (pairs, fewer, drops, True, True),
        (pairs, fewer, turns, True, False),
        (replace(pairs, iteration=2), fewer, drops, True, False),  # the motion of the points after a step
        (replace(pairs, kind="precision"), fewer, drops, True, False),
        (replace(pairs, iteration=None, quantity="answer"), fewer, drops, True, False),  # of the last iteration alone
        (replace(pairs, iteration=None, quantity="answer"), MATCH, drops, False, False),
        (replace(pairs, iteration=None, quantity="answer"), None, drops, False, False),
        (replace(pairs, quantity="pose"), MATCH, drops, False, False),
    ]
    for divergence, b, ask, recounted, mispaired in cases:
        one = asked(0.1, b=b, ask=ask)
        assert one.is_recounted(divergence) is recounted
        assert one.is_mispaired(divergence, Margin()) is mispaired


def test_a_start_with_which_the_reference_gives_the_other_answers_is_named():
    """A reference that answers its guess: whoever answers that guess with a heading in another unit began there."""
    reference = SimpleNamespace(register=lambda _target, _source, guess: replace(MATCH, target_from_source=guess))

    def answers(*headings, scale):
        return [
            (asked(at, b=replace(MATCH, target_from_source=Pose(0.0, 0.0, scale * at)), reference=reference), Margin())
            for at in headings
        ]

    degrees = answers(0.1, -0.2, 0.3, scale=math.pi / 180.0)
    assert question_summary._describe_start(degrees) == "the guess's angle is interpreted as degrees"
    unknown = answers(0.4, scale=0.7)  # one answer that no start explains
    assert question_summary._describe_start(degrees + unknown) == ""
    assert question_summary._describe_start(degrees[:2]) == ""  # too few
    assert question_summary._describe_start([*degrees, (asked(0.1, b=None), Margin())]) == ""


def test_the_largest_difference_is_that_nearest_to_the_margin_of_its_own_question():
    def apart(metres, allowed_m):
        return asked(0.0, b=replace(MATCH, target_from_source=Pose(metres, 0.0, 0.0))), Margin(allowed_m, 1e-3)

    accepted = [apart(1e-3, 2e-3), apart(4e-3, 1.0), apart(0.5, 1e-3)]  # the last one beyond: rounding decides it
    found = question_summary._describe_differences(accepted)
    assert found == {"largest_m": 1e-3, "allowed_m": 2e-3, "excepted": 1}
    assert question_summary._describe_differences([]) == {"largest_m": 0.0, "allowed_m": 0.0, "excepted": 0}


def test_a_parameter_without_effect_is_named_instead_of_its_difference(monkeypatch):
    other = replace(MATCH, target_from_source=Pose(0.5123456789012, 0.2, 0.1))
    one = asked(0.0, family="parameter epsilon", b=other)
    found = one.judge(Margin(), Margin(), "epsilon", explain=False)
    assert (found.kind, found.what) == ("parameter", "parameter epsilon has no effect")
    assert one.judge(Margin(), Margin(), "", explain=False).kind == "different"
    assert asked(0.0).judge(Margin(), Margin(), "", explain=False) is None
    rounded = lambda *_: Divergence(1, "s2s", None, "pose", "precision", "")  # noqa: E731
    monkeypatch.setattr(asked_question, "first_divergence", rounded)
    assert one.judge(Margin(), "float32", "", explain=False) is None


class Standing:
    """An odometry whose pose is the number of the scan times a step; it raises NoAnswer or another error at a scan."""

    def __init__(self, step=0.1, silent=-1, broken=-1):
        self._step, self._silent, self._broken, self._scan = step, silent, broken, -1

    def update(self, frame):
        self._scan += 1
        if self._scan == self._silent:
            raise NoAnswer("too dark")
        if self._scan == self._broken:
            raise ZeroDivisionError("no pairs")
        return OdometryEstimate(Pose(self._step * self._scan + float(np.nanmax(frame.scan.ranges)), 0.0, 0.0))


def side(label, **options):
    return ComparedBackend(label, OdometrySpec(lambda: Standing(**options), "", "", "MIT"), {})


def driven(a, b, margin="exact"):
    return drive_probes.compare_drives((side("A", **a), side("B", **b)), 3, {margin: drive_probes_margin(margin)})


def drive_probes_margin(name):
    return "float32" if name == "float32" else Margin()


def test_drives_that_end_or_that_the_reference_refuses_are_counted(monkeypatch):
    monkeypatch.setattr(drive_probes, "mistaken_frames", lambda: ())
    monkeypatch.setattr(drive_probes, "draw_drives", lambda _: iter([("drive", "a drive", scenes.drive(12).frames)]))
    broken = driven({}, {"broken": 5})["exact"]
    assert (broken["unanswered"], broken["first"]["what"]) == (1, "B raises ZeroDivisionError: no pairs")
    refused = driven({"broken": 5}, {})["exact"]
    assert (refused["questions"], refused["equivalent"]) == (0, True)
    silent = driven({}, {"silent": 4})["exact"]
    assert (silent["beyond_rounding"], silent["first"]["scan"]) == (1, 5)
    single = driven({}, {"step": 0.1 + 1e-9}, "float32")["float32"]
    assert single["equivalent"]
    longer = driven({}, {"step": 0.2}, "float32")["float32"]
    assert (longer["first"]["kind"], longer["equivalent"]) == ("different", False)


AWAY = np.array([1.0, 0.0, 0.0])


def test_a_mistake_that_leaves_less_than_a_third_is_called_likely(monkeypatch):
    frames = scenes.drive(12).frames
    poses = np.zeros((12, 3))
    one = drive_probes.Driven("drive", "a drive", frames, poses, poses + AWAY, "", 0.0)
    monkeypatch.setattr(
        drive_probes, "_mistaken_poses", lambda *_: iter([("far", poses), ("near", poses + 0.8 * AWAY)])
    )
    assert drive_probes._find_cause(side("A"), [one]) == "most like: near"
    monkeypatch.setattr(drive_probes, "_mistaken_poses", lambda *_: iter([("exact", poses + AWAY)]))
    assert drive_probes._find_cause(side("A"), [one]) == "exact"


def test_a_trajectory_differs_where_one_side_alone_has_no_answer():
    def told(a, b, failure=""):
        found = comparison._pose_divergence(PosePair(2, a, b, failure), Margin())
        return found and found.what

    assert told(None, None) is None
    assert told(None, Pose()) == "A has no answer, B has one"
    assert told(Pose(), None, "no answer: too dark") == "B no answer: too dark"


class Empty:
    def __len__(self):
        return 0

    def frames(self):
        return iter(())


def test_what_is_missing_is_said_before_it_is_compared():
    gone = DatasetSpec(Empty, "", "", "", "", "MIT", missing=lambda: "no file drive.bag")
    with pytest.raises(DataMissing, match=r"no file drive\.bag"):
        comparison._load_sequence(gone, {})
    with pytest.raises(NotInstalled, match="cannot be compared here"):
        comparison._load_mapper("A", MapperSpec(Empty, "", "", "MIT", missing=lambda: "no compiler"))


def grid(log_odds, x=0.0, resolution=0.5):
    return OccupancyGrid(np.float32(log_odds), np.ones(np.shape(log_odds), dtype=np.int32), resolution, x, 0.0)


def test_grids_are_compared_on_their_common_extent():
    assert map_cells.GridPair.of(grid(np.zeros((0, 0))), grid(np.zeros((0, 0)))).a.shape == (0, 0)
    pair = map_cells.GridPair.of(grid([[1.0, 2.0]]), grid([[2.0, 3.0]], x=0.5))
    assert (pair.a.tolist(), pair.b.tolist()) == ([[1.0, 2.0, 0.0]], [[0.0, 2.0, 3.0]])
    assert (
        map_cells._cell_mismatch(grid([[1.0]]), grid([[1.0]], x=0.2))
        == "cells are shifted by part of a cell: [0.6, 0.0]"
    )
    assert map_cells._cell_mismatch(grid([[1.0]]), grid([[1.0]], resolution=0.25)) == "cells of 0.5 m against 0.25 m"


def increment(a, b, ends):
    empty = map_cells.GridPair.of(grid(np.zeros((1, 4))), grid(np.zeros((1, 4))))
    now = map_cells.GridPair.of(grid([a]), grid([b]))
    return map_cells._ScanIncrement(empty, now, now.differing(1e-5), np.array([ends], dtype=bool)).divergence(1)


def test_increments_are_named_by_what_they_have_in_common():
    free = [0.0, 0.0, 0.0, 0.0]
    sign = increment([-0.4, -0.4, -0.4, 0.8], [-0.4, -0.4, -0.4, -0.8], [0, 0, 0, 1])
    assert (sign.kind, sign.what.partition(";")[0]) == ("sign", "A adds at the end of a beam what B subtracts")
    along = increment([-0.4, -0.3, -0.4, 0.8], [0.4, 0.3, 0.4, 0.8], [0, 0, 0, 1])
    assert (along.kind, along.what.partition(";")[0]) == ("sign", "A adds along a beam what B subtracts")
    ratio = increment([-0.4, -0.3, -0.4, 0.8], [-0.62, -0.465, -0.62, 0.8], free)
    assert (ratio.kind, ratio.what.partition(";")[0]) == ("increment", "B adds 1.55 times what A adds")
    none = increment([-0.4, -0.3, -0.4, 0.8], [-0.65, -0.41, -0.52, 0.8], free)
    assert (none.kind, none.what.partition(";")[0]) == ("different", "no common cause explains it")


def test_a_motion_between_two_scans_needs_the_truth_or_the_wheels():
    first, second = scenes.drive(4, odometry_gain=None).frames[:2]
    assert scan_pairs._motion(first, second, None) is None
    moved = replace(first, odom_from_base=Pose(1.0, 0.0, 0.0)), replace(second, odom_from_base=Pose(1.5, 0.0, 0.0))
    assert scan_pairs._motion(*moved, None) == Pose(0.5, 0.0, 0.0)
    frames = scenes.drive(3, odometry_gain=None).frames
    sequence = SimpleNamespace(frames=lambda: iter(frames), truth=lambda: SimpleNamespace(trajectory=None))
    pairs = list(scan_pairs.scan_pairs(sequence, 1, exact=True))
    assert [one.truth for one in pairs] == [Pose(), Pose()]  # of the next scan, as if the robot stood
    assert [one.question.scan for one in pairs] == [1, 1]


def test_a_run_without_a_common_scan_repeats_nothing(monkeypatch):
    unknown = SimpleNamespace(verdict="failed", apart_m=None, reason="", scans=0)
    monkeypatch.setattr(run, "measure_determinism", lambda *_: unknown)
    monkeypatch.setattr(run, "asdict", vars)
    announced = []
    found = run.report_determinism(["paper"], {}, ["room laps=0.04"], 2, 2, announced.append)
    (check,) = found.levels[0].checks
    assert (check.outcome, check.observed) == ("failed", "failed: the runs have no scan in common")
    assert (announced, found.subject) == (["paper"], "paper")


def test_the_program_behind_a_command_is_described_by_its_content(tmp_path):
    program = tmp_path / "icp"
    program.write_bytes(b"#!/bin/sh\n")
    program.chmod(0o755)
    found = run.describe_binaries(f"exec:{program} --fast")
    assert list(found) == ["icp"]
    assert found["icp"].startswith("SHA-256 a8076d3d28d21e02012b20eaf7dbf75409a6277134439025f282e368e3305abf")


def test_a_report_is_printed_by_level_or_by_check_and_kept_for_a_build_server(tmp_path, capsys):
    checks = tuple(Check(f"check {number}", "room", "failed", "always", f"[b]{number}") for number in range(6))
    level = AcceptanceLevel(0, "rules", "?", checks)
    report = AcceptanceReport("mine", "", "", (), {}, "equal", "", "", (level,), {}, {})
    rows = printing.format_table(report).row_count
    both = printing.format_table(replace(report, levels=(level, replace(level, number=1)))).row_count
    assert (rows, both) == (6, 2)
    unjudged = replace(level, checks=(*checks, replace(checks[0], outcome="not judged")))
    assert printing.format_table(replace(report, levels=(unjudged,))).row_count == 6  # "all rules" names it
    with pytest.raises(typer.Exit) as ended:
        printing.finish(report, tmp_path, False, tmp_path / "junit.xml")
    assert ended.value.exit_code == 1
    assert sorted(one.name for one in tmp_path.iterdir()) == ["acceptance.json", "index.html", "junit.xml"]
    assert "[b]5" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("outcomes", "printed"),
    [
        (("passed", "not applicable", "failed", "waived", "passed"), ["failed", "waived"]),
        (("passed", "not applicable", "waived"), ["passed", "not applicable", "waived"]),
    ],
)
def test_where_a_check_failed_those_that_passed_are_only_counted(outcomes, printed, tmp_path, capsys):
    checks = tuple(Check(f"check {number}", "", one, "always", "yes") for number, one in enumerate(outcomes))
    level = AcceptanceLevel(0, "rules", "?", checks)
    report = AcceptanceReport("mine", "", "", (), {}, "equal", "", "", (level,), {}, {})
    with suppress(typer.Exit):
        printing.finish(report, tmp_path, False, None)
    text = capsys.readouterr().out
    assert [one for line in text.splitlines() if "check " in line for one in outcomes if f" {one} " in line] == printed
    assert ("not shown here: 2 passed, 1 not applicable" in text) == ("failed" in outcomes)
