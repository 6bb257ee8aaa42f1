"""The report's own numbers: its three tables as CSV, results.json with its schema, of whom and what is wanted."""

from __future__ import annotations

import csv
import io
import json

from evalkit.commands.export.latex import Files
from evalkit.commands.export.results import AGAIN, Results
from evalkit.core.errors import StoreError
from evalkit.report.results_json import schema

TABLES = ("trials.csv", "scores.csv", "summary.csv")


def as_csv(results: Results) -> Files:
    """The tables the report has written, their rows of the wanted sequences and methods as they are."""
    kept = _pairs(results)
    for name in TABLES:
        path = results.folder / name
        try:
            with path.open(encoding="utf-8", newline="") as file:
                heading, *rows = csv.reader(file)
            who, where = heading.index("method"), heading.index("sequence")
            wanted = [row for row in rows if (row[where], row[who]) in kept]
        except (OSError, ValueError, IndexError, csv.Error) as error:
            raise StoreError(str(path), f"cannot be read ({error})", AGAIN) from error
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([heading, *wanted])
        yield name, text.getvalue().encode()


def as_json(results: Results) -> Files:
    """``results.json`` with what belongs to the wanted sequences and methods, and its schema.

    What is said of a sequence is left out where not all who ran over it are wanted: it compares them all.
    """
    content, kept = dict(results.content), _pairs(results)
    every = {(one["sequence"], one["method"]) for one in content["trials"]}
    cut = {sequence for sequence, _ in every - kept}
    sequences, methods = {sequence for sequence, _ in kept}, {method for _, method in kept}
    for name in ("trials", "intervals", "differences"):
        content[name] = [one for one in content.get(name, ()) if (one["sequence"], one["method"]) in kept]
    content["verdicts"] = [one for one in content["verdicts"] if one["sequence"] in sequences - cut]
    content["overview"] = [] if cut else content["overview"]
    content["sequences"] = {label: card for label, card in content["sequences"].items() if label in sequences}
    content["methods"] = {label: card for label, card in content["methods"].items() if label in methods}
    yield "results.json", (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()
    yield "results.schema.json", schema().encode()


def _pairs(results: Results) -> set[tuple[str, str]]:
    """Wanted sequence and method, of every row."""
    return {(cell.sequence, cell.method) for cell in results.cells}
