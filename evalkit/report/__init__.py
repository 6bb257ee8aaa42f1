"""The report of an experiment: one offline HTML page, and the same numbers as JSON and CSV for programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from evalkit.io.output_files import write_texts
from evalkit.report.analysis.comparison import Comparison, MethodCard, SequenceCard, Setting
from evalkit.report.assembly import build_comparison
from evalkit.results.results_schema import load_schema
from evalkit.results.seal import seal

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

    files = tables.format_tables(analysis)
    vouched = {name: text.encode() for name, text in files.items()}
    files["results.json"] = seal(results_json.build_results(analysis), vouched, allow_nan=False) + "\n"
    files["results.schema.json"] = load_schema()
    write_texts(folder, {**files, "index.html": render_report(analysis)})
    return folder / "index.html"
