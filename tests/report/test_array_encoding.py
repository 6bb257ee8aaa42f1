"""Encoded arrays of a page: error of at most half a step, exact decoding, and reproducible bytes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from evalkit.report.html.array_encoding import NONE, dequantise, pack_array, quantise, unpack_array


def test_the_error_of_a_number_is_at_most_half_a_step():
    values = np.random.default_rng(0).uniform(-40.0, 40.0, 10_000)
    assert np.abs(dequantise(quantise(values, 1e-3), 1e-3) - values).max() <= 0.5e-3 + 1e-12


def test_nan_and_out_of_range_numbers_are_encoded_as_missing():
    assert quantise([np.nan, np.inf, 3e6, -3e6, 1.0], 1e-3).tolist() == [NONE, NONE, NONE, NONE, 1000]
    assert np.isnan(dequantise(quantise([np.nan], 1e-3), 1e-3)).all()


@given(arrays.arrays(np.int32, st.tuples(st.integers(1, 9), st.integers(1, 4))))
def test_encoded_arrays_are_decoded_unchanged(steps):
    assert np.array_equal(unpack_array(pack_array(steps), steps.shape), steps)


def test_the_encoding_has_the_layout_that_the_page_expects():
    import base64
    import zlib

    planes = zlib.decompress(base64.b64decode(pack_array(np.array([3, 2, 258], dtype=np.int32))))
    assert list(planes[:3]) == [6, 1, 0]  # +3, -1, +256 with the sign in the last bit: 6, 1, 512
    assert list(planes[3:]) == [0, 0, 2, *[0] * 6]


def test_equal_numbers_have_equal_encodings_and_smooth_ones_short_encodings():
    smooth = (1000.0 * np.sin(np.linspace(0.0, 9.0, 5000))).astype(np.int32)
    assert pack_array(smooth) == pack_array(smooth.copy())
    assert len(pack_array(smooth)) < 0.2 * 4 * len(smooth)


def test_an_array_without_rows_is_encoded():
    assert unpack_array(pack_array(np.zeros((0, 2), dtype=np.int32)), (0, 2)).shape == (0, 2)


@pytest.mark.parametrize("unit", [1e-3, 1e-5])
def test_zero_is_zero(unit):
    assert quantise(0.0, unit) == 0
