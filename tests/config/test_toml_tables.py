"""The checked tables of configuration files."""

import pytest

from evalkit.config.toml_tables import TomlTable, flatten
from evalkit.core.errors import BadExperiment, UnknownName


def table(**content):
    return TomlTable(content, "file.toml", "part 1")


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (lambda: table().text("use"), "part 1: missing key 'use'"),
        (lambda: table(use=3).text("use"), "part 1: 'use': found 3, expected a text"),
        (lambda: table(on=1).flag("on", default=True), "'on': found 1, expected true or false"),
        (lambda: table(size=True).number("size"), "'size': found True, expected a number"),
        (lambda: table(size=0.5).number("size", low=1.0), "'size': found 0.5, expected a number from 1"),
        (lambda: table(size=float("inf")).number("size", low=1.0), "'size': found inf, expected a number from 1"),
        (lambda: table(count=2.0).whole_number("count"), "'count': found 2.0, expected a whole number from 0"),
        (lambda: table(seeds=[]).whole_numbers("seeds", [0]), "'seeds': found [], expected a list of whole numbers"),
        (lambda: table(seeds=[True]).whole_numbers("seeds", [0]), "'seeds': found [True], expected a list of whole"),
        (lambda: table(kind=["a"]).choice("kind", "kind", {"a": 1}), "no kind named '['a']'; known: a"),
        (lambda: table(kind="grod").choice("kind", "kind", {"grid": 1}), "no kind named 'grod' (did you mean 'grid'?)"),
        (lambda: table(part=3).table("part", " with use = NAME"), "file.toml: part: found 3, expected a table [part]"),
        (lambda: table(part={}).tables("part"), "file.toml: part: expected tables [[part]]"),
        (lambda: table().tables("part", "a study"), "file.toml: no [[part]]: a study needs at least one"),
        (lambda: table(seed=1).check_keys(["seeds"]), "no key named 'seed' (did you mean 'seeds'?); known: seeds"),
    ],
)
def test_an_error_names_file_table_key_what_was_found_and_what_is_expected(read, message):
    with pytest.raises(BadExperiment) as caught:
        read()
    assert str(caught.value).startswith("file.toml: ")
    assert message in str(caught.value)


def test_correct_values_and_defaults_are_returned():
    content = table(use="a", count=3, size=2, seeds=[4, 4, 5], part=[{"x": 1}, {"x": 2}])
    assert (content.text("use"), content.text("label", "b")) == ("a", "b")
    assert (content.whole_number("count", low=3), content.whole_number("other", 7)) == (3, 7)
    assert (content.number("size"), content.whole_numbers("seeds", [0])) == (2.0, (4, 5))
    assert [part.place for part in content.tables("part")] == ["part 1", "part 2"]
    assert content.labelled("a").place == "part 1 (a)"


def test_an_unknown_name_within_a_table_is_an_error_of_that_table():
    with pytest.raises(BadExperiment, match="part 1: no back end named 'x'"), table().errors():
        raise UnknownName("back end", "x", [])


def test_nested_tables_are_flattened_to_dotted_names():
    assert flatten({"a": {"b": 1, "c": {"d": 2}}, "e": 3}) == {"a.b": 1, "a.c.d": 2, "e": 3}
