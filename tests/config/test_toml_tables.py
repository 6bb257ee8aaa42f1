"""The checked tables of configuration files."""

import pytest

from evalkit.config.forms import Form, Key
from evalkit.config.toml_tables import TomlTable, flatten
from evalkit.core.errors import BadExperiment, UnknownName

FORM = Form(keys={
    "on": Key("flag", default=True), "size": Key("number", low=1.0), "plain": Key("number"), "limit": Key("positive"),
    "count": Key("whole"), "points": Key("whole", default=7, low=3, high=5000),
    "seeds": Key("wholes", default=[0]),
    "kind": Key("text"), "part": Key("tables", form=Form(keys={"x": Key("whole", default=5)})),
})  # fmt: skip


def table(**content):
    return TomlTable(content, "file.toml", "part 1", FORM)


@pytest.mark.parametrize(
    ("read", "message"),
    [
        (lambda: table().text("use"), "part 1: missing key 'use'"),
        (lambda: table(use=3).text("use"), "part 1: 'use': found 3, expected a text"),
        (lambda: table(on=1).flag("on"), "'on': found 1, expected true or false"),
        (lambda: table(plain=True).number("plain"), "'plain': found True, expected a number"),
        (lambda: table(size=0.5).number("size"), "'size': found 0.5, expected a number from 1"),
        (lambda: table(size=float("inf")).number("size"), "'size': found inf, expected a number from 1"),
        (lambda: table(limit=0).positive_number("limit"), "'limit': found 0, expected a positive number"),
        (lambda: table(points=2).whole_number("points"), "'points': found 2, expected a whole number from 3"),
        (lambda: table(points=5001).whole_number("points"), "found 5001, expected a whole number from 3 to 5000"),
        (lambda: table(count=2.0).whole_number("count"), "'count': found 2.0, expected a whole number from 0"),
        (lambda: table(seeds=[]).whole_numbers("seeds"), "found [], expected a list of whole numbers from 0, at least"),
        (lambda: table(seeds=[True]).whole_numbers("seeds"), "'seeds': found [True], expected a list of whole"),
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
    content = table(use="a", count=3, size=2, seeds=[4, 4, 5], part=[{"x": 1}, {}])
    assert (content.text("use"), content.text("label", "b")) == ("a", "b")
    assert (content.whole_number("count"), content.whole_number("points")) == (3, 7)
    assert (content.number("size"), content.whole_numbers("seeds")) == (2.0, (4, 5))
    assert [(part.place, part.whole_number("x")) for part in content.tables("part")] == [("part 1", 1), ("part 2", 5)]
    assert content.with_label("a").place == "part 1 (a)"


def test_an_unknown_name_within_a_table_is_an_error_of_that_table():
    with pytest.raises(BadExperiment, match="part 1: no back end named 'x'"), table().errors():
        raise UnknownName("back end", "x", [])


def test_nested_tables_are_flattened_to_dotted_names():
    assert flatten({"a": {"b": 1, "c": {"d": 2}}, "e": 3}) == {"a.b": 1, "a.c.d": 2, "e": 3}
