"""Indices spread over an array, and memory of arrays that are made and freed in turn."""

import ctypes
import subprocess
import sys

import pytest

from evalkit.core.arrays import spread_indices

COUNT_FAULTS = """
import resource
import numpy as np
from evalkit.core.arrays import keep_freed_memory

def count_faults():
    [np.ones(131072) for _ in range(50)]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(10):
        [np.ones(131072) for _ in range(50)]
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

print(count_faults())
keep_freed_memory()
print(count_faults())
"""


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="not glibc")
def test_memory_that_is_kept_is_not_mapped_again() -> None:
    """50 arrays of 1 MiB, ten times: the system maps their pages each time, or never where they are kept."""
    run = subprocess.run([sys.executable, "-c", COUNT_FAULTS], capture_output=True, text=True, check=True)
    mapped_anew, kept = map(int, run.stdout.split())
    assert mapped_anew > 100  # one for each 5 MiB at least: pages may be larger
    assert kept < mapped_anew / 10


@pytest.mark.parametrize(("count", "most", "expected"), [
    (0, 5, []), (-1, 5, []), (1, 5, [0]), (3, 5, [0, 1, 2]), (5, 5, [0, 1, 2, 3, 4]), (10, 4, [0, 3, 6, 9]),
    (999, 2, [0, 998]),
])  # fmt: skip
def test_spread_indices_are_even_with_the_first_and_the_last(count, most, expected):
    assert spread_indices(count, most).tolist() == expected
