"""A chapter of the paper's page: settings, tasks, sections and findings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from evalkit.execution.task import AnyTask, Result
from evalkit.plugins.parameters import Parameter, resolve_parameters
from evalkit.report.html.blocks import Section

Verdict = Literal[
    "reproduced", "reproduced with a correction", "not determined by the text", "not reproducible in software"
]
Settings = Mapping[str, Any]
Results = Mapping[str, Result]


@dataclass(frozen=True)
class Finding:
    """One table, figure or claim of the paper: printed value, measured value, verdict and its reason.

    ``anchor``: section of the page that shows it.
    """

    item: str
    printed: str
    measured: str
    verdict: Verdict
    why: str
    anchor: str


@dataclass(frozen=True)
class Chapter:
    """A chapter: ``name`` is its table in the settings file, ``parameters`` its allowed keys.

    ``tasks`` are the computations; ``sections`` and ``findings`` present their results, by the tasks'
    names. ``read`` turns the table into settings where it holds more than single values; its first argument says whose
    table it is, for messages.
    """

    name: str
    parameters: tuple[Parameter, ...]
    tasks: Callable[[Settings], tuple[AnyTask, ...]]
    sections: Callable[[Settings, Results], tuple[Section, ...]]
    findings: Callable[[Settings, Results], tuple[Finding, ...]]
    read: Callable[[str, Mapping[str, object]], Settings] | None = None

    def settings(self, owner: str, table: Mapping[str, object]) -> Settings:
        """Check a table and fill in defaults. Raises BadParameter or UnknownName naming the key."""
        return self.read(owner, table) if self.read else resolve_parameters(owner, self.parameters, table)
