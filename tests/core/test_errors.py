"""Error messages state what is wrong, where, and what to do, and survive pickling between processes."""

import inspect
import pickle

import pytest

from evalkit.core.errors import (
    BadData,
    BadExperiment,
    BadParameter,
    DataMissing,
    EvalkitError,
    NotInstalled,
    StoreError,
    UnknownName,
)

EXAMPLES = {
    UnknownName(
        "backend", "ipc", ["open3d", "icp"]
    ): "no backend named 'ipc' (did you mean 'icp'?); known: icp, open3d",
    UnknownName("seed", "9", [], "x.toml"): "x.toml: no seed named '9'; known: none",
    BadParameter("icp", "radius", "wide", "a number"): "icp: parameter 'radius': found 'wide', expected a number",
    BadExperiment("x.toml", "sequence 2", "missing key 'use'"): "x.toml: sequence 2: missing key 'use'",
    BadExperiment("x.toml", "", "no such file"): "x.toml: no such file",
    BadData("a.log", "line 3", "no number", "take it out"): "a.log: line 3: no number; take it out",
    BadData("a.log", "", "empty", "give a log"): "a.log: empty; give a log",
    DataMissing("intel", "no folder", "fetch it"): "intel: no folder; fetch it",
    NotInstalled("open3d", "no module", "pip install it"): "open3d: no module; pip install it",
    StoreError("/out", "cannot be written", "free some space"): "/out: cannot be written; free some space",
}


@pytest.mark.parametrize(("error", "message"), EXAMPLES.items(), ids=str)
def test_an_error_has_the_same_message_after_pickling(error, message):
    again = pickle.loads(pickle.dumps(error))
    assert str(error) == message
    assert (type(again), str(again), again.args) == (type(error), message, error.args)


@pytest.mark.parametrize("kind", EvalkitError.__subclasses__())
def test_every_error_survives_pickling_with_all_its_arguments(kind):
    told = ("one", "two", "three", "four")[: len(inspect.signature(kind).parameters)]
    error = pickle.loads(pickle.dumps(kind(*told)))
    assert type(error) is kind
    assert all(word in str(error) for word in told if word != "three" or kind is not UnknownName)


def test_a_name_unlike_all_known_names_gets_no_suggestion():
    several = ["ate_max_m", "ate_rmse_m", "cpu_max_ms", "late_percent"]
    assert "'ate' (did you mean 'ate_max_m' or 'ate_rmse_m'?); known" in str(UnknownName("metric", "ate", several))
    assert "(did you mean 'ate_rmse_m'?); known" in str(UnknownName("metric", "rmse", several))
    assert "did you mean" not in str(UnknownName("metric", "", several))
    assert str(UnknownName("mapper", "zzz", ["log-odds"])) == "no mapper named 'zzz'; known: log-odds"


def test_a_message_is_one_line_without_terminal_control_characters():
    told = str(BadData("a\x1b[2J.log", "line 3", "'\x07\n\u2028\u202e\udc80'", "take it out"))
    assert told == r"a\x1b[2J.log: line 3: '\x07\n\u2028\u202e\udc80'; take it out"


def test_a_message_does_not_quote_a_megabyte():
    told = str(BadExperiment("x.toml", "sequence 2", "x" * 1_000_000 + ": remove it"))
    assert told.startswith("x.toml: sequence 2: xxx")
    assert told.endswith("xxx: remove it")
    assert len(told) < 2000
    assert str(BadParameter("icp", "radius", ["wide"] * 999, "a number")).endswith("'wide', 'wide'], expected a number")
