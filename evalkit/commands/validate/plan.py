"""The plan of a validation: resolved names and settings."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from evalkit.commands.validate.acceptance import Claim
from evalkit.commands.validate.equivalence.margins import FLOAT32
from evalkit.commands.validate.probes import EXACT
from evalkit.commands.validate.rules.runner import refuse_recorded
from evalkit.config.experiment import Experiment, SequenceSpec
from evalkit.config.experiment_file import experiment_from_tables
from evalkit.config.limits import Limits
from evalkit.core.errors import NotInstalled
from evalkit.external.declaration import split_words
from evalkit.odometry import frontend
from evalkit.plugins import code_hash, defaults, registry
from evalkit.plugins.parameter_parsing import from_text, parse_dataset_without_seed
from evalkit.plugins.parameters import Value
from evalkit.plugins.specs import BackendSpec, RegistrationSpec

AUTO = "auto"
WHY_REFERENCE = 'the first back end by name with the role "reference"'

Only = Literal["", "rules", "registrations", "lockstep", "determinism"]
"""The one group of checks to run; "": levels 0 to 5."""


@dataclass(frozen=True)
class Effort:
    """The size of a validation.

    ``pairs``: pairs of scans; ``scans``: scans in lockstep; ``mapper_scans``: scans for the comparison of mappers;
    ``timed``: scans timed; ``limit_s``, ``memory_mib``: limits of one task; ``map_scans``: scans in the map of a run;
    ``quick``: fewer drawn questions.
    """

    pairs: int
    scans: int
    mapper_scans: int
    timed: int
    limit_s: float
    map_scans: int
    memory_mib: int = 2048
    quick: bool = False


FULL = Effort(pairs=40, scans=150, mapper_scans=40, timed=250, limit_s=240.0, map_scans=250)
QUICK = Effort(pairs=16, scans=45, mapper_scans=12, timed=45, limit_s=60.0, map_scans=40, quick=True)


@dataclass(frozen=True)
class ValidationRequest:
    """A validation as requested on the command line; settings are texts by parameter name.

    ``reference``: "" for the default one. ``peers``: other methods for context. ``on``: sequences such as
    "name laps=0.3". ``margin``: "auto" or a text for ``probes.parse_margin``. ``noise_share``: see ``ComparisonTerms``.
    ``mapper``: "" for the mapper in the module of the back end. ``disturbed``: include disturbed guesses in lockstep.
    ``seed``: of drawn questions and rules. ``waivers``: reasons by the name of a check that is excepted.
    """

    backend: str
    given: Mapping[str, str]
    reference: str
    given_reference: Mapping[str, str]
    peers: tuple[str, ...]
    on: tuple[str, ...]
    seeds: int
    claim: Claim
    margin: str
    noise_share: float
    mapper: str
    effort: Effort
    only: Only = ""
    disturbed: bool = True
    seed: int = 0
    waivers: Mapping[str, str] = field(default_factory=dict)

    @property
    def margins(self) -> list[str]:
        """The margins to try, the strictest first."""
        return [EXACT, FLOAT32] if self.margin == AUTO else [self.margin]


@dataclass(frozen=True)
class SeededSequence:
    """One sequence with one seed: its label, its sequence, and the data for a probe."""

    label: str
    sequence: SequenceSpec
    data: Mapping[str, Any]


@dataclass(frozen=True)
class ValidationPlan:
    """A request with all names resolved and all settings complete.

    ``mappers``: those of the back end and of the reference, "" if there is none. ``unavailable``: peers and sequences
    that are not installed here, and why.
    """

    request: ValidationRequest
    reference: str
    why_reference: str
    given: Mapping[str, Value]
    given_reference: Mapping[str, Value]
    peers: tuple[str, ...]
    unavailable: Mapping[str, str]
    experiment: Experiment
    mappers: tuple[str, str]

    @property
    def backend(self) -> str:
        """The back end under test; also its label."""
        return self.request.backend

    @property
    def reference_label(self) -> str:
        """The label of the reference, which differs from its name where a back end is its own reference."""
        return _reference_label(self.backend, self.reference)

    @property
    def methods(self) -> list[str]:
        """The back end, the reference, and the peers that register scans."""
        return list(dict.fromkeys((self.backend, self.reference, *self.registering_peers)))

    @property
    def registrations(self) -> list[str]:
        """The methods that are registrations."""
        return [name for name in self.methods if isinstance(registry.backend(name), RegistrationSpec)]

    def settings(self) -> dict[str, Any]:
        """The settings of the validation for the report."""
        return {
            "backend": dict(self.given), "reference": dict(self.given_reference), "on": list(self.request.on),
            "seed": self.request.seed, "seeds": self.request.seeds, "noise_share": self.request.noise_share,
            "effort": asdict(self.request.effort), "mappers": list(self.mappers),
        }  # fmt: skip

    @property
    def registering_peers(self) -> list[str]:
        """The peers that use the scans: a baseline does not."""
        return [name for name in self.peers if registry.backend(name).role != "baseline"]


def make_plan(request: ValidationRequest) -> ValidationPlan:
    """Resolve a request before anything is computed; raises NotInstalled, UnknownName, BadParameter, BackendFailed."""
    backend = request.backend
    reference, why = choose_reference(request.reference, backend)
    for name in (backend, reference):
        refuse_recorded(name, registry.backend(name))
        if unusable := _find_unusable_reason(registry.backend(name)):
            raise NotInstalled(name, "cannot be validated here", unusable)
    given = _parse_settings(backend, request.given)
    known = {parameter.name for parameter in frontend.settable_parameters(registry.backend(reference))}
    shared = {name: text for name, text in request.given.items() if name in known}
    given_reference = _parse_settings(reference, {**shared, **request.given_reference})
    wanted = [name for name in dict.fromkeys(request.peers) if name not in (backend, reference)]
    unavailable = {name: why_not for name in wanted if (why_not := _find_unusable_reason(registry.find_backend(name)))}
    installed = [name for name in wanted if name not in unavailable]
    baselines = [
        name for name in defaults.find_backends_with_role("baseline") if name not in (backend, reference, *installed)
    ]
    mapper = request.mapper or defaults.find_mapper_of(backend)
    mappers = (mapper, defaults.find_mapper_of(reference)) if mapper else ("", "")
    peers = (*installed, *baselines)
    methods: list[Mapping[str, Any]] = [
        {"use": backend, **given},
        {"use": reference, "label": _reference_label(backend, reference), **given_reference},
        *({"use": name} for name in peers),
    ]
    planned = make_experiment(request, methods)
    unavailable |= {sequence.label: sequence.missing for sequence in planned.sequences if sequence.missing}
    return ValidationPlan(
        request, reference, why, given, given_reference, peers, unavailable, installed_only(planned), mappers
    )


def choose_reference(name: str, backend: str) -> tuple[str, str]:
    """The back end to compare another one with, and how it was chosen; NotInstalled if there is none.

    By name, else the one that the spec of ``backend`` names, else the first with the role "reference".
    """
    if name:
        return name, "given with --reference"
    if twin := registry.backend(backend).reference:
        return twin, f"the twin that {backend} names"
    return defaults.find_reference_backend(), WHY_REFERENCE


def make_experiment(request: ValidationRequest, methods: Iterable[Mapping[str, Any]]) -> Experiment:
    """The experiment of methods over the sequences of a request."""
    effort = request.effort
    content = {
        "method": list(methods),
        "sequence": [_parse_sequence(text, request.seeds) for text in request.on],
        "mapper": {"scans": effort.map_scans},
        "limits": asdict(Limits()) | {"run_s": 3.0 * effort.limit_s, "memory_mib": effort.memory_mib},
    }
    return experiment_from_tables(content, "evalkit validate", "validate", f"validate {shlex.quote(request.backend)}")


def installed_only(planned: Experiment) -> Experiment:
    """The experiment without the sequences that are not available here."""
    return replace(planned, sequences=tuple(sequence for sequence in planned.sequences if not sequence.missing))


def seeded_sequences(planned: Experiment) -> list[SeededSequence]:
    """Every sequence of an experiment with every seed."""
    return [
        SeededSequence(
            label,
            sequence,
            {"label": label, "dataset": sequence.dataset, "parameters": sequence.parameters_with_seed(seed)},
        )
        for sequence in planned.sequences
        for seed in sequence.seeds
        for label in [sequence.label if seed is None else f"{sequence.label}, seed {seed}"]
    ]


def compiled_files(backend: str) -> list[Path]:
    """The files of machine code of a back end: its library, or those of its plug-in's package."""
    scheme, colon, rest = backend.partition(":")
    if colon and scheme == "lib":
        return [Path(split_words(backend, rest)[0]).resolve()]
    module = registry.plug_in_of("backends", backend).module
    files = code_hash.find_sources(module, frozenset({module.partition(".")[0]}))
    return sorted(file for file in files if file.suffix == ".so")


def _parse_sequence(text: str, seeds: int) -> dict[str, Any]:
    """The table of an experiment for a text such as "name laps=0.3"."""
    name, given = parse_dataset_without_seed(text, "--seeds N takes the seeds 0 to N - 1")
    return {"use": name, **given, **({"seeds": list(range(seeds))} if registry.dataset(name).seeded else {})}


def _reference_label(backend: str, reference: str) -> str:
    return reference if reference != backend else f"{reference} (reference)"


def _find_unusable_reason(spec: BackendSpec) -> str:
    """Why a back end cannot run here, or "" if it can."""
    return spec.missing() or spec.broken


def _parse_settings(name: str, given: Mapping[str, str]) -> dict[str, Value]:
    spec = registry.backend(name)
    values = from_text(name, frontend.settable_parameters(spec), given)
    frontend.complete_parameters(name, spec, values)
    return values
