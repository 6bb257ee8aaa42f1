"""Spearman's correlation against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from evalkit.stats.correlation import spearman_correlation


def test_the_correlation_equals_scipys_including_ties() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.integers(0, 5, (7, 30)), rng.normal(size=(7, 30))
    expected = [stats.spearmanr(x, y).statistic for x, y in zip(a, b, strict=True)]
    assert spearman_correlation(a.astype(float), b) == pytest.approx(expected)
    assert np.isnan(spearman_correlation(np.ones(5), np.arange(5.0)))
