"""A results.json whose checksums a stranger made again: missing keys and values of another type are refused."""

import copy
import json

import pytest

from evalkit.core.errors import StoreError
from evalkit.report import write_report
from evalkit.results.reader import load_results_json, load_stored_results
from evalkit.results.results_schema import check_schema
from evalkit.results.seal import SHA256, seal


@pytest.fixture(scope="module")
def written(tmp_path_factory, record, build):
    """A results folder of two runs, and the content of its results.json."""
    folder = tmp_path_factory.mktemp("results")
    write_report(build([record(name, "room", {"ate_rmse_m": 0.1}) for name in ("paper", "wheel")]), folder)
    content = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    return folder, {key: value for key, value in content.items() if key != SHA256}


def change(content, place, *value):
    """The content with another value at a place, or without it."""
    changed = copy.deepcopy(content)
    *path, last = place
    node = changed
    for key in path:
        node = node[key]
    if value:
        node[last] = value[0]
    else:
        del node[last]
    return changed


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (("title",), (), "json: no key 'title'"),
        (("runs",), (7,), "runs: found 7, expected array"),
        (("runs", 1), (None,), r"runs\[1\]"),
        (("runs", 0, "scores"), (2**63,), r"runs\[0\].scores: found 9223372036854775808, expected object"),
        (
            ("runs", 0, "scores", "ate_rmse_m", "value"),
            ({"a": 1},),
            r"ate_rmse_m.value: found .*, expected number",
        ),
        (("runs", 0, "scores", "ate_rmse_m", "value"), (10**400,), r"scores.ate_rmse_m.value: found 1000"),
        (("runs", 0, "scans_answered"), (-1,), r"runs\[0\].scans_answered: found -1, expected at least 0"),
        (("runs", 0, "scans_answered"), (True,), r"runs\[0\].scans_answered: found True, expected integer"),
        (("runs", 0, "status"), ("lost",), r"runs\[0\].status: found 'lost', expected one of complete, failed"),
        (("metrics", 0, "name"), (), r"metrics\[0\]: no key 'name'"),
        (("verdicts", 0, "sentences"), ("none",), r"verdicts\[0\].sentences: found 'none', expected array"),
        (("sequences",), (True,), "sequences: found True, expected object"),
    ],
)
def test_a_value_that_no_report_has_is_refused_with_its_place(written, tmp_path, place, value, said):
    _, content = written
    (tmp_path / "results.json").write_text(seal(change(content, place, *value), {}), encoding="utf-8")
    for read in (load_results_json, load_stored_results):
        with pytest.raises(StoreError, match=said):
            read(tmp_path)


def test_what_a_report_wrote_is_accepted(written):
    folder, content = written
    check_schema(content)
    assert load_results_json(folder)["title"] == "Demo"
