"""What a report is made from: the records, the metrics they were scored with, and a card for everyone who took part."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from typing import TYPE_CHECKING

from evalkit.metrics.series import SERIES
from evalkit.metrics.table import Metric
from evalkit.plugins.parameters import Value
from evalkit.plugins.protocols import Sequence
from evalkit.plugins.specs import Published, Role
from evalkit.report.analysis.bootstrap import RecordBootstrap
from evalkit.results.run_record import RunRecord

if TYPE_CHECKING:
    from evalkit.report.analysis.standings import Standing


@dataclass(frozen=True, slots=True)
class Setting:
    """One parameter of a method or a sequence as it ran, beside its default."""

    name: str
    value: Value
    default: Value
    unit: str
    meaning: str


@dataclass(frozen=True)
class MethodCard:
    """Who a method is. ``role``: see ``plugins.protocols.Role``.

    ``guess``: what its registration starts from. ``missing``: why it could not run here, "" where it could.
    """

    summary: str
    citation: str
    licence: str
    settings: tuple[Setting, ...] = ()
    guess: str = ""
    missing: str = ""
    role: Role = ""


@dataclass(frozen=True)
class SequenceCard:
    """What a sequence is. ``summary`` tells of the data set, ``settings`` what of it was taken.

    ``truth``: how the truth was made. ``degenerate``: why its geometry cannot fix the pose.
    """

    summary: str
    sensor: str
    truth: str
    citation: str
    licence: str
    defects: tuple[str, ...] = ()
    degenerate: str = ""
    published: tuple[Published, ...] = ()
    settings: tuple[Setting, ...] = ()


@dataclass(frozen=True)
class Comparison:
    """Everything one report tells.

    ``records``: one per method, sequence and seed, failed ones included. ``methods``, ``sequences``: cards by
    the labels in the records; rows and sections keep the order of the cards. ``environment``: what it ran on (CPU,
    threads, versions, commit). ``command``: reproduces the whole report. ``mapper``: what drew every map, with its
    settings. ``fairness``: what was held equal and what was not (guess, threads, warm-up), one sentence each.
    ``scans``: what makes a sequence again as its lowest seed met it, for the page's player.
    """

    title: str
    description: str
    records: tuple[RunRecord, ...]
    metrics: tuple[Metric, ...]
    methods: Mapping[str, MethodCard]
    sequences: Mapping[str, SequenceCard]
    environment: Mapping[str, str]
    command: str
    started: datetime
    finished: datetime
    mapper: str = ""
    fairness: tuple[str, ...] = field(default_factory=tuple)
    scans: Mapping[str, Callable[[], Sequence]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("records", "metrics", "fairness"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        seen: set[tuple[str, str, int | None]] = set()
        for record in self.records:
            if record.method not in self.methods:
                raise ValueError(f"methods: no card for '{record.method}'")
            if record.sequence not in self.sequences:
                raise ValueError(f"sequences: no card for '{record.sequence}'")
            row = (record.method, record.sequence, record.seed)
            if row in seen:
                raise ValueError(f"trials: {row[0]} over {row[1]} with seed {row[2]} stands there twice")
            seen.add(row)

    @cached_property
    def bootstrap(self) -> RecordBootstrap:
        """Bootstrap draws of the records' scores, computed once and cached."""
        return RecordBootstrap(self.records, SERIES)

    @cached_property
    def standings(self) -> dict[tuple[str, str], Standing]:
        """Standings already made, by sequence and metric: each is asked for many times."""
        return {}

    def of_sequence(self, sequence: str) -> tuple[RunRecord, ...]:
        """The records over one sequence, in order."""
        return tuple(record for record in self.records if record.sequence == sequence)

    @property
    def method_labels(self) -> tuple[str, ...]:
        """The labels of the methods that have records, in the order of their cards."""
        present = {record.method for record in self.records}
        return tuple(label for label in self.methods if label in present)

    @property
    def sequence_labels(self) -> tuple[str, ...]:
        """The labels of the sequences that have records, in the order of their cards."""
        present = {record.sequence for record in self.records}
        return tuple(label for label in self.sequences if label in present)

    def by_method(self, sequence: str) -> dict[str, tuple[RunRecord, ...]]:
        """The records over one sequence under their methods, in the order of the cards, lowest seed first."""
        records = sorted(self.of_sequence(sequence), key=lambda record: -1 if record.seed is None else record.seed)
        grouped = {label: tuple(t for t in records if t.method == label) for label in self.methods}
        return {label: own for label, own in grouped.items() if own}
