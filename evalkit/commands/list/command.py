"""``evalkit list``: list back ends, mappers, data sets and metrics, or print the card of a metric."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from evalkit.commands.list import inventory
from evalkit.core.errors import UnknownName
from evalkit.terminal import options, progress
from evalkit.terminal.options import out

if TYPE_CHECKING:
    from evalkit.metrics.table import Metric

METRICS, ALL = "metrics", "all"


def _complete(incomplete: str) -> list[str]:
    kinds = [name for name in (*inventory.KINDS, METRICS, ALL) if name.startswith(incomplete)]
    return kinds or options.complete_metric(incomplete)


def list_names(
    what: Annotated[
        str,
        typer.Argument(
            help="backends, mappers, datasets, metrics, all, or the name of a metric.",
            show_default="backends, mappers and datasets",
            autocompletion=_complete,
        ),
    ] = "",
    group: Annotated[str, typer.Option(help="Only metrics of this group.", show_default="all")] = "",
    as_json: options.Json = False,
) -> None:
    """List back ends, mappers, data sets and metrics, or print the card of a metric.

    The lists of plug-ins say what is missing on this machine, and how to install it.
    """  # fmt: skip
    if group and what not in (METRICS, ALL):
        raise typer.BadParameter("--group: needs 'metrics'")
    if what not in ("", METRICS, ALL, *inventory.KINDS):
        _print_card(what, as_json)
        return
    kinds = [kind for kind in inventory.KINDS if what in ("", ALL, kind)]
    found = {kind: inventory.find_entries(kind) for kind in kinds}
    metrics = _metrics(group) if what in (METRICS, ALL) else ()
    if as_json:
        content: dict[str, Any] = {kind: [asdict(entry) for entry in entries] for kind, entries in found.items()}
        options.print_json(content | ({METRICS: _cards(metrics)} if metrics else {}))
        return
    for kind, entries in found.items():
        _print_table(kind, ("name", "summary", "missing"), [(e.name, e.summary, e.missing or "-") for e in entries])
    if metrics:
        rows = [(m.name, m.label, m.unit or "-", m.better or "-", m.group) for m in metrics]
        _print_table(METRICS, ("name", "label", "unit", "better", "group"), rows)
    if not what:
        out.print("metrics: evalkit list metrics", markup=False, highlight=False)


def _print_card(name: str, as_json: bool) -> None:
    from evalkit.commands.list import cards  # noqa: PLC0415 - loads scipy
    from evalkit.metrics import all_metrics  # noqa: PLC0415 - as above

    metrics = {metric.name: metric for metric in all_metrics()}
    if name not in metrics:
        raise UnknownName("metric", name, (*inventory.KINDS, METRICS, ALL, *metrics))
    if as_json:
        options.print_json(cards.card_as_json(metrics[name]))
        return
    out.print(name, markup=False, highlight=False)
    for title, text in cards.card_facts(metrics[name]):
        if text:
            out.print(f"  {title:<23} {text}", markup=False, highlight=False)


def _metrics(group: str) -> list[Metric]:
    from evalkit.metrics import all_metrics  # noqa: PLC0415 - loads scipy

    metrics = all_metrics()
    groups = dict.fromkeys(metric.group for metric in metrics)
    if group and group not in groups:
        raise UnknownName("group of metrics", group, groups)
    return [metric for metric in metrics if group in ("", metric.group)]


def _cards(metrics: list[Metric]) -> list[dict[str, Any]]:
    from evalkit.commands.list.cards import card_as_json  # noqa: PLC0415 - loads scipy

    return [card_as_json(metric) for metric in metrics]


def _print_table(title: str, columns: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    table = Table(*columns, title=title, title_justify="left", expand=out.is_terminal)
    for row in rows:
        table.add_row(*map(escape, row))
    progress.print_table(out, table)
