"""The rules on memory collect garbage after each of their batches of calls."""

import gc

import pytest


@pytest.fixture(scope="module", autouse=True)
def _few_objects_to_collect():
    """Exempt what other tests have left from garbage collection: each would visit it again."""
    gc.collect()
    gc.freeze()
