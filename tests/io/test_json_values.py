"""Values and text of JSON files."""

import json
import math

import numpy as np

from evalkit.io.json_values import indent_json, replace_non_finite


def test_a_number_that_is_not_finite_is_null_however_deep_it_lies():
    value = {1: (math.nan, [math.inf, 2.0]), "b": {"c": np.float64("-inf"), "d": "nan", "e": 3, "f": None, "g": True}}
    expected = {"1": [None, [None, 2.0]], "b": {"c": None, "d": "nan", "e": 3, "f": None, "g": True}}
    assert replace_non_finite(value) == expected
    assert json.loads(indent_json(replace_non_finite(value))) == expected
