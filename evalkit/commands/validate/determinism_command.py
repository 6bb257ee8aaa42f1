"""``evalkit determinism``: does a back end give the same answers when it is asked again?"""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from evalkit.plugins import registry
from evalkit.plugins.parameter_parsing import from_text
from evalkit.terminal import options, progress
from evalkit.terminal.options import Json, err, out


def determinism(
    backends: Annotated[list[str] | None, typer.Argument(help="Back ends.", show_default="all installed")] = None,
    on: Annotated[str, typer.Option(help="The sequence they follow.")] = "room",
    setting: Annotated[list[str] | None, typer.Option("--set", help="NAME=VALUE for the sequence.")] = None,
    threads: Annotated[int, typer.Option(min=2, help="Threads that libraries may start, beside one.")] = 2,
    repetitions: Annotated[int, typer.Option(min=2, help="How often each.")] = 2,
    as_json: Json = False,
) -> None:
    """Tell bit-equal, thread-dependent and not deterministic back ends apart; 1 if one differs with one thread."""
    from evalkit.commands.validate import determinism as validation  # noqa: PLC0415 - loads the runner: only who asks pays

    options.modules_from_here()
    sequence = registry.dataset(on)
    given = {"laps": 0.1} if {p.name for p in sequence.parameters} >= {"laps"} else {}
    settings = given | dict(from_text(on, sequence.parameters, options.settings(setting or [])))
    names = backends or [name for name in registry.names("backends") if not registry.entrant(name).missing()]
    table = Table("back end", "answers", "apart [m]", "scans", "why", expand=out.is_terminal)
    found = []
    for name in names:
        err.print(f"{name} ...", markup=False, highlight=False)
        one = validation.determinism(name, on, settings, (1, threads), repetitions)
        found.append(one)
        apart = "-" if one.verdict == "no answer" else f"{one.apart_m:.3g}"
        table.add_row(*map(escape, (name, one.verdict, apart, str(one.scans), one.reason)))
    if as_json:
        options.print_json([asdict(one) for one in found])
    else:
        progress.show(out, table)
    if any(one.verdict in ("not deterministic", "no answer") for one in found):
        raise typer.Exit(1)
