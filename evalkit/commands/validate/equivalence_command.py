"""``evalkit equiv``: where two implementations first differ, and why."""

from __future__ import annotations

from typing import Annotated

import typer

from evalkit.terminal import options
from evalkit.terminal.options import Json, out


def equiv(
    a: Annotated[str, typer.Argument(help="A registered name, or module:SPEC.", show_default=False)],
    b: Annotated[str, typer.Argument(help="What is held against it.", show_default=False)],
    on: Annotated[str, typer.Option(help="The sequence both are asked about.")] = "room",
    set_a: Annotated[list[str] | None, typer.Option(help="NAME=VALUE for A.")] = None,
    set_b: Annotated[list[str] | None, typer.Option(help="NAME=VALUE for B.")] = None,
    set_on: Annotated[list[str] | None, typer.Option(help="NAME=VALUE for the sequence.")] = None,
    margin: Annotated[str, typer.Option(help="float32: what rounding to it may do, computed.")] = "",
    margin_m: Annotated[float, typer.Option(help="Metres that do not count.")] = 1e-9,
    margin_rad: Annotated[float | None, typer.Option(help="Radians.", show_default="metres, felt at 1 m")] = None,
    margin_log_odds: Annotated[float, typer.Option(help="Log-odds, for mappers.")] = 1e-5,
    scans: Annotated[int, typer.Option(min=3, help="How many scans.")] = 30,
    disturb: Annotated[bool, typer.Option(help="Ask again with guesses that are off.")] = True,
    mapper: Annotated[bool, typer.Option("--mapper", help="A and B are mappers.")] = False,
    as_json: Json = False,
) -> None:
    """Find where two back ends (or mappers) first differ, and why; 0 if equivalent within the margin, 1 if not."""
    from evalkit.commands.validate.equivalence import comparison as equivalence  # noqa: PLC0415 - loads scipy.stats: only who compares pays for it

    options.modules_from_here()
    known = equivalence.margin(margin, margin_m, margin_rad, margin_log_odds)
    read = map(options.settings, (set_a or [], set_b or [], set_on or []))
    given = equivalence.settings(a, b, on, *read, mapper=mapper)
    if mapper:
        found = equivalence.mapper_equivalence(a, b, on, **given, margin=known, scans=scans)
    else:
        found = equivalence.equivalence(a, b, on, **given, margin=known, scans=scans, disturbed=disturb)
    if as_json:
        options.print_json(found.as_json())
    else:
        out.print(str(found), markup=False, emoji=False, highlight=False)
    if not found.equivalent:
        raise typer.Exit(1)
