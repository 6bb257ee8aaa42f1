"""The difference of two results folders in words: lines for a terminal, Markdown for a pull request."""

from __future__ import annotations

from collections.abc import Mapping

from evalkit.commands.diff.differences import Change, Difference, Ended, Said
from evalkit.metrics.table import Metric
from evalkit.report.html.formatting import as_markdown, figure

COLUMNS = ("method", "sequence", "what", "old", "new", "change", "95 % interval", "that is")
MARKS: Mapping[Said, str] = {"regression": "❌ ", "improvement": "✅ "}
FEW: tuple[Said, ...] = ("unchanged", "within the limit")
"""What is counted, not listed."""


def rows(found: Difference, metrics: Mapping[str, Metric], everything: bool = False) -> list[tuple[str, ...]]:
    """The table's rows, worst first: runs that ended otherwise, then metrics; what did not change only if asked."""
    order: tuple[Said, ...] = ("regression", "improvement", "no difference shown", "not comparable", *FEW)
    shown = [one for one in found.changes if everything or one.said not in FEW]
    ended = [_ended(one) for one in sorted(found.ended, key=lambda one: order.index(one.said))]
    return ended + [_changed(one, metrics[one.metric]) for one in sorted(shown, key=lambda one: order.index(one.said))]


def verdict(found: Difference) -> str:
    """The whole in a sentence."""
    said = [one.said for one in found.changes]
    quiet = sum(said.count(one) for one in FEW)
    count = found.regressions
    head = "No regression" if count == 0 else f"{count} regression{'s' if count > 1 else ''}"
    limits = f"{100 * found.limits.error:g} % of an error, {100 * found.limits.time:g} % of CPU time"
    return (
        f"{head} beyond {limits} and the noise; {said.count('improvement')} improved, {quiet} of {len(said)} numbers "
        "are unchanged or within the limit."
    )


def remarks(found: Difference) -> list[str]:
    """What else is to be known: what one folder alone has, what cannot be compared, what to bear in mind."""
    return [
        *([f"only in {found.old}: {', '.join(found.only_old)}"] if found.only_old else []),
        *([f"only in {found.new}: {', '.join(found.only_new)}"] if found.only_new else []),
        *found.apart,
        *found.notes,
    ]


def markdown(found: Difference, metrics: Mapping[str, Metric]) -> str:
    """A comment for a pull request: the verdict, a table of what changed, remarks."""
    table = rows(found, metrics)
    lines = [f"**{verdict(found)}**", ""]
    if table:
        lines += [_line(COLUMNS), _line(["---"] * len(COLUMNS)), *(_line(row) for row in table), ""]
    lines += [f"- {as_markdown(remark)}" for remark in remarks(found)]
    return "\n".join(lines).rstrip() + "\n"


def _ended(one: Ended) -> tuple[str, ...]:
    seed = "" if one.seed is None else f" seed {one.seed}"
    said = f"{MARKS.get(one.said, '')}{one.said}{f': {one.reason}' if one.reason else ''}"
    return (one.method, one.sequence, f"run{seed}", one.old, one.new, "", "", said)


def _changed(one: Change, metric: Metric) -> tuple[str, ...]:
    unit = f" [{metric.unit}]" if metric.unit else ""
    old, new = (figure(value, metric.digits + 1) for value in (one.old, one.new))
    share = f"{100.0 * (one.new - one.old) / abs(one.old):+.1f} %".replace("-", "−") if one.old else ""
    bounds = ""
    if one.low is not None and one.high is not None:
        bounds = f"{figure(one.low, metric.digits + 1)} to {figure(one.high, metric.digits + 1)}"
    said = f"{MARKS.get(one.said, '')}{one.said}: {one.why}"
    return (one.method, one.sequence, f"{metric.label}{unit}", old, new, share, bounds, said)


def _line(cells: list[str] | tuple[str, ...]) -> str:
    return f"| {' | '.join(as_markdown(cell.replace('|', '/')) for cell in cells)} |"
