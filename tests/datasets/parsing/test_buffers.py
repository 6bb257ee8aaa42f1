"""Scans reordered by time while they are read, for any disorder of the input."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from evalkit_datasets.parsing.buffers import sort_by_rank


@dataclass(frozen=True)
class Reading:
    name: str
    ranges: np.ndarray = field(compare=False)


def readings(ranks):
    return [(rank, Reading(f"scan {rank}", np.array([rank, np.nan, np.inf]))) for rank in ranks]


@pytest.mark.parametrize("max_ahead", [0, 1, 3, 100])
@pytest.mark.parametrize(
    "ranks", [[0, 1, 2, 3], [3, 2, 1, 0], [4, 5, 6, 0, 1, 2, 3], np.random.default_rng(0).permutation(50).tolist()]
)
def test_scans_are_returned_in_order_with_their_own_ranges_from_memory_or_disk(ranks, max_ahead):
    found = list(sort_by_rank(readings(ranks), max_ahead))
    assert [scan.name for scan in found] == [f"scan {rank}" for rank in range(len(ranks))]
    for rank, scan in enumerate(found):
        np.testing.assert_array_equal(scan.ranges, [rank, np.nan, np.inf])


def test_a_scan_in_order_is_returned_before_the_next_is_read():
    read = []

    def reading():
        for rank, scan in readings(range(5)):
            read.append(rank)
            yield rank, scan

    for seen, _ in enumerate(sort_by_rank(reading())):
        assert read == list(range(seen + 1))


def test_a_limited_number_of_out_of_order_scans_keep_their_ranges_in_memory():
    alive = []

    class TrackedReading(np.ndarray):
        def __del__(self):
            alive.remove(id(self))

    def watched(count):
        for rank in reversed(range(count)):
            ranges = np.arange(8.0).view(TrackedReading)
            alive.append(id(ranges))
            yield rank, Reading("", ranges)
            most.append(len(alive))

    most = []
    assert len(list(sort_by_rank(watched(40), max_ahead=4))) == 40
    assert max(most) <= 6


def test_reading_stops_after_a_missing_scan():
    assert [scan.name for scan in sort_by_rank(readings([0, 2, 3]))] == ["scan 0"]
