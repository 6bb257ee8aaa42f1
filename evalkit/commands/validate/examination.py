"""An implementation examined on all levels: what is asked, in which order, and what becomes a dossier."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from evalkit.commands.validate import answers, costs, pace, paths, probes
from evalkit.commands.validate.acceptance import Claim, Dossier, Level
from evalkit.commands.validate.answers import Names
from evalkit.commands.validate.equivalence.comparison import FLOAT32
from evalkit.commands.validate.probes import EXACT
from evalkit.config.experiment import Experiment, Limits, SequenceSpec, experiment_from_tables
from evalkit.core.errors import BadParameter, NotInstalled
from evalkit.execution import environment, sandbox
from evalkit.execution.executors import LocalExecutor, Progress
from evalkit.execution.scheduler import Scheduler
from evalkit.execution.task import AnyTask, Parameters, Result, make_task
from evalkit.execution.task_runner import OnDone, run_tasks
from evalkit.execution.task_store import TaskStore
from evalkit.external.declaration import split_words
from evalkit.odometry import frontend
from evalkit.plugins import code_hash, defaults, registry
from evalkit.plugins.parameter_parsing import from_text
from evalkit.plugins.parameters import Value
from evalkit.plugins.specs import BackendSpec, RegistrationSpec
from evalkit.results.run_record import RunRecord
from evalkit.results.store import Store

AUTO = "auto"
CHOSEN = 'the first back end by name with the role "reference"'
COPIES = 5
"""Copies of a sequence that tell how far rounding alone leads."""


@dataclass(frozen=True)
class Effort:
    """How much is asked: pairs of scans, scans in lockstep, scans drawn, scans and pairs timed; seconds, MiB, cells."""

    pairs: int
    scans: int
    drawn: int
    timed: int
    limit_s: float
    map_scans: int
    memory_mib: int = 2048


FULL = Effort(pairs=40, scans=150, drawn=40, timed=250, limit_s=240.0, map_scans=250)
QUICK = Effort(pairs=16, scans=45, drawn=12, timed=45, limit_s=60.0, map_scans=40)


@dataclass(frozen=True)
class Asked:
    """Who is examined and how, as somebody asked for it; settings are texts NAME=VALUE."""

    backend: str
    given: Mapping[str, str]
    twin: str
    given_twin: Mapping[str, str]
    against: tuple[str, ...]
    on: tuple[str, ...]
    seeds: int
    claim: Claim
    margin: str
    share: float
    mapper: str
    effort: Effort


@dataclass(frozen=True)
class Watch:
    """Who hears how it goes on: of jobs, told how many there are, and of runs."""

    jobs: Callable[[int, int], AbstractContextManager[OnDone]]
    runs: Callable[[Experiment, int], AbstractContextManager[Progress]]


@dataclass(frozen=True)
class Examination:
    """All names found and all settings complete; what cannot be asked here is told, not silently left out."""

    asked: Asked
    twin: str
    why_twin: str
    given: Mapping[str, Value]
    given_twin: Mapping[str, Value]
    against: tuple[str, ...]
    absent: Mapping[str, str]
    plan: Experiment
    mappers: tuple[str, str]

    def dossier(self, folder: Path, workers: int, watch: Watch) -> Dossier:
        """The dossier; what was computed before in the folder is taken from there."""
        store, where = TaskStore(folder / "jobs"), environment.describe(jobs=workers)
        first = [self._rules()]
        with watch.jobs(1, 1) as done:
            level0 = answers.rules(run_tasks(store, first, 1, done)["rules"])
        if _hopeless(level0):
            return self._made(EXACT, "", (level0,), where)
        jobs = list(self._jobs())
        with watch.jobs(len(jobs), workers) as done:
            found = run_tasks(store, jobs, workers, done)
        with watch.runs(self.plan, workers) as progress:
            scheduler = Scheduler(Store(folder), progress, where, resume=True)
            records = _placed(scheduler.run_and_load(self.plan, LocalExecutor(workers)))
        if answers.margin_of(_compared(found), self._margins()) == FLOAT32:
            copies = list(self._copies())
            with watch.jobs(len(copies), workers) as done:
                found = {**found, **run_tasks(store, copies, workers, done)}
        timed = list(self._timed())
        with watch.jobs(len(timed), 1) as done:  # alone: nothing else may run beside what is timed
            taken = run_tasks(store, timed, 1, done)
        return self._levels(level0, found, records, taken, where)

    def registrations(self, folder: Path, workers: int, watch: Watch) -> Dossier:
        """Return the dossier of the registrations alone; results that exist in the folder are reused."""
        jobs = [job for job in self._jobs() if job.name.startswith(("pairs, ", "answers of "))]
        with watch.jobs(len(jobs), workers) as done:
            found = run_tasks(TaskStore(folder / "jobs"), jobs, workers, done)
        both = _compared(found)
        margin = answers.margin_of(both, self._margins())
        others = {name: of for name in self.against if (of := _of(f"answers of {name}", found))}
        names = Names(self.mine, self.twin_label, margin, self.asked.share, self.against)
        level = answers.pairs(_of("pairs", found), others, names)
        return self._made(margin, answers.within(both, margin), (level,), environment.describe(jobs=workers))

    def _levels(
        self, level0: Level, found: Mapping[str, Result], records: paths.Trials, taken: Mapping[str, Result],
        where: Mapping[str, str],
    ) -> Dossier:  # fmt: skip
        pairs, scans = _of("pairs", found), _of("scans", found)
        both = _compared(found)
        margin = answers.margin_of(both, self._margins())
        names = Names(self.mine, self.twin_label, margin, self.asked.share, self.against)
        others = {name: _of(f"answers of {name}", found) for name in self.against}
        allowed = {
            place: (one[margin]["margin"]["metres"], one[margin]["margin"]["radians"])
            for place, one in scans.items()
            if sandbox.ENDED not in one
        }
        levels = (
            level0,
            answers.pairs(pairs, {name: of for name, of in others.items() if of}, names),
            answers.scans(scans, names),
            paths.paths(records, allowed, _of("copies", found), names),
            paths.maps(records, allowed, _of("mapper", found), self.mappers, names),
            costs.costs(_of("time", taken), _of("time of a pair", taken), self._labels(), self._registrations(),
                        records, names, compiled(self.asked.backend)),
        )  # fmt: skip
        return self._made(margin, answers.within(both, margin), levels, where)

    @property
    def mine(self) -> str:
        """Its label."""
        return self.asked.backend

    @property
    def twin_label(self) -> str:
        """The twin's label, its own where it is examined against itself."""
        return self.twin if self.twin != self.mine else f"{self.twin} (twin)"

    def _made(self, margin: str, within: str, levels: tuple[Level, ...], where: Mapping[str, str]) -> Dossier:
        settings = {
            "backend": dict(self.given), "twin": dict(self.given_twin), "on": list(self.asked.on),
            "seeds": self.asked.seeds, "share": self.asked.share, "effort": asdict(self.asked.effort),
            "mappers": list(self.mappers),
        }  # fmt: skip
        return Dossier(
            self.mine, self.twin_label, self.why_twin, self.against, self.absent, self.asked.claim, margin, within,
            levels, settings, where,
        )  # fmt: skip

    def _margins(self) -> list[str]:
        return [EXACT, FLOAT32] if self.asked.margin == AUTO else [self.asked.margin]

    def _places(self) -> Iterator[tuple[str, SequenceSpec, dict[str, Any]]]:
        """Every sequence that is here, with every seed: place, sequence, and how it is made."""
        for sequence in self.plan.sequences:
            for seed in sequence.seeds:
                place = sequence.label if seed is None else f"{sequence.label}, seed {seed}"
                yield (
                    place,
                    sequence,
                    {"label": place, "dataset": sequence.dataset, "parameters": sequence.parameters_with_seed(seed)},
                )

    def _rules(self) -> AnyTask:
        own = {p.name for p in registry.backend(self.mine).parameters}
        given = {name: value for name, value in self.given.items() if name in own}
        rules = make_task(
            "rules", probes.rules, name=self.mine, given=given, limit_s=30.0, digest=registry.backend(self.mine).digest
        )
        return rules.depending_on(*self._uses(self.mine))

    def _jobs(self) -> Iterator[AnyTask]:
        """Levels 1 and 2, and the mappers of level 4."""
        effort, twin, mine = self.asked.effort, self._named(self.twin), self._named(self.mine)
        for place, sequence, on in self._places():
            exact = registry.dataset(sequence.dataset).seeded  # a simulated truth has no error
            yield self._sandboxed(
                f"pairs, {place}", sequence, probes.pairs_compared,
                a=twin, b=mine, on=on, count=effort.pairs, exact=exact, margins=self._margins(),
            )  # fmt: skip
            yield self._sandboxed(
                f"scans, {place}", sequence, probes.scans_compared,
                a=twin, b=mine, on=on, scans=effort.scans, margins=self._margins(),
            )  # fmt: skip
            for name in self._references():
                yield self._sandboxed(
                    f"answers of {name}, {place}", sequence, probes.pair_answers,
                    named=self._named(name), on=on, count=effort.pairs, exact=exact,
                )  # fmt: skip
        if all(self.mappers):
            for place, sequence, on in self._first_places():
                yield self._sandboxed(
                    f"mapper, {place}", sequence, probes.maps_compared,
                    a=self.mappers[1], b=self.mappers[0], on=on, scans=effort.drawn,
                )  # fmt: skip

    def _copies(self) -> Iterator[AnyTask]:
        """The twin over copies that rounding has changed."""
        for place, sequence, on in self._places():
            yield self._sandboxed(
                f"copies, {place}", sequence, probes.rounded_paths, named=self._named(self.twin), on=on, times=COPIES
            )

    def _timed(self) -> Iterator[AnyTask]:
        methods = [self._named(name) for name in self._everybody()]
        alone = [self._named(name) for name in self._registrations()]
        for place, sequence, on in self._first_places():
            yield self._sandboxed(
                f"time, {place}", sequence, pace.scans_paced, methods=methods, on=on, scans=self.asked.effort.timed
            )
            if self.mine in [one["name"] for one in alone]:
                yield self._sandboxed(
                    f"time of a pair, {place}", sequence, pace.pairs_paced,
                    methods=alone, on=on, count=self.asked.effort.pairs,
                )  # fmt: skip

    def _first_places(self) -> Iterator[tuple[str, SequenceSpec, dict[str, Any]]]:
        seen = set()
        for place, sequence, on in self._places():
            if sequence.label not in seen:
                seen.add(sequence.label)
                yield place, sequence, on

    def _sandboxed(
        self, name: str, sequence: SequenceSpec, function: Callable[Parameters, Result], /,
        *args: Parameters.args, **kwargs: Parameters.kwargs,
    ) -> AnyTask:  # fmt: skip
        """The task that calls a probe in a sandbox."""
        modules = (*self._uses(*self._everybody()), registry.plug_in_of("datasets", sequence.dataset).module)
        probe = make_task(name, function, *args, **kwargs).depending_on(*modules)
        return sandbox.sandboxed(probe, self.asked.effort.limit_s, self.asked.effort.memory_mib)

    def _named(self, name: str) -> dict[str, Any]:
        """A back end with what is given to it; the digest tells one build of a library from the next."""
        given = self.given if name == self.mine else self.given_twin if name == self.twin else {}
        return {"name": name, "given": dict(given), "digest": registry.backend(name).digest}

    def _uses(self, *names: str) -> tuple[str, ...]:
        return tuple(sorted({registry.plug_in_of("backends", name).module for name in names}))

    def _references(self) -> list[str]:
        """The references that make something of two scans: the bar does not look at them."""
        return [name for name in self.against if registry.backend(name).role != "baseline"]

    def _everybody(self) -> list[str]:
        return list(dict.fromkeys((self.mine, self.twin, *self._references())))

    def _labels(self) -> list[str]:
        return [self.mine if name == self.mine else name for name in self._everybody()]

    def _registrations(self) -> list[str]:
        return [name for name in self._everybody() if isinstance(registry.backend(name), RegistrationSpec)]


