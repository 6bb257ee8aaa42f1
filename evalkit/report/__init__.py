"""The report of an experiment: one offline HTML page, and the same numbers as JSON and CSV for programs."""

from __future__ import annotations

import json
from pathlib import Path

from evalkit.report.analysis.comparison import Comparison, MethodCard, SequenceCard, Setting
from evalkit.report.assembly import build_comparison

__all__ = ["Comparison", "MethodCard", "SequenceCard", "Setting", "build_comparison", "write_report"]


def write_report(comparison: Comparison, folder: Path) -> Path:
    """Write index.html, results.json, its schema and three CSV tables into a folder; return the page's path.

    The page links to ``trajectories/<key>.tum`` and ``maps/<key>.pgm`` in the same folder, which the store writes.
    """
    from evalkit.report import results_json, tables  # noqa: PLC0415 - pandas and matplotlib are slow to load
    from evalkit.report.analysis.analysis import analyse  # noqa: PLC0415
    from evalkit.report.html.report_page import render_report  # noqa: PLC0415

    folder.mkdir(parents=True, exist_ok=True)
    analysis = analyse(comparison)
    text = json.dumps(results_json.build_results(analysis), indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "results.json").write_text(text + "\n", encoding="utf-8")
    (folder / "results.schema.json").write_text(results_json.load_schema(), encoding="utf-8")
    tables.write_tables(analysis, folder)
    index = folder / "index.html"
    index.write_text(render_report(analysis), encoding="utf-8")
    return index
