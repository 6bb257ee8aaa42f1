"""What a SLAM has at the end is read as it is, or refused with a sentence."""

import math
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest

from evalkit.core.loop_closure import LoopClosure
from evalkit.core.pose import Pose
from evalkit.core.trajectory import Trajectory
from evalkit.odometry import corrections
from evalkit.odometry.corrections import read_loop_closures, read_remarks, read_trajectory
from evalkit.results.final_files import format_final, parse_final

STAMPS = np.array([10, 20, 30])


def slam(trajectory=None, closures=()):
    return SimpleNamespace(trajectory=lambda: trajectory, loop_closures=lambda: closures)


def test_a_trajectory_at_the_frames_is_returned_in_the_frame_of_the_start():
    poses = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.1], [2.0, 0.5, 0.2]]
    found = read_trajectory(slam(Trajectory(STAMPS, poses, "map", "robot")), STAMPS)
    assert (found.stamps_ns.tolist(), found.poses.tolist()) == (STAMPS.tolist(), poses)
    assert (found.parent, found.child) == ("start", "base")


def broken_trajectory():
    found = Trajectory(STAMPS, np.zeros((3, 3)))
    object.__setattr__(found, "poses", np.full((3, 3), math.nan))
    return found


@pytest.mark.parametrize(
    ("answer", "kind", "what"),
    [
        (None, TypeError, "trajectory() returned a NoneType, expected an evalkit.Trajectory"),
        (np.zeros((3, 3)), TypeError, "trajectory() returned a ndarray"),
        (Trajectory([10, 30], np.zeros((2, 3))), ValueError, "2 poses for 3 answered frames"),
        (Trajectory([10, 21, 30], np.zeros((3, 3))), ValueError, "the stamp 21 ns at index 1, expected 20 ns"),
        (broken_trajectory(), ValueError, "a pose that is not finite"),
        (
            Trajectory([10, 20, 30], [[0, 0, 0], [0, -1e300, 0], [0, 2e7, 0]]),
            ValueError,
            "a pose farther away than 10,000,000 m at stamp 20 ns",
        ),
    ],
)
def test_another_answer_is_refused(answer, kind, what):
    with pytest.raises(kind) as error:
        read_trajectory(slam(answer), STAMPS)
    assert what in str(error.value)


def test_loop_closures_are_between_answered_frames(monkeypatch):
    good = LoopClosure(30, 10, Pose(0.1, 0.0, 0.0), True, "near")
    assert read_loop_closures(slam(closures=[good]), STAMPS) == (good,)
    with pytest.raises(TypeError, match="returned a generator, expected a tuple"):
        read_loop_closures(slam(closures=(one for one in [good])), STAMPS)
    with pytest.raises(TypeError, match="returned a str at index 1"):
        read_loop_closures(slam(closures=[good, "no"]), STAMPS)
    with pytest.raises(ValueError, match="refers at index 0 to 11 ns, where no frame was answered"):
        read_loop_closures(slam(closures=[LoopClosure(30, 11, Pose(), True, "near")]), STAMPS)
    monkeypatch.setattr(corrections, "MAX_CLOSURES", 1)
    with pytest.raises(ValueError, match="2 candidates, at most 1 are stored"):
        read_loop_closures(slam(closures=[good, good]), STAMPS)


def test_a_hundred_thousand_keyframes_are_read_stored_and_parsed_in_bounded_memory():
    count = 100_000
    stamps = np.arange(count) * 100_000_000
    found = Trajectory(stamps, np.zeros((count, 3)), "start", "base")
    closures = [LoopClosure(int(stamp), int(stamps[0]), Pose(), True, "near") for stamp in stamps[1::100]]
    tracemalloc.start()
    final = read_trajectory(slam(found), stamps)
    files = format_final(final, read_loop_closures(slam(closures=closures), stamps))
    again, loops = parse_final(files, stamps)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert (len(again), loops) == (count, tuple(closures))
    assert peak < 40 * 2**20  # 2.4 MB of poses, in a few copies, and the set of stamps


@pytest.mark.parametrize(
    ("remarks", "error", "said"),
    [
        (["full"], TypeError, "expected a tuple of texts"),
        (("full", 3), TypeError, "expected a tuple of texts"),
        (("",), TypeError, "expected a tuple of texts"),
        (("full",) * 11, ValueError, "11 texts, at most 10"),
    ],
)
def test_remarks_are_a_few_texts(remarks, error, said):
    assert read_remarks(SimpleNamespace(update=None)) == ()
    assert read_remarks(SimpleNamespace(remarks=lambda: ("one\n\x1b", "two"))) == ("one\\n\\x1b", "two")
    with pytest.raises(error, match=said):
        read_remarks(SimpleNamespace(remarks=lambda: remarks))