def examination(asked: Asked) -> Examination:
    """Everything checked before anything is computed; NotInstalled, UnknownName or BadParameter say what is wrong."""
    twin, why = (asked.twin, "named with --reference") if asked.twin else (defaults.reference_backend(), CHOSEN)
    for name in (asked.backend, twin):
        if why_not := _unfit(registry.backend(name)):
            raise NotInstalled(name, "cannot be validated here", why_not)
    given = _typed(asked.backend, asked.given)
    shared = {name: word for name, word in asked.given.items() if name in _parameters(twin)}
    given_twin = _typed(twin, {**shared, **asked.given_twin})
    wanted = [name for name in dict.fromkeys(asked.against) if name not in (asked.backend, twin)]
    absent = {name: missing for name in wanted if (missing := _unfit(registry.find_backend(name)))}
    here = [name for name in wanted if name not in absent]
    bars = [name for name in defaults.backends_with_role("baseline") if name not in (asked.backend, twin, *here)]
    mapper = asked.mapper or defaults.mapper_of(asked.backend)
    mappers = (mapper, defaults.mapper_of(twin)) if mapper else ("", "")
    against = (*here, *bars)
    plan = _plan(asked, twin, given, given_twin, against)
    absent |= {sequence.label: sequence.missing for sequence in plan.sequences if sequence.missing}
    plan = replace(plan, sequences=tuple(sequence for sequence in plan.sequences if not sequence.missing))
    return Examination(asked, twin, why, given, given_twin, against, absent, plan, mappers)


