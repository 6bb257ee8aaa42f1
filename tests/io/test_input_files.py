"""Files a user names: what is no TOML is told as such, whatever it would have done to the reader."""

import pytest

from evalkit.io.input_files import tables_of


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a = " + "[" * 5000, "nested too deeply"),
        ("a" + ".a" * 5000 + " = 1", "a key of a hundred parts"),
        ("[ 'a' " + ' . "a.b"' * 5000 + "]", "a key of a hundred parts"),
        ("a = 0x" + "f" * 5000, "a whole number of more than 64 bits"),
        ("a = [{ b = 9223372036854775808 }]", "a whole number of more than 64 bits"),
        ("a = " + "9" * 5000, "digits"),
        ("a = ", "Invalid value"),
    ],
)
def test_what_would_cost_more_than_its_size_is_no_toml(text, told):
    with pytest.raises(ValueError, match=told):
        tables_of(text)


def test_sentences_and_lists_of_numbers_are_no_long_keys():
    text = f"a = '{'It is so. ' * 500}'\nb = [{'0.1, ' * 500}]\nc = '{'.' * 500}'\nd = '1.5{'.x' * 30}'\n"
    assert tables_of(text)["b"] == [0.1] * 500
