import numpy as np
import pytest

from evalkit_datasets.worlds.disturbances import NEVER, Episodes

S = 1_000_000_000


def test_disturbances_start_after_half_a_period_and_end_in_time():
    stamps = np.array([0.0, 1.9, 2.0, 2.4, 2.5, 5.9, 6.0, 6.49, 6.5, 8.0]) * S
    asked = Episodes(every_s=4.0, lasts_s=0.5).contains(stamps.astype(np.int64))
    assert asked.tolist() == [False, False, True, True, False, False, True, True, False, False]


def test_without_a_period_there_are_no_disturbances():
    assert not NEVER.contains(np.arange(0, 100 * S, S // 10)).any()


def test_negative_times_are_rejected():
    with pytest.raises(ValueError, match="lasts_s: negative"):
        Episodes(1.0, -0.1)
