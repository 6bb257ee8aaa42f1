"""A kept sequence reads its data once, if they are few."""

import numpy as np
import pytest

from evalkit.core.scan import Frame, Scan
from evalkit.plugins.kept_sequence import KeptSequence

BEAMS = 10


class Counted:
    """Three frames, and the number of readings of each."""

    def __init__(self):
        self.reads = [0, 0, 0]

    def __len__(self):
        return 3

    def frames(self):
        for index in range(3):
            self.reads[index] += 1
            yield Frame(Scan(index, np.ones(BEAMS), np.linspace(-1.0, 1.0, BEAMS), 0.1, 5.0))

    def truth(self):
        return "truth"

    def notes(self):
        return {"read": sum(self.reads)}


@pytest.mark.parametrize(("max_bytes", "reads"), [(3 * 2 * 8 * BEAMS, 1), (3 * 2 * 8 * BEAMS - 1, 2)])
def test_frames_are_read_once_if_ranges_and_angles_fit(max_bytes, reads):
    counted = Counted()
    kept = KeptSequence(counted, max_bytes)
    stamps = [[frame.scan.stamp_ns for frame in kept.frames()] for _ in range(2)]
    assert stamps == [[0, 1, 2]] * 2
    assert counted.reads == [reads] * 3
    assert (len(kept), kept.truth(), kept.notes()) == (3, "truth", {"read": 3 * reads})


def test_a_reading_that_stops_early_keeps_nothing():
    counted = Counted()
    kept = KeptSequence(counted)
    next(kept.frames())
    assert len(list(kept.frames())) == 3
    assert counted.reads == [2, 1, 1]
