"""The rules of SLAM back ends: a sound one passes, and each faulty one breaks the rule named for its fault."""

import importlib
import re
import sys
from pathlib import Path

import pytest

from evalkit.commands.validate.rules import endurance, odometry_rules, slam_rules
from evalkit.commands.validate.rules.rule import check_rule

sys.path.append(str(Path(__file__).parents[3] / "misfits"))
faulty = importlib.import_module("faulty_slams")

OWN = [name for name in slam_rules.RULES if name not in odometry_rules.RULES]


def test_a_sound_slam_breaks_no_rule_of_its_own_and_may_keep_a_pose_for_each_frame(monkeypatch):
    monkeypatch.setattr(endurance, "BUDGET_S", 0.05)
    monkeypatch.setattr(endurance, "INSTANCES", 20)
    fixture = slam_rules.SlamFixture(faulty.SoundSlam, role="baseline")
    results = {name: check_rule(slam_rules.RULES[name], fixture) for name in [*OWN, "first", "memory", "deterministic"]}
    assert {name: one.observed for name, one in results.items() if one.outcome != "passed"} == {}
    assert results["corrections"].observed == "1 updates move earlier poses and report it"
    assert results["closures"].observed == "2 candidates, 1 accepted, between answered frames"


@pytest.mark.parametrize(
    ("make", "rule", "said"),
    [
        (
            faulty.LeavesOutFrames,
            "final-stamps",
            r"after 2 frames: trajectory\(\) returned 1 poses for 2 answered frames",
        ),
        (faulty.MovesTheStart, "final-first", "after 80 frames the first corrected pose is .0.060 m, -0.030 m"),
        (
            faulty.Tears,
            "final-continuous",
            r"from frame 40 to 41 it moves .-?0.\d\d m, -?0.\d\d m, 7.0 deg., the answers .0.12 m",
        ),
        (faulty.InTheWrongFrame, "final-on-track", r"corrected poses are up to \d+.\d cm off, answers up to \d\d"),
        (faulty.RandomCorrection, "final-deterministic", "the same drive has another corrected pose at frame 6"),
        (faulty.RandomClosures, "final-deterministic", "the same drive has other loop closures"),
        (faulty.CorrectsWhenAsked, "final-read-only", "asked after each frame, it answers .* at frame 2, else"),
        (faulty.OutOfOrder, "closures", "loop closure 2 is of an earlier frame than the one before"),
        (faulty.OfUnknownFrames, "closures", r"refers at index 0 to \d+ ns, where no frame was answered"),
        (faulty.Silent, "corrections", r"frame 80 moves earlier poses by up to 6.\d cm and 0.0 deg and reports none"),
        (faulty.Boasts, "corrections", "frame 10 moves earlier poses by up to 0.0 cm and 0.0 deg and reports a corr"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_each_fault_breaks_the_rule_named_for_it(make, rule, said):
    one = check_rule(slam_rules.RULES[rule], slam_rules.SlamFixture(make, role="baseline"))
    assert one.outcome == "failed", one.observed
    assert re.search(said, one.observed), one.observed


def test_a_slam_need_not_report_corrections():
    one = check_rule(slam_rules.RULES["corrections"], slam_rules.SlamFixture(faulty.NotReporting))
    assert (one.outcome, one.observed) == (
        "not applicable", "it reports no corrections; the frames of accepted loop closures count",
    )  # fmt: skip
