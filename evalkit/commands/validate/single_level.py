"""The levels of ``evalkit validate --only``: rules, lockstep and determinism, each alone and without a page."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from dataclasses import asdict

import typer
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from evalkit.core.errors import BadParameter
from evalkit.plugins import registry
from evalkit.plugins.parameter_parsing import from_text
from evalkit.terminal import options, progress
from evalkit.terminal.options import err, out


def run_rules(backend: str, given: Mapping[str, str], rules: Iterable[str], limit_s: float, as_json: bool) -> None:
    """Check that a back end keeps the rules of its kind; print the verdicts. Exit code 1 if a rule is broken."""
    from evalkit.commands.validate.rules import runner  # noqa: PLC0415 - loads scipy

    values = from_text(backend, runner.spec_of(backend).parameters, dict(given))
    found = runner.check(backend, values, limit_s=limit_s, only=tuple(rules))
    if as_json:
        options.print_json(asdict(found))
    else:
        table = Table("rule", "outcome", "observed", expand=out.is_terminal)
        for row in found.verdicts:
            expected = f"{row.sentence} Seen: " if row in found.broken else ""
            table.add_row(row.rule, row.outcome, Text(expected + row.observed))  # text from outside is no markup
        progress.print_table(out, table)
        told = f"{found.label}: {len(found.broken)} of {len(found.verdicts)} rules broken"
        out.print(told, markup=False, emoji=False, highlight=False)
    if found.broken:
        raise typer.Exit(1)


def run_lockstep(
    reference: str, backend: str, on: str, given: tuple[Mapping[str, str], Mapping[str, str]], margin: str,
    margin_rad: float | None, margin_log_odds: float, scans: int, disturb: bool, as_json: bool,
) -> None:  # fmt: skip
    """Compare two back ends (or two mappers) answer by answer; print where they first differ. Exit code 1 if they do.

    ``given``: the parameters of the reference and of the back end. ``margin``: "float32", "exact", "auto" or metres.
    """
    from evalkit.commands.validate.equivalence import comparison  # noqa: PLC0415 - loads scipy

    dataset, parameters = _sequence(on)
    mapper = backend in registry.names("mappers")
    metres = 1e-9 if margin in ("exact", "auto") else float(margin) if margin != comparison.FLOAT32 else 0.0
    word = comparison.FLOAT32 if margin == comparison.FLOAT32 else ""
    known = comparison.margin(word, metres, margin_rad, margin_log_odds)
    settings = comparison.settings(reference, backend, dataset, given[0], given[1], parameters, mapper=mapper)
    if mapper:
        found = comparison.mapper_equivalence(reference, backend, dataset, **settings, margin=known, scans=scans)
    else:
        found = comparison.equivalence(
            reference, backend, dataset, **settings, margin=known, scans=scans, disturbed=disturb
        )
    if as_json:
        options.print_json(found.as_json())
    else:
        out.print(str(found), markup=False, emoji=False, highlight=False)
    if not found.equivalent:
        raise typer.Exit(1)


def run_determinism(backends: Iterable[str], on: str, threads: int, repetitions: int, as_json: bool) -> None:
    """Run back ends repeatedly and classify them: bit-equal, thread-dependent or not deterministic.

    Without back ends, every installed one. Exit code 1 if one differs with a single thread.
    """
    from evalkit.commands.validate.determinism import determinism  # noqa: PLC0415 - loads the metrics

    dataset, texts = _sequence(on)
    sequence = registry.dataset(dataset)
    short = {"laps": 0.1} if {p.name for p in sequence.parameters} >= {"laps"} else {}
    parameters = short | dict(from_text(dataset, sequence.parameters, texts))
    names = list(backends) or [name for name in registry.names("backends") if not registry.find_backend(name).missing()]
    table = Table("back end", "answers", "apart [m]", "scans", "why", expand=out.is_terminal)
    found = []
    for name in names:
        err.print(f"{name} ...", markup=False, highlight=False)
        one = determinism(name, dataset, parameters, (1, threads), repetitions)
        found.append(one)
        apart = "-" if one.verdict == "no answer" else f"{one.apart_m:.3g}"
        table.add_row(*map(escape, (name, one.verdict, apart, str(one.scans), one.reason)))
    if as_json:
        options.print_json([asdict(one) for one in found])
    else:
        progress.print_table(out, table)
    if any(one.verdict in ("not deterministic", "no answer") for one in found):
        raise typer.Exit(1)


def _sequence(text: str) -> tuple[str, dict[str, str]]:
    """Return the data set and the parameters of "NAME laps=0.3"."""
    name, *words = shlex.split(text) or [""]
    for word in words:
        if "=" not in word:
            raise BadParameter(name, word, word, "NAME=VALUE after the name of the data set")
    return name, dict(word.split("=", 1) for word in words)