def _plan(
    asked: Asked, twin: str, given: Mapping[str, Value], given_twin: Mapping[str, Value], against: tuple[str, ...]
) -> Experiment:
    label = twin if twin != asked.backend else f"{twin} (twin)"
    content = {
        "method": [
            {"use": asked.backend, **given},
            {"use": twin, "label": label, **given_twin},
            *({"use": name} for name in against),
        ],
        "sequence": [_sequence(text, asked.seeds) for text in asked.on],
        "mapper": {"scans": asked.effort.map_scans},
        "limits": asdict(Limits()) | {"run_s": 3.0 * asked.effort.limit_s, "memory_mib": asked.effort.memory_mib},
    }
    return experiment_from_tables(content, "evalkit validate", "validate", f"validate {shlex.quote(asked.backend)}")


def compiled(backend: str) -> list[Path]:
    """The files of machine code a back end consists of: its library, or what its plug-in's package brings."""
    scheme, colon, rest = backend.partition(":")
    if colon and scheme == "lib":
        return [Path(split_words(backend, rest)[0]).resolve()]
    module = registry.plug_in_of("backends", backend).module
    reached = code_hash.sources(module, frozenset({module.partition(".")[0]}))
    return sorted(file for file in reached if file.suffix == ".so")


def _unfit(spec: BackendSpec) -> str:
    """Why a back end cannot run here, or does not work, or ""."""
    return spec.missing() or spec.broken


