"""Perturbations of recordings: small, repeatable, and the same for every method."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from evalkit.core.ground_truth import Truth
from evalkit.core.scan import Frame, Scan
from evalkit.plugins.nuisance import CHANGE, MAX_LATER, perturb_parameters, perturb_sequence
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import DatasetSpec


class Recording:
    """A hundred scans of 400 beams, ranges in whole centimetres; every tenth beam has no return."""

    def __init__(self, scans=100):
        self.scans = scans

    def __len__(self):
        return self.scans

    def frames(self):
        for index in range(self.scans):
            ranges = 0.01 * np.round(100 * np.random.default_rng(index).uniform(1.0, 5.0, 400))
            ranges[::10] = np.inf
            yield Frame(Scan(index * 100_000_000, ranges, np.linspace(-3.0, 3.0, 400), 0.1, 5.0))

    def truth(self):
        return Truth("exact")

    def notes(self):
        return {"scans out of order": 2}


def test_a_perturbed_recording_starts_later_with_fewer_beams_and_noise_of_one_digit():
    whole = list(Recording().frames())
    for number in (1, 2, 9):
        changed = perturb_sequence(Recording(), number)
        frames = list(changed.frames())
        later = len(whole) - len(frames)
        assert 1 <= later <= MAX_LATER
        assert len(changed) == len(frames)
        hidden = []
        for frame, original in zip(frames, whole[later:], strict=True):
            ranges, before = frame.scan.ranges, original.scan.ranges
            assert frame.scan.stamp_ns == original.scan.stamp_ns
            hidden.append(np.isnan(ranges).mean())
            kept = np.isfinite(ranges)
            assert np.abs(ranges[kept] - before[kept]).max() <= 0.005 + 1e-9
            assert np.isinf(ranges[np.isinf(before) & ~np.isnan(ranges)]).all()
        assert np.mean(hidden) == pytest.approx(0.1, abs=0.01)
    assert changed.truth().how == "exact"
    assert changed.notes() == {"scans out of order": 2}


def test_a_perturbation_is_repeatable_and_differs_from_the_others():
    def first(number):
        return next(iter(perturb_sequence(Recording(), number).frames())).scan.ranges

    assert np.array_equal(first(3), first(3), equal_nan=True)
    assert not np.array_equal(first(3), first(4), equal_nan=True)


def test_excerpts_have_the_given_length_and_lie_all_over_the_recording():
    firsts = []
    for number in range(1, 9):
        changed = perturb_sequence(Recording(1000), number, 100)
        assert len(changed) == 100
        firsts.append(next(iter(changed.frames())).scan.stamp_ns / 1e8)
    assert min(firsts) < 150
    assert max(firsts) > 750
    assert len(perturb_sequence(Recording(3), 1, 100)) in (1, 2)


def test_an_excerpt_reads_no_scan_before_its_first_where_the_recording_can_begin_anywhere():
    asked = []

    class Sought(Recording):
        def frames_from(self, first):
            asked.append(first)
            return islice(super().frames(), first, None)

    for sought, plain in zip(
        perturb_sequence(Sought(), 5, 20).frames(), perturb_sequence(Recording(), 5, 20).frames(), strict=True
    ):
        assert sought.scan.stamp_ns == plain.scan.stamp_ns
        assert np.array_equal(sought.scan.ranges, plain.scan.ranges, equal_nan=True)
    assert asked == [plain.scan.stamp_ns // 100_000_000 - 19]


def test_lengths_change_by_one_factor_within_one_percent_and_within_their_bounds():
    table = (
        Parameter("radius", 0.5, "m", "", 0.0, 0.5), Parameter("reach", 2.0, "m", ""), Parameter("cell", 0.1, "m", ""),
        Parameter("keyframes", 10, "", ""), Parameter("share", 0.9, "", ""),
    )  # fmt: skip
    given = {"radius": 0.5, "reach": 2.0, "cell": 0.1, "keyframes": 10, "share": 0.9, "other": 1.0}
    for number in range(1, 9):
        changed = perturb_parameters(given, table, number)
        factor = changed["reach"] / 2.0
        assert 0.0 < abs(factor - 1.0) <= CHANGE
        assert changed["cell"] == pytest.approx(0.1 * factor)
        assert changed["radius"] == pytest.approx(min(0.5 * factor, 0.5))
        assert {name: changed[name] for name in ("keyframes", "share", "other")} == {
            "keyframes": 10, "share": 0.9, "other": 1.0,
        }  # fmt: skip


def test_a_data_set_opens_a_perturbed_sequence_only_for_the_reserved_parameters():
    spec = DatasetSpec(Recording, "", "", "", "", "")  # type: ignore[arg-type]
    assert isinstance(spec.open({"scans": 20}), Recording)
    assert len(spec.open({"scans": 200, "nuisance": 2, "nuisance_scans": 50})) == 50
