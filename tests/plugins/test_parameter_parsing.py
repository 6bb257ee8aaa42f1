"""Command-line words become values of the declared types; invalid words are named in the error."""

import pytest

from evalkit.core.errors import BadParameter
from evalkit.plugins.parameter_parsing import from_text
from evalkit.plugins.parameters import Parameter

FLAG = Parameter("flag", False, "", "on or off")
PARAMETERS = (FLAG, Parameter("count", 1, "", "how many"), Parameter("far", 1.0, "m", "how far"),
              Parameter("name", "", "", "what it is called"))  # fmt: skip


def test_words_are_converted_to_the_types_of_the_defaults():
    read = from_text("x", PARAMETERS, {"flag": "True", "count": "3", "far": "3", "name": "3"})
    assert [(value, type(value)) for value in read.values()] == [(True, bool), (3, int), (3.0, float), ("3", str)]


def test_a_word_of_the_wrong_type_is_named():
    with pytest.raises(BadParameter, match=r"x: parameter 'count': found '2\.5', expected a whole number"):
        from_text("x", PARAMETERS, {"count": "2.5"})


def test_only_true_and_false_are_booleans():
    assert [from_text("x", PARAMETERS, {"flag": text})["flag"] for text in ("true", "False")] == [True, False]
    with pytest.raises(BadParameter, match="parameter 'flag': found 'no', expected true or false"):
        FLAG.check("x", from_text("x", PARAMETERS, {"flag": "no"})["flag"])


def test_unknown_names_are_kept_for_the_later_check():
    assert from_text("x", PARAMETERS, {"flga": "true"}) == {"flga": "true"}
