"""``evalkit check``: the conformance kit over one back end."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from evalkit.commands.validate.rules import runner as conformance
from evalkit.plugins.parameter_parsing import from_text
from evalkit.terminal import options, progress
from evalkit.terminal.options import Json, out


def check(
    backend: Annotated[str, typer.Argument(help="A registered name, or module:SPEC.", show_default=False)],
    setting: Annotated[list[str] | None, typer.Option("--set", help="NAME=VALUE for the back end.")] = None,
    rule: Annotated[list[str] | None, typer.Option(help="Ask this rule only.", show_default="all")] = None,
    limit: Annotated[float, typer.Option(min=0.1, help="Seconds that one rule may take.")] = 30.0,
    as_json: Json = False,
) -> None:
    """Check that a back end keeps the rules all others keep: known answers, units, frames, no crash, no leak."""
    options.modules_from_here()
    values = from_text(backend, conformance.spec_of(backend).parameters, options.settings(setting or []))
    found = conformance.check(backend, values, limit_s=limit, only=rule or ())
    if as_json:
        options.print_json(asdict(found))
    else:
        table = Table("rule", "outcome", "what was seen", expand=out.is_terminal)
        for row in found.verdicts:
            asked = f"{row.sentence} Seen: " if row in found.broken else ""
            table.add_row(row.rule, row.outcome, Text(asked + row.observed))  # others' words are no markup
        progress.show(out, table)
        told = f"{found.label}: {len(found.broken)} of {len(found.verdicts)} rules broken"
        out.print(told, markup=False, emoji=False, highlight=False)
    if found.broken:
        raise typer.Exit(1)
