"""A comparison as one offline HTML file that a stranger can believe, with the same numbers for programs beside it."""

from __future__ import annotations

import json
from pathlib import Path

from evalkit.report.analysis.comparison import Comparison, MethodCard, SequenceCard, Setting
from evalkit.report.assembly import comparison_of

__all__ = ["Comparison", "MethodCard", "SequenceCard", "Setting", "comparison_of", "write"]


def write(comparison: Comparison, folder: Path) -> Path:
    """The path of index.html, written with results.json, its schema and three CSV tables into a folder.

    The page links to ``trajectories/<key>.tum`` and ``maps/<key>.pgm`` in the same folder, which the store writes.
    """
    from evalkit.report import results_json, tables  # noqa: PLC0415 - pandas and matplotlib are slow to load
    from evalkit.report.analysis import overview, verdict  # noqa: PLC0415 - pandas and matplotlib are slow to load
    from evalkit.report.html import page  # noqa: PLC0415 - pandas and matplotlib are slow to load

    folder.mkdir(parents=True, exist_ok=True)
    verdicts = [verdict.verdict(comparison, sequence) for sequence in comparison.sequence_labels]
    sentences = overview.overview(comparison, verdicts)
    results = results_json.results(comparison, sentences, verdicts)
    text = json.dumps(results, indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "results.json").write_text(text + "\n", encoding="utf-8")
    (folder / "results.schema.json").write_text(results_json.schema(), encoding="utf-8")
    tables.write_csv(comparison, folder)
    index = folder / "index.html"
    index.write_text(page.render(comparison, sentences, verdicts), encoding="utf-8")
    return index
