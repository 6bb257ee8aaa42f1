"""An experiment file made a frozen plan: every name, type and file checked before the first run."""

from __future__ import annotations

import hashlib
import json
import math
import re
import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, TypeVar

from evalkit.core.errors import BadExperiment, BadParameter, EvalkitError, UnknownName, brief
from evalkit.io.toml import load_toml
from evalkit.odometry import frontend
from evalkit.plugins import code_hash, registry
from evalkit.plugins.parameters import Value, resolve_parameters

Item = TypeVar("Item")

_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)\.", re.IGNORECASE)


@dataclass(frozen=True)
class Method:
    """A back end under a label, with all its parameters; ``missing`` says why it cannot run here, or ""."""

    label: str
    backend: str
    parameters: Mapping[str, Value]
    missing: str = ""


@dataclass(frozen=True)
class SequenceSpec:
    """A data set under a label, with all its parameters but the seed; ``seeds`` is (None,) for a recording."""

    label: str
    dataset: str
    parameters: Mapping[str, Value]
    seeds: tuple[int | None, ...]
    missing: str = ""

    def seeded(self, seed: int | None) -> dict[str, Value]:
        """The parameters of one repetition."""
        return dict(self.parameters) if seed is None else {**self.parameters, "seed": seed}


@dataclass(frozen=True)
class MapperChoice:
    """The mapper that draws every method's map, with all its parameters; at most ``scans`` scans, evenly spaced."""

    name: str
    parameters: Mapping[str, Value]
    scans: int = 400


@dataclass(frozen=True)
class Limits:
    """What one run may take: seconds in all and without an answer, by the wall clock and of CPU, and MiB of memory.

    CPU time and memory are those of the run's process and of all it has started.
    """

    run_s: float = 900.0
    scan_s: float = 60.0
    run_cpu_s: float = 3600.0
    scan_cpu_s: float = 240.0
    memory_mib: int = 2048


@dataclass(frozen=True)
class RunSpec:
    """One run to be made; ``key`` names its folder and changes with anything that could change its result."""

    key: str
    method: Method
    sequence: SequenceSpec
    seed: int | None

    @property
    def dataset_parameters(self) -> dict[str, Value]:
        """All parameters of the data set, with the seed."""
        return self.sequence.seeded(self.seed)


@dataclass(frozen=True)
class Experiment:
    """A whole comparison, ready to run. ``source``: the words of the command line that name it ("reports/x.toml").

    ``timed``: whether the runs' times count; where they do not, runs may be made beside others.
    """

    name: str
    title: str
    description: str
    source: str
    methods: tuple[Method, ...]
    sequences: tuple[SequenceSpec, ...]
    mapper: MapperChoice
    limits: Limits
    timed: bool = True

    def runs(self) -> Iterator[RunSpec]:
        """Every run, methods interleaved within each repetition, every second one in reverse: A B, B A, A B.

        A slow hour hits all alike, and nobody always runs first or always after the same one.
        """
        yield from self._runs

    @cached_property
    def _runs(self) -> tuple[RunSpec, ...]:
        code = cache(registry.run_fingerprint)  # both read files, and a plan may have thousands of runs
        files = cache(code_hash.file_state)
        repetitions = [(sequence, seed) for sequence in self.sequences for seed in sequence.seeds]
        return tuple(
            RunSpec(_key(method, sequence, seed, code, files), method, sequence, seed)
            for turn, (sequence, seed) in enumerate(repetitions)
            for method in self.methods[:: -1 if turn % 2 else 1]
        )

    def command(self, planned: RunSpec) -> str:
        """What reproduces one run alone, in a folder of its own: this plan's results and page stay."""
        seed = "" if planned.seed is None else f" --seed {planned.seed}"
        sequence, method = shlex.quote(planned.sequence.label), shlex.quote(planned.method.label)
        folder = shlex.quote(f"reports/build/{self.name}-one")
        return f"evalkit {self.source} --sequence {sequence} --method {method}{seed} --no-page --out {folder}"

    def untimed(self) -> Experiment:
        """The plan of the same runs whose times do not count."""
        return replace(self, timed=False, source=f"{self.source} --accuracy-only") if self.timed else self

    def only(self, sequences: list[str], methods: list[str], seeds: list[int]) -> Experiment:
        """The part of the plan with these labels and seeds; an empty list keeps all."""
        chosen = _chosen("sequence", sequences, self.sequences, lambda sequence: sequence.label, self.source)
        entrants = _chosen("method", methods, self.methods, lambda entrant: entrant.label, self.source)
        if seeds:
            known = {seed for sequence in chosen for seed in sequence.seeds if seed is not None}
            if unknown := set(seeds) - known:
                raise UnknownName("seed", str(min(unknown)), [str(seed) for seed in known], self.source)
            chosen = tuple(
                replace(sequence, seeds=tuple(seed for seed in sequence.seeds if seed is None or seed in seeds))
                for sequence in chosen
            )
        return replace(self, sequences=chosen, methods=entrants)


