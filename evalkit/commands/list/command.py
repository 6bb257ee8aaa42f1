"""``evalkit list``: list back ends, mappers, data sets and metrics, or print the card of a metric."""

from __future__ import annotations

import difflib
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evalkit.commands.list import inventory
from evalkit.core.errors import UnknownName
from evalkit.plugins import registry
from evalkit.terminal import options
from evalkit.terminal.console import out, print_json
from evalkit.terminal.text_list import print_list

if TYPE_CHECKING:
    from evalkit.metrics.metric import Metric

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

    Without a kind it prints names; the list of a kind also says what is missing on this machine, and how to install it.
    """  # fmt: skip
    if group and what not in (METRICS, ALL):
        raise typer.BadParameter("--group: needs 'metrics'")
    if what not in ("", METRICS, ALL, *inventory.KINDS):
        _print_card(what, as_json)
        return
    if not what and not as_json:
        _print_names()
        return
    kinds = [kind for kind in inventory.KINDS if what in ("", ALL, kind)]
    found = {kind: inventory.find_entries(kind) for kind in kinds}
    metrics = _metrics(group) if what in (METRICS, ALL) else ()
    if as_json:
        content: dict[str, Any] = {kind: [asdict(entry) for entry in entries] for kind, entries in found.items()}
        print_json(content | ({METRICS: _cards(metrics)} if metrics else {}))
        return
    for kind, entries in found.items():
        rows = [(e.name, f"{e.summary}; not here: {e.missing}" if e.missing else e.summary) for e in entries]
        print_list(out, kind, rows)
    for name in dict.fromkeys(metric.group for metric in metrics):
        print_list(out, name, [(metric.name, _describe(metric)) for metric in metrics if metric.group == name])


def _print_names() -> None:
    """Print the names of each kind without loading a plug-in."""
    for kind in inventory.KINDS:
        print_list(out, f"{kind}: evalkit list {kind}", [("", ", ".join(registry.names(kind)))])
    out.print("metrics: evalkit list metrics", style="bold")


def _describe(metric: Metric) -> str:
    """Return label, unit and direction of a metric."""
    unit = f" [{metric.unit}]" if metric.unit else ""
    return f"{metric.label}{unit}{f', {metric.better} is better' if metric.better else ''}"


def _print_card(name: str, as_json: bool) -> None:
    from evalkit.commands.list import cards  # noqa: PLC0415 - loads scipy
    from evalkit.metrics import all_metrics  # noqa: PLC0415 - as above

    metrics = {metric.name: metric for metric in all_metrics()}
    if name not in metrics:
        close = difflib.get_close_matches(name, metrics, n=5)
        raise UnknownName("list or metric", name, (*inventory.KINDS, METRICS, ALL, *close))
    if as_json:
        print_json(cards.card_as_json(metrics[name]))
        return
    print_list(out, name, [(title, text) for title, text in cards.card_facts(metrics[name]) if text])


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
