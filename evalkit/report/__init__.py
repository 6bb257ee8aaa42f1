"""The report of an experiment: one offline HTML page, and the same numbers as JSON and CSV for programs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from evalkit.report.analysis.comparison import Comparison, MethodCard, SequenceCard, Setting
from evalkit.report.assembly import build_comparison

if TYPE_CHECKING:
    from evalkit.report.analysis.analysis import Analysis

__all__ = ["Comparison", "MethodCard", "SequenceCard", "Setting", "build_comparison", "write_analysis", "write_report"]


def write_report(comparison: Comparison, folder: Path) -> Path:
    """Analyse a comparison and write its report; see ``write_analysis``."""
    from evalkit.report.analysis.analysis import analyse  # noqa: PLC0415 - slow to load

    return write_analysis(analyse(comparison), folder)


def write_analysis(analysis: Analysis, folder: Path) -> Path:
    """Write index.html, results.json, its schema and three CSV tables into a folder; return the page's path.

    The page links to ``trajectories/<key>.tum`` and ``maps/<key>.pgm`` in the same folder, which the store writes.
    """
    from evalkit.report import results_json, tables  # noqa: PLC0415 - pandas and matplotlib are slow to load
    from evalkit.report.html.report_page import render_report  # noqa: PLC0415

    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps(results_json.build_results(analysis), indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "results.json").write_text(text + "\n", encoding="utf-8")
    (folder / "results.schema.json").write_text(results_json.load_schema(), encoding="utf-8")
    tables.write_tables(analysis, folder)
    index = folder / "index.html"
    index.write_text(render_report(analysis), encoding="utf-8")
    return index
