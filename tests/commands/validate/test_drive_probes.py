"""Drawn drives to two odometries: an equal one passes, and a mistake in reading frames is named."""

from dataclasses import replace

import numpy as np
import pytest

from evalkit.commands.validate import drive_probes, level_answers
from evalkit.commands.validate.comparison_terms import ComparisonTerms
from evalkit.commands.validate.drive_probes import compare_drives
from evalkit.commands.validate.equivalence.comparison import load_backend
from evalkit.commands.validate.equivalence.margins import Margin
from evalkit.core.pose import Pose

SEED = 5


class Misread:
    """An odometry that gets each frame as a function changes it."""

    def __init__(self, odometry, change):
        self._odometry, self._change = odometry, change

    def update(self, frame):
        return self._odometry.update(self._change(frame))


def compared(change):
    own = load_backend("A", "embedded-pipeline", {})
    if why := own.spec.missing():
        pytest.skip(why)
    other = replace(
        own, label="B", spec=replace(own.spec, make=lambda **given: Misread(own.spec.make(**given), change))
    )
    return compare_drives((own, other), SEED, {"exact": Margin()})


def first_beams(frame):
    ranges = frame.scan.ranges.copy()
    ranges[200:] = np.nan
    return replace(frame, scan=replace(frame.scan, ranges=ranges))


def test_the_same_odometry_is_equal_on_every_drive():
    found = compared(lambda frame: frame)["exact"]
    assert found["equivalent"]
    assert {name: one["wrong"] for name, one in found["families"].items()} == dict.fromkeys(
        ("drive", "mounting", "beams", "ranges", "returns", "wheel odometry"), 0
    )
    terms = ComparisonTerms("B", "A", "exact", 0.5)
    checks = level_answers.registrations_level({}, {}, terms, {"seed 5": {"exact": found}}).checks
    observed = [one.observed for one in checks if one.name.partition(": ")[2] in found["families"]]
    limit_m = Margin().metres + drive_probes.LEVER_M * Margin().radians
    assert len(observed) == len(found["families"])
    assert all("questions, all answers are equal: at most " in text for text in observed)
    assert all(text.endswith(f" m apart where {limit_m:.2g} m are allowed") for text in observed)


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (first_beams, "only the first 200 beams are used"),
        (lambda one: replace(one, base_from_sensor=Pose()), "the mounting of the lidar is not used"),
        (lambda one: replace(one, odom_from_base=None, start_from_end=None), "the wheel odometry is not used"),
    ],
)
def test_a_mistake_in_reading_frames_is_named(change, cause):
    found = compared(change)["exact"]
    assert not found["equivalent"]
    assert found["first"]["what"] == cause


def test_a_mounting_that_is_not_used_differs_only_where_the_lidar_is_off_the_centre():
    families = compared(lambda one: replace(one, base_from_sensor=Pose()))["exact"]["families"]
    assert {name for name, one in families.items() if one["wrong"]} == {"mounting"}


def test_poses_differ_by_their_shift_and_their_turn_at_the_lever_and_infinitely_where_one_is_missing():
    a = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [np.nan] * 3, [np.nan] * 3])
    b = np.array([[0.3, 0.4, 0.1], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [np.nan] * 3])
    expected = [0.5 + 0.1 * drive_probes.LEVER_M, 0.0, np.inf, 0.0]
    assert drive_probes.distances_m(a, b) == pytest.approx(expected)
