"""TOML whose reading would cost far more than its size suggests is rejected."""

import pytest

from evalkit.core.errors import BadExperiment
from evalkit.io.toml import load_toml, parse_toml


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


def test_a_byte_order_mark_is_read_over_and_another_encoding_is_named(tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(b'\xef\xbb\xbftitle = "x"\r\n')
    assert load_toml(path, "a study") == {"title": "x"}
    path.write_text('title = "x"\n', encoding="utf-16")
    with pytest.raises(BadExperiment, match=r"a\.toml: not UTF-8 text at byte 0; save it as UTF-8"):
        load_toml(path, "a study")


def test_sentences_and_lists_of_numbers_are_not_long_keys():
    text = f"a = '{'It is so. ' * 500}'\nb = [{'0.1, ' * 500}]\nc = '{'.' * 500}'\nd = '1.5{'.x' * 30}'\n"
    assert parse_toml(text)["b"] == [0.1] * 500
