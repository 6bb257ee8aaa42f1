"""The input of a report: the runs of an experiment, the metrics, and cards that describe methods and sequences."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime

from evalkit.core.run_status import RunStatus
from evalkit.metrics.metric import Metric
from evalkit.plugins.parameters import Value
from evalkit.plugins.protocols import Sequence
from evalkit.plugins.specs import MapUse, Published, Role
from evalkit.results.run_record import RunRecord


@dataclass(frozen=True, slots=True)
class Setting:
    """One parameter of a method or a sequence: the value of this run and the default."""

    name: str
    value: Value
    default: Value
    unit: str
    meaning: str


@dataclass(frozen=True)
class MethodCard:
    """Description of a method.

    ``guess``: the initial guess of its registration. ``missing``: why it could not run here, "" if it could.
    ``role``: see ``plugins.specs.Role``. ``tuned_on``: the data sets that parameters of this method were chosen on.
    ``map_use``: what it does with a known map.
    """

    summary: str
    citation: str
    licence: str
    settings: tuple[Setting, ...] = ()
    guess: str = ""
    missing: str = ""
    role: Role = ""
    tuned_on: tuple[str, ...] = ()
    map_use: MapUse = "starts there"


@dataclass(frozen=True)
class SequenceCard:
    """Description of a sequence: ``summary`` of its data set, ``settings`` of this sequence.

    ``truth``: how the ground truth was obtained. ``degenerate``: why the geometry does not determine the pose.
    ``warnings``: doubts about the data of a recording, as its reader found them. ``simulated``: it is no recording.
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
    warnings: tuple[str, ...] = ()
    simulated: bool = False


@dataclass(frozen=True)
class Comparison:
    """Everything that one report is computed from.

    ``records``: one per method, sequence and seed, including failed ones. ``methods``, ``sequences``: cards by label;
    tables and sections keep their order. ``environment``: machine, threads, versions, commit. ``command``: reproduces
    the report. ``mapper``: the mapper of all maps with its settings. ``fairness``: what was equal for all methods and
    what was not, one sentence each. ``scans``: functions that open a sequence at its lowest seed, for the player.

    Raises ValueError for a run without a card, or for two runs of one method, sequence and seed.
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
        for run in self.records:
            if run.method not in self.methods:
                raise ValueError(f"methods: no card for '{run.method}'")
            if run.sequence not in self.sequences:
                raise ValueError(f"sequences: no card for '{run.sequence}'")
            names = (run.method, run.sequence, run.seed)
            if names in seen:
                raise ValueError(f"runs: {run.method} over {run.sequence} with seed {run.seed} occurs twice")
            seen.add(names)

    @property
    def method_labels(self) -> tuple[str, ...]:
        """The labels of the methods that have runs, in the order of their cards."""
        present = {run.method for run in self.records}
        return tuple(label for label in self.methods if label in present)

    @property
    def sequence_labels(self) -> tuple[str, ...]:
        """The labels of the sequences that have runs, in the order of their cards."""
        present = {run.sequence for run in self.records}
        return tuple(label for label in self.sequences if label in present)

    @property
    def missing_sequences(self) -> tuple[str, ...]:
        """The labels of the sequences whose data are not on this machine."""
        return tuple(find_missing_sequences(self.records))

    @property
    def missing_methods(self) -> tuple[str, ...]:
        """The labels of the methods that are not installed on this machine."""
        absent = {run.method for run in self.records if run.result.status == RunStatus.NOT_INSTALLED}
        return tuple(label for label in self.method_labels if label in absent)

    def methods_with_role(self, role: Role) -> tuple[str, ...]:
        """Return the labels of the methods with this role, in order."""
        return tuple(label for label in self.method_labels if self.methods[label].role == role)

    def runs_by_method(self, sequence: str) -> dict[str, tuple[RunRecord, ...]]:
        """Return the runs over one sequence by method, in the order of the cards, lowest seed first."""
        runs = sorted(
            (run for run in self.records if run.sequence == sequence),
            key=lambda run: -1 if run.seed is None else run.seed,
        )
        grouped = {label: tuple(run for run in runs if run.method == label) for label in self.methods}
        return {label: group for label, group in grouped.items() if group}


def find_missing_sequences(runs: Iterable[RunRecord]) -> dict[str, None]:
    """Return the sequences whose data are not on this machine, in order: no installed method has its input there."""
    installed = [run for run in runs if run.result.status != RunStatus.NOT_INSTALLED]
    there = {run.sequence for run in installed if run.result.status != RunStatus.DATA_MISSING}
    return dict.fromkeys(run.sequence for run in installed if run.sequence not in there)
