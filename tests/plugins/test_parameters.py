"""Parameters: types, bounds, defaults, and their declaration as dataclass fields."""

import math
from dataclasses import dataclass, replace

import pytest

from evalkit.core.errors import BadParameter, UnknownName
from evalkit.odometry.frontend import complete_parameters
from evalkit.plugins import registry
from evalkit.plugins.parameters import (
    Parameter,
    check_fields,
    declared_parameters,
    parameter,
    resolve_parameters,
    split_settings,
    with_defaults,
)
from evalkit.plugins.specs import nothing_missing

FLAG = Parameter("flag", True, "", "on or off")
COUNT = Parameter("count", 3, "", "how many", low=1, high=9)
WIDTH = Parameter("width", 0.5, "m", "how wide", low=0.0, high=2.0)
KIND = Parameter("kind", "near", "", "which", choices=("near", "far"))
ALL = (FLAG, COUNT, WIDTH, KIND)


@pytest.mark.parametrize(
    ("parameter", "value", "expected"),
    [(FLAG, False, False), (COUNT, 1, 1), (COUNT, 9, 9), (WIDTH, 2, 2.0), (WIDTH, 0.0, 0.0), (KIND, "far", "far")],
)
def test_a_valid_value_is_converted_to_the_type_of_the_default(parameter, value, expected):
    found = parameter.check("icp", value)
    assert (found, type(found)) == (expected, type(parameter.default))


@pytest.mark.parametrize(
    ("parameter", "value", "message"),
    [
        (FLAG, 1, "icp: parameter 'flag': found 1, expected true or false (on or off)"),
        (FLAG, "true", "icp: parameter 'flag': found 'true', expected true or false (on or off)"),
        (COUNT, True, "icp: parameter 'count': found True, expected a whole number (how many)"),
        (COUNT, 2.0, "icp: parameter 'count': found 2.0, expected a whole number (how many)"),
        (COUNT, 10, "icp: parameter 'count': found 10, expected a number within [1, 9]"),
        (WIDTH, True, "icp: parameter 'width': found True, expected a number (how wide)"),
        (WIDTH, "2", "icp: parameter 'width': found '2', expected a number (how wide)"),
        (WIDTH, -0.1, "icp: parameter 'width': found -0.1, expected a number within [0, 2] m"),
        (WIDTH, math.nan, "icp: parameter 'width': found nan, expected a number within [0, 2] m"),
        (KIND, "wide", "icp: parameter 'kind': found 'wide', expected one of near, far"),
        (KIND, 3, "icp: parameter 'kind': found 3, expected a text (which)"),
        (KIND, ["far"], "icp: parameter 'kind': found ['far'], expected a text (which)"),
    ],
)
def test_an_invalid_value_is_rejected_by_name(parameter, value, message):
    with pytest.raises(BadParameter) as caught:
        parameter.check("icp", value)
    assert str(caught.value) == message


def test_a_missing_value_keeps_its_default():
    assert resolve_parameters("icp", ALL, {"width": 1}) == {"flag": True, "count": 3, "width": 1.0, "kind": "near"}


def test_a_name_given_twice_is_refused_even_with_the_same_value():
    assert split_settings("--set", ["a=1", "b=x=y"]) == {"a": "1", "b": "x=y"}
    for second in ("a=2", "a=1"):
        with pytest.raises(
            BadParameter, match=r"--set: parameter 'a': found '\d', expected one value, but '1' is given"
        ):
            split_settings("--set", ["a=1", "b=x", second])


def test_an_unknown_parameter_suggests_the_nearest_name():
    with pytest.raises(UnknownName) as caught:
        resolve_parameters("icp", ALL, {"widht": 1.0})
    known = "known: count, flag, kind, width"
    assert str(caught.value) == f"icp: no parameter named 'widht' (did you mean 'width'?); {known}"


def test_a_variant_differs_only_in_its_defaults():
    variant = with_defaults(ALL, count=7)
    assert resolve_parameters("icp", variant, {}) == {"flag": True, "count": 7, "width": 0.5, "kind": "near"}
    assert variant[1].high == COUNT.high
    assert COUNT.default == 3
    with pytest.raises(UnknownName, match="no parameter named 'cuont'"):
        with_defaults(ALL, cuont=7)
    with pytest.raises(UnknownName, match="no parameter named 'parameters'"):
        with_defaults(ALL, parameters=7)


def test_a_plug_in_without_requirements_is_available():
    assert nothing_missing(path="x") == ""


@dataclass(frozen=True)
class Settings:
    width: float = parameter(0.5, "m", "how wide", low=0.0, high=2.0)
    kind: str = parameter("near", "", "which", choices=("near", "far"))
    cache: int = 0


@dataclass(frozen=True)
class MoreSettings(Settings):
    count: int = parameter(3, "", "how many", low=1, high=9)


def test_parameters_are_declared_as_fields_of_a_dataclass():
    assert declared_parameters(Settings) == (WIDTH, KIND)
    assert declared_parameters(MoreSettings) == (WIDTH, KIND, COUNT)
    assert Settings() == Settings(0.5, "near")


def test_fields_are_checked_and_converted_in_place():
    settings = MoreSettings(width=1)
    check_fields("icp", settings)
    assert (settings.width, type(settings.width)) == (1.0, float)
    with pytest.raises(BadParameter, match="icp: parameter 'count': found 10"):
        check_fields("icp", MoreSettings(count=10))


def test_a_name_that_is_declared_twice_is_an_error():
    with pytest.raises(
        BadParameter, match="icp: parameter 'count': found 'two of this name', expected one: rename that"
    ):
        resolve_parameters("icp", (*ALL, Parameter("count", 4, "", "again")), {})


def test_a_registration_cannot_have_a_parameter_of_the_front_end():
    spec = registry.backend("paper")
    with pytest.raises(BadParameter, match="mine: parameter 'keyframes': found 'two of this name'"):
        complete_parameters("mine", replace(spec, parameters=(Parameter("keyframes", 4, "", "own"),)), {})


def test_parameters_of_a_class_that_is_no_dataclass_are_an_error_that_says_so():
    class Mine:
        width: float = parameter(0.5, "m", "how wide")

    with pytest.raises(TypeError, match=r"^Mine declares parameters but is no dataclass: is @dataclass missing\?$"):
        declared_parameters(Mine)
