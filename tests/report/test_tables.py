"""Machine-readable tables contain exactly the scores."""

import csv
import json
from dataclasses import replace

import pytest

from evalkit.core.run_status import Cause
from evalkit.report import write_report


@pytest.fixture(scope="module")
def folder(demo, tmp_path_factory):
    return write_report(demo, tmp_path_factory.mktemp("report")).parent


def _rows(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_runs_csv_contains_every_run_and_every_score(folder, demo):
    rows = _rows(folder / "runs.csv")
    assert [row["key"] for row in rows] == [record.key for record in demo.records]
    for row, record in zip(rows, demo.records, strict=True):
        assert (row["status"], row["reason"], row["command"]) == (
            record.result.status,
            record.result.reason,
            record.command,
        )
        assert row["seed"] == ("" if record.seed is None else str(record.seed))
        for metric in demo.metrics:
            score = record.scores.by_metric.get(metric.name)
            value = None if score is None else score.value
            assert (float(row[metric.name]) if row[metric.name] else None) == value


def test_scores_csv_contains_the_reason_of_a_missing_value(folder, demo):
    rows = _rows(folder / "scores.csv")
    assert len(rows) == sum(len(record.scores.by_metric) for record in demo.records)
    empty = [row for row in rows if not row["value"]]
    assert empty
    assert all(row["reason"] for row in empty)


def test_summary_csv_has_medians_over_complete_runs_only(folder):
    found = {(r["method"], r["metric"]): r for r in _rows(folder / "summary.csv") if r["sequence"] == "room"}
    plane = found["plane", "ate_rmse_m"]
    assert float(plane["median"]) == pytest.approx(0.011 * 1.03)
    assert [float(plane[k]) for k in ("lowest", "highest")] == pytest.approx([0.011, 0.011 * 1.06])
    assert (plane["rank"], plane["mark"]) == ("1", "best")
    survivor = found["<script>alert(1)</script>", "ate_rmse_m"]
    assert [survivor[k] for k in ("runs_complete", "runs_expected", "rank")] == ["1", "3", ""]


def test_results_json_contains_the_same_scores(folder, demo):
    results = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert results["schema"] == {"name": "evalkit-results", "version": 4}
    for row, record in zip(results["runs"], demo.records, strict=True):
        assert row["scores"] == {
            name: {"value": score.value, "support": score.support, "reason": score.reason}
            for name, score in record.scores.by_metric.items()
        }
        assert row["scans_answered"] == len(record.result.steps)


def test_results_json_conforms_to_the_schema_next_to_it(folder):
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads((folder / "results.schema.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(json.loads((folder / "results.json").read_text(encoding="utf-8")), schema)


def test_the_same_comparison_writes_the_same_files(folder, demo, tmp_path):
    again = write_report(demo, tmp_path / "again").parent
    for path in folder.iterdir():
        assert (again / path.name).read_bytes() == path.read_bytes(), path.name


def test_a_comparison_with_a_duplicate_run_raises(record, build):
    with pytest.raises(ValueError, match="a over room with seed 0 occurs twice"):
        build([record("a", "room", {}), record("a", "room", {})])


@pytest.mark.parametrize("reason", ["=HYPERLINK(1)", "+1", "-1+2", "@sum", "\tx"])
def test_a_text_that_a_spreadsheet_would_compute_is_marked(demo, tmp_path, reason):
    first, *others = demo.records
    failed = replace(first.result, cause=Cause.EXCEPTION, reason=reason)
    write_report(replace(demo, records=(replace(first, result=failed), *others)), tmp_path)
    with (tmp_path / "runs.csv").open(encoding="utf-8", newline="") as file:
        assert f"'{reason}" in {row["reason"] for row in csv.DictReader(file)}
