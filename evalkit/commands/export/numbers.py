"""Export the report's numbers for the selected sequences and methods: CSV tables, results.json and its schema."""

from __future__ import annotations

import csv
import io
import json

from evalkit.commands.export.latex import Files
from evalkit.commands.export.results import ExportSelection
from evalkit.core.errors import StoreError
from evalkit.results.reader import REMEDY, load_table
from evalkit.results.results_schema import load_schema

TABLES = ("runs.csv", "scores.csv", "summary.csv")


def format_csv(results: ExportSelection) -> Files:
    """Yield the tables that the report wrote, with the rows of the selected sequences and methods unchanged.

    Raises StoreError if a table cannot be read.
    """
    selected = _selected_pairs(results)
    for name in TABLES:
        path = results.folder / name
        columns, rows = load_table(path)
        try:
            kept = [row for row in rows if (row["sequence"], row["method"]) in selected]
        except KeyError as error:
            raise StoreError(str(path), f"has no column {error}", REMEDY) from error
        text = io.StringIO()
        writer = csv.DictWriter(text, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(kept)
        yield name, text.getvalue().encode()


def format_json(results: ExportSelection) -> Files:
    """Yield ``results.json`` with the selected sequences and methods, and its schema.

    Statements on a sequence are left out if a method that ran over it is not selected: they compare all methods.
    """
    content, selected = dict(results.content), _selected_pairs(results)
    every = {(one["sequence"], one["method"]) for one in content["runs"]}
    cut = {sequence for sequence, _ in every - selected}
    sequences, methods = {sequence for sequence, _ in selected}, {method for _, method in selected}
    for name in ("runs", "intervals", "differences"):
        content[name] = [one for one in content.get(name, ()) if (one["sequence"], one["method"]) in selected]
    content["verdicts"] = [one for one in content["verdicts"] if one["sequence"] in sequences - cut]
    if cut:
        content["overview"] = []
        content.pop("answer", None)
    content["sequences"] = {label: card for label, card in content["sequences"].items() if label in sequences}
    content["methods"] = {label: card for label, card in content["methods"].items() if label in methods}
    yield "results.json", (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
    yield "results.schema.json", load_schema().encode()


def _selected_pairs(results: ExportSelection) -> set[tuple[str, str]]:
    """Return sequence and method of every row."""
    return {(row.sequence, row.method) for row in results.rows}
