"""Times as text to integer nanoseconds."""

import numpy as np
import pytest

from evalkit.io.timestamps import format_stamp, order_stamps, parse_stamp_ns


def test_a_stamp_keeps_every_digit_a_float_would_lose():
    assert parse_stamp_ns("976052857.337284001") == 976052857337284001
    assert parse_stamp_ns("976052857.337284") == 976052857337284000
    assert int(float("976052857.337284001") * 1e9) != 976052857337284001


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0", 0),
        ("4.29497e+09", 4294970000000000000),
        ("-0.96", -960000000),
        ("8.9e-67", 0),
        ("1211.686316", 1211686316000),
    ],
)
def test_odd_spellings_are_read(text, expected):
    assert parse_stamp_ns(text) == expected


@pytest.mark.parametrize("text", ["", "abc", "nan", "inf", "1e999999999", "1e300", "--1"])
def test_text_that_is_not_a_time_is_rejected(text):
    with pytest.raises(ValueError, match="is not a time"):
        parse_stamp_ns(text)


@pytest.mark.parametrize("stamp", [0, 1, -1, 976052857337284001, -(10**9) - 5])
def test_text_and_stamp_are_inverse(stamp):
    assert parse_stamp_ns(format_stamp(stamp)) == stamp


def test_order_keeps_the_first_of_equal_times_and_counts_steps_back():
    order = order_stamps(np.array([10, 30, 20, 30, 20, 40]))
    assert order.keep.tolist() == [0, 2, 1, 5]
    assert (order.backwards, order.repeated) == (2, 2)
