"""A chapter of the paper's page: settings, tasks, sections and findings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from evalkit.execution.task import AnyTask, Result
from evalkit.plugins.parameters import Parameter, Value, resolve_parameters
from evalkit.report.html.blocks import Section

Verdict = Literal[
    "reproduced", "reproduced with a correction", "not reproduced", "not determined by the text",
    "not reproducible in software",
]  # fmt: skip
Settings = Mapping[str, Any]
Results = Mapping[str, Result]


@dataclass(frozen=True)
class Case:
    """A back end with changed parameters, on a sequence with changed parameters; ``mark``: its meaning in a chapter."""

    name: str
    backend: str = "paper"
    parameters: Mapping[str, Value] = field(default_factory=dict)
    sequence: Mapping[str, Value] = field(default_factory=dict)
    mark: str = ""


@dataclass(frozen=True)
class Judgement:
    """A verdict and its reason. ``correction``: the change of the printed text that reproduces it.

    Raises ValueError for a correction without the verdict "reproduced with a correction", or the reverse.
    """

    verdict: Verdict
    why: str
    correction: str = ""

    def __post_init__(self) -> None:
        if bool(self.correction) != (self.verdict == "reproduced with a correction"):
            raise ValueError(f"correction: found {self.correction!r} with the verdict '{self.verdict}'")


@dataclass(frozen=True)
class Finding:
    """One table, figure or claim of the paper: printed value, measured value and judgement.

    ``anchor``: section of the page that shows it.
    """

    item: str
    printed: str
    measured: str
    judgement: Judgement
    anchor: str


@dataclass(frozen=True)
class Chapter:
    """A chapter: ``name`` is its table in the settings file, ``parameters`` its allowed keys.

    ``tasks`` are the computations; ``sections`` and ``findings`` present their results, by the tasks' names.
    """

    name: str
    parameters: tuple[Parameter, ...]
    tasks: Callable[[Settings], tuple[AnyTask, ...]]
    sections: Callable[[Settings, Results], tuple[Section, ...]]
    findings: Callable[[Settings, Results], tuple[Finding, ...]]

    def settings(self, owner: str, table: Mapping[str, object]) -> Settings:
        """Check a table and fill in defaults. Raises BadParameter or UnknownName naming the key."""
        return resolve_parameters(owner, self.parameters, table)
