"""Names of methods in the narrow tables of a terminal; results and page have them in full."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from evalkit.plugins import registry
from evalkit.report.analysis.comparison import Comparison

CUT = "..."
"""What stands for the middle of a name that is cut."""


def shorten_names(comparison: Comparison) -> Mapping[str, str]:
    """Return the name of each method in a table: its label, or the short form of an address that is its label.

    An address whose short form another method has too stays whole.
    """
    backends = {run.method: run.spec.method.backend for run in comparison.records}
    short = {label: shorten_address(label) if backends.get(label) == label else label for label in backends}
    count = Counter(short.values())
    return {label: name if count[name] == 1 else label for label, name in short.items()}


def shorten_address(address: str) -> str:
    """Return scheme and file of an address: "exec: slam.py" of "exec:python examples/slam.py"; other names as they are.

    The file is the first word that is a path, else the first with an extension, else the first one.
    """
    scheme, _, rest = address.partition(":")
    words = rest.partition("?")[0].split()
    if scheme not in registry.names("schemes") or not words:
        return address
    paths = (word for mark in ("/", ".", "") for word in words if mark in word)
    return f"{scheme}: {next(paths).rstrip('/').rpartition('/')[2]}"


def cut_middle(text: str, most: int) -> str:
    """Return a text of at most so many characters, without its middle where it is longer."""
    if len(text) <= most:
        return text
    kept = max(most - len(CUT), 0)
    return f"{text[: kept // 2]}{CUT[: most - kept]}{text[len(text) - (kept - kept // 2) :]}"