def _sequence(text: str, seeds: int) -> dict[str, Any]:
    """The table of "lab laps=0.3" for an experiment."""
    name, *words = shlex.split(text) or [""]
    spec = registry.dataset(name)
    for word in words:
        if "=" not in word:
            raise BadParameter(name, word, word, "NAME=VALUE behind the sequence's name")
    texts = {key: value for key, _, value in (word.partition("=") for word in words)}
    given = from_text(name, spec.parameters, texts)
    return {"use": name, **given, **({"seeds": list(range(seeds))} if spec.seeded else {})}


def _typed(name: str, given: Mapping[str, str]) -> dict[str, Value]:
    return from_text(name, frontend.settable_parameters(registry.backend(name)), given)


def _parameters(name: str) -> set[str]:
    return {parameter.name for parameter in frontend.settable_parameters(registry.backend(name))}


def _hopeless(level0: Level) -> bool:
    """Whether nothing more can be asked: it does not start, or does not answer."""
    broken = {name for line in level0.lines if line.outcome == "failed" for name in [line.name.removeprefix("rule ")]}
    return bool(broken & {"starts", "in-time"})


def _compared(found: Mapping[str, Result]) -> dict[str, Result]:
    """All comparisons with the twin, question by question."""
    return {f"{kind}, {place}": one for kind in ("pairs", "scans") for place, one in _of(kind, found).items()}


def _of(kind: str, found: Mapping[str, Result]) -> dict[str, Result]:
    """The results of a kind of job by place."""
    start = f"{kind}, "
    return {name.removeprefix(start): result for name, result in found.items() if name.startswith(start)}


def _placed(records: tuple[RunRecord, ...]) -> dict[str, dict[str, RunRecord]]:
    placed: dict[str, dict[str, RunRecord]] = {}
    for record in records:
        place = record.sequence if record.seed is None else f"{record.sequence}, seed {record.seed}"
        placed.setdefault(place, {})[record.method] = record
    return placed