def read(path: Path) -> Experiment:
    """The plan of an experiment file (TOML); BadExperiment names the file, the key and what was found."""
    content = load_toml(path, "an experiment (*.toml)")
    return plan(content, str(path), path.stem, f"compare {shlex.quote(str(path))}")


def plan(content: Mapping[str, Any], file: str, name: str, source: str) -> Experiment:
    """The plan of an experiment's tables; ``file`` is named in errors, ``source`` in commands."""
    _known_keys(content, ("title", "description", "timed", "mapper", "limits", "method", "sequence"), file, "")
    if not isinstance(timed := content.get("timed", True), bool):
        raise BadExperiment(file, "", f"'timed': found {brief(timed)}, expected true or false")
    try:
        methods = tuple(_method(t, file, f"method {i + 1}") for i, t in _tables(content, "method", file))
        sequences = tuple(_sequence(t, file, f"sequence {i + 1}") for i, t in _tables(content, "sequence", file))
        mapper = _mapper(content.get("mapper", {}), file)
    except (UnknownName, BadParameter) as error:
        raise BadExperiment(file, "", str(error)) from error
    _distinct("method", [entrant.label for entrant in methods], file)
    _distinct("sequence", [sequence.label for sequence in sequences], file)
    return Experiment(
        name,
        _text(content, "title", name, file),
        _text(content, "description", "", file),
        source,
        methods,
        sequences,
        mapper,
        _limits(content.get("limits", {}), file),
        timed,
    )


def _method(table: Mapping[str, Any], file: str, place: str) -> Method:
    use = _required(table, "use", file, place)
    label = _label(table, use, file, place)
    given = _flat({key: value for key, value in table.items() if key not in ("use", "label")})
    spec = _registered(registry.find_backend, use, file, place)
    return Method(label, use, frontend.complete_parameters(f"{place} ({label})", spec, given), spec.missing())


def _sequence(table: Mapping[str, Any], file: str, place: str) -> SequenceSpec:
    use = _required(table, "use", file, place)
    label = _label(table, use, file, place)
    given = _flat({key: value for key, value in table.items() if key not in ("use", "label", "seeds")})
    spec = _registered(registry.dataset, use, file, place)
    if "seeds" in table and not spec.seeded:
        raise BadExperiment(file, f"{place} ({label})", f"'seeds': {use} is a recording and has none; remove the key")
    if "seed" in given and spec.seeded:
        raise BadExperiment(file, f"{place} ({label})", "found 'seed'; write seeds = [0, 1, ...]")
    seeds = _seeds(table.get("seeds", [0]), file, f"{place} ({label})") if spec.seeded else (None,)
    parameters = resolve_parameters(f"{place} ({label})", spec.parameters, given)
    if spec.seeded:
        parameters.pop("seed")
    try:
        missing = spec.missing(**parameters)
    except EvalkitError as error:
        raise BadExperiment(file, f"{place} ({label})", str(error)) from error
    if missing and spec.suffixes:  # the files of a reader are the user's own: a wrong path is a mistake
        raise BadExperiment(file, f"{place} ({label})", missing)
    return SequenceSpec(label, use, parameters, seeds, missing)


def _mapper(table: object, file: str) -> MapperChoice:
    if not isinstance(table, Mapping):
        raise BadExperiment(file, "mapper", f"found {brief(table)}, expected a table [mapper] with use = NAME")
    name = _text(table, "use", "log-odds", file, "mapper")
    scans = table.get("scans", MapperChoice.scans)
    if not isinstance(scans, int) or isinstance(scans, bool) or scans < 2:
        raise BadExperiment(file, "mapper", f"'scans': found {brief(scans)}, expected a whole number of at least 2")
    given = {key: value for key, value in table.items() if key not in ("use", "scans")}
    spec = _registered(registry.mapper, name, file, "mapper")
    return MapperChoice(name, resolve_parameters("mapper", spec.parameters, given), scans)


