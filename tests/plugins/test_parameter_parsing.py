"""Command-line words become values of the declared types; invalid words are named in the error."""

import pytest

from evalkit.core.errors import BadParameter, UnknownName
from evalkit.plugins.parameter_parsing import from_text, parse_dataset, parse_dataset_without_seed
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


@pytest.mark.parametrize("word", ["seeds=3", "use=lab", "label=hello", "confirm=1"])
def test_a_key_of_an_experiment_file_is_no_parameter_of_a_data_set(word):
    name = word.split("=")[0]
    with pytest.raises(UnknownName, match=f"room: no parameter named '{name}'"):
        parse_dataset(f"room {word}")
    with pytest.raises(UnknownName, match=f"room: no parameter named '{name}'"):
        parse_dataset("room", dict([word.split("=")]))


def test_a_parameter_of_a_data_set_is_given_once():
    with pytest.raises(BadParameter, match=r"room: parameter 'laps': found '0\.2', expected one value, but '0\.1' is"):
        parse_dataset("room laps=0.1 laps=0.2")


def test_parameters_of_a_data_set_replace_the_shared_ones():
    assert parse_dataset("lab laps=0.1", {"laps": "0.05", "rate_hz": "5"}) == ("lab", {"laps": 0.1, "rate_hz": 5.0})


def test_where_a_command_chooses_the_seeds_the_error_says_where_they_come_from():
    assert parse_dataset_without_seed("room laps=0.1", "--seeds N sets them") == ("room", {"laps": 0.1})
    with pytest.raises(BadParameter, match=r"room: parameter 'seed': found 3, expected none here: --seeds N sets them"):
        parse_dataset_without_seed("room seed=3", "--seeds N sets them")
