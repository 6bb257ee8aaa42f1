"""The end of a validation: the page, the JSON and JUnit files, the printed table, and the exit code."""

from __future__ import annotations

import shlex
import sys
from collections import Counter
from pathlib import Path

import typer
from rich.table import Table

from evalkit.commands.validate.acceptance import AcceptanceReport, Check, CheckOutcome, as_junit
from evalkit.io.json_values import indent_json
from evalkit.io.output_files import write_named_file, write_texts
from evalkit.terminal import progress
from evalkit.terminal.console import out, print_json

HIDDEN: tuple[CheckOutcome, ...] = ("passed", "not judged", "not applicable")
"""Outcomes whose checks are not printed where others failed; the page shows all."""

MAX_LINES = 4
"""Checks of a level in the printed summary of a report with several levels; the page shows all."""


def finish(report: AcceptanceReport, folder: Path, as_json: bool, junit: Path | None) -> None:
    """Write the page and the JSON file, print the report, and exit with code 1 if the claim does not hold."""
    from evalkit.commands.validate import page  # noqa: PLC0415 - imports matplotlib

    content = report.as_json()
    command = "evalkit " + shlex.join(sys.argv[1:])
    write_texts(
        folder,
        {"acceptance.json": indent_json(content), "index.html": page.render_page(report, command)},
    )
    if junit is not None:
        write_named_file(junit, as_junit(report))
    if as_json:
        print_json(content)
    else:
        progress.print_table(out, format_table(report))
        if hidden := _count_hidden(report):
            out.print(f"not shown here: {hidden}")
        out.print(report.verdict)
        if report.why_reference:
            out.print(f"reference {report.reference}: {report.why_reference}")
        if (seed := report.settings.get("seed")) is not None:
            out.print(f"{report.check_count} checks, questions drawn with --seed {seed}")
        out.print(str((folder / "index.html").resolve()))
        if report.next_step:
            out.print(f"next: {report.next_step}")
    if not report.passed:
        raise typer.Exit(1)


def _select_checks(report: AcceptanceReport) -> list[Check]:
    """The checks of a single level to print."""
    (level,) = report.levels
    if not _is_short(report):
        return list(level.checks)
    return [one for one in level.checks if one.outcome not in HIDDEN]


def _is_short(report: AcceptanceReport) -> bool:
    """Whether only some checks are printed: those of a single level of which some refute the claim."""
    return len(report.levels) == 1 and report.levels[0].outcome(report.claim) in ("failed", "not shown")


def _count_hidden(report: AcceptanceReport) -> str:
    """How many checks of a single level are not printed, by outcome; "" if all are."""
    if not _is_short(report):
        return ""
    counts = Counter(one.outcome for one in report.levels[0].checks if one.outcome in HIDDEN)
    return ", ".join(f"{counts[outcome]} {outcome}" for outcome in HIDDEN if counts[outcome])


def format_table(report: AcceptanceReport) -> Table:
    """One row per level; of a single level, one row per check, but if any failed not for those that passed."""
    if len(report.levels) == 1:
        table = Table("check", "outcome", "observed", expand=out.is_terminal)
        for check in _select_checks(report):
            name = f"{check.name}, {check.on}" if check.on else check.name
            table.add_row(name, check.outcome, check.observed)
        return table
    table = Table("level", "outcome", "observed", expand=out.is_terminal)
    for level in report.levels:
        checks = level.decisive_checks(report.claim)
        lines = [f"{one.on + ': ' if one.on else ''}{one.name}: {one.observed}" for one in checks[:MAX_LINES]]
        lines += [f"... and {len(checks) - MAX_LINES} more"] if len(checks) > MAX_LINES else []
        table.add_row(f"{level.number} {level.name}", level.outcome(report.claim), "\n".join(lines))
    return table