def _limits(table: object, file: str) -> Limits:
    known = asdict(Limits())
    if not isinstance(table, Mapping):
        raise BadExperiment(file, "limits", f"found {brief(table)}, expected a table [limits]")
    _known_keys(table, known, file, "limits")
    for key, value in table.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < math.inf:
            raise BadExperiment(file, "limits", f"'{key}': found {brief(value)}, expected a positive number")
    return Limits(**{**known, **table})


def _tables(content: Mapping[str, Any], key: str, file: str) -> list[tuple[int, Mapping[str, Any]]]:
    tables = content.get(key, [])
    if not isinstance(tables, list) or not all(isinstance(table, Mapping) for table in tables):
        raise BadExperiment(file, key, f"expected tables [[{key}]]")
    if not tables:
        raise BadExperiment(file, "", f"no [[{key}]]: an experiment needs at least one")
    return list(enumerate(tables))


def _registered(find: Callable[[str], Item], name: str, file: str, place: str) -> Item:
    try:
        return find(name)
    except UnknownName as error:
        raise BadExperiment(file, place, str(error)) from error


def _seeds(seeds: object, file: str, place: str) -> tuple[int, ...]:
    if not isinstance(seeds, list) or not seeds or not all(type(seed) is int and seed >= 0 for seed in seeds):
        raise BadExperiment(file, place, f"'seeds': found {brief(seeds)}, expected a list of whole numbers from 0")
    return tuple(dict.fromkeys(seeds))


def _required(table: Mapping[str, Any], key: str, file: str, place: str) -> str:
    if key not in table:
        raise BadExperiment(file, place, f"missing key '{key}'")
    return _text(table, key, "", file, place)


def _label(table: Mapping[str, Any], use: str, file: str, place: str) -> str:
    """The name in tables, on the terminal and in files: nothing that a reader of one of them takes for a command."""
    label = _text(table, "label", use, file, place)
    if not label or not label.isprintable() or label[0] in "=+-@":
        expected = "printable text; a spreadsheet takes what begins with one of = + - @ for a formula"
        raise BadExperiment(file, place, f"'label': found {brief(label)}, expected {expected}")
    return label


def _text(table: Mapping[str, Any], key: str, default: str, file: str, place: str = "") -> str:
    value = table.get(key, default)
    if not isinstance(value, str):
        raise BadExperiment(file, place, f"'{key}': found {brief(value)}, expected a text")
    return value


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables with dotted names: ``s2s.one_to_one = false`` in TOML is such a table."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat.update(_flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {prefix + key: value})
    return flat


def _known_keys(table: Mapping[str, Any], known: Mapping[str, Any] | tuple[str, ...], file: str, place: str) -> None:
    for key in table:
        if key not in known:
            raise BadExperiment(file, place, str(UnknownName("key", key, known)))


def _distinct(kind: str, labels: list[str], file: str) -> None:
    for label, count in Counter(labels).items():
        if count > 1:
            raise BadExperiment(file, "", f"two {kind}s are labelled '{label}'; give one a label = \"...\" of its own")


def _chosen(
    kind: str, wanted: list[str], known: tuple[Item, ...], label: Callable[[Item], str], where: str
) -> tuple[Item, ...]:
    for name in wanted:
        if name not in map(label, known):
            raise UnknownName(kind, name, map(label, known), where)
    return tuple(item for item in known if not wanted or label(item) in wanted)


def _key(
    method: Method,
    sequence: SequenceSpec,
    seed: int | None,
    code: Callable[[str, str], str],
    files: Callable[[str], list[object]],
) -> str:
    identity = {
        "labels": [method.label, sequence.label],  # two that read alike as file names must not share a folder
        "backend": [method.backend, dict(method.parameters)],
        "dataset": [sequence.dataset, sequence.seeded(seed)],
        "code": "" if method.missing else code(method.backend, sequence.dataset),
        "files": [files(value) for value in sequence.parameters.values() if isinstance(value, str) and value],
    }
    digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:10]
    words = [sequence.label, *([] if seed is None else [f"s{seed}"]), method.label]
    return "-".join(_filename(word) for word in words) + f"-{digest}"


def _filename(word: str) -> str:
    """A word as part of a file's name on any system: short in bytes, and no name of a device ("nul.txt")."""
    plain = "".join(char if char.isalnum() or char in "._" else "-" for char in word).strip("-.")
    short = plain.encode()[:60].decode(errors="ignore") or "x"
    return f"x-{short}" if _DEVICE.match(short) else short
