"""TOML whose reading would cost far more than its size suggests is rejected."""

import pytest

from evalkit.io.toml import parse_toml


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = " + "[" * 5000, "nested too deeply"),
        ("a" + ".a" * 5000 + " = 1", "a key of 100 or more parts"),
        ("[ 'a' " + ' . "a.b"' * 5000 + "]", "a key of 100 or more parts"),
        ("a = 0x" + "f" * 5000, "an integer of more than 64 bits"),
        ("a = [{ b = 9223372036854775808 }]", "an integer of more than 64 bits"),
        ("a = " + "9" * 5000, "digits"),
        ("a = ", "Invalid value"),
    ],
)
def test_costly_toml_is_rejected(text, message):
    with pytest.raises(ValueError, match=message):
        parse_toml(text)


def test_sentences_and_lists_of_numbers_are_not_long_keys():
    text = f"a = '{'It is so. ' * 500}'\nb = [{'0.1, ' * 500}]\nc = '{'.' * 500}'\nd = '1.5{'.x' * 30}'\n"
    assert parse_toml(text)["b"] == [0.1] * 500
