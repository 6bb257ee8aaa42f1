"""Experiments: the methods and sequences of a comparison, and the runs that it describes."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import TypeVar

from evalkit.config.forms import MAPPER
from evalkit.config.limits import Limits
from evalkit.config.localisation import list_map_files
from evalkit.core.errors import UnknownName
from evalkit.plugins import code_hash, registry
from evalkit.plugins.parameters import EXCERPT, NUISANCE, Value

Item = TypeVar("Item")

RESULTS = Path("evalkit-results")
"""Folder of the results folders of commands that are given none."""

_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)\.", re.IGNORECASE)


@dataclass(frozen=True)
class Method:
    """A back end with all its parameters under a label. ``missing``: why it cannot run here, "" if it can.

    ``tuned_on``: data sets that parameters of this method were chosen on, by its spec or by the experiment.
    """

    label: str
    backend: str
    parameters: Mapping[str, Value]
    missing: str = ""
    tuned_on: tuple[str, ...] = ()


@dataclass(frozen=True)
class SequenceSpec:
    """A data set with all its parameters except the seed, under a label.

    ``seeds``: one per repetition. A recording has (None,), and the numbers of its perturbations (``plugins.nuisance``)
    if it is ``perturbed``; with ``excerpt_scans`` every perturbation is an excerpt of so many scans, and the whole
    recording is not run. ``missing``: why the data are not available here, or "". ``localisation``: the reserved
    parameters of a known map in which the methods track the robot (``plugins.parameters``); empty without one.
    ``warnings``: doubts about the data that the reader of a recording found.
    """

    label: str
    dataset: str
    parameters: Mapping[str, Value]
    seeds: tuple[int | None, ...]
    missing: str = ""
    perturbed: bool = False
    excerpt_scans: int = 0
    localisation: Mapping[str, Value] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def parameters_with_seed(self, seed: int | None) -> dict[str, Value]:
        """The parameters of one repetition."""
        parameters = {**self.parameters, **self.localisation}
        if seed is None:
            return parameters
        if not self.perturbed:
            return {**parameters, "seed": seed}
        return {**parameters, NUISANCE: seed} | ({EXCERPT: self.excerpt_scans} if self.excerpt_scans else {})


def name_repetition(seed: int | None, perturbed: bool) -> str:
    """Return the name of a repetition: "seed 3", or of a recording "perturbation 2"; "" for its data as they are."""
    if seed is None:
        return ""
    return f"perturbation {seed}" if perturbed else f"seed {seed}"


@dataclass(frozen=True)
class MapperChoice:
    """The mapper for the maps of all methods, with its parameters; maps hold at most ``scans`` evenly spaced scans."""

    name: str
    parameters: Mapping[str, Value]
    scans: int = MAPPER.default("scans")


@dataclass(frozen=True)
class RunSpec:
    """One run: what to run. ``key``: name of its folder; changes with everything that can change the result."""

    key: str
    method: Method
    sequence: SequenceSpec
    seed: int | None

    @property
    def repetition(self) -> str:
        """What tells the run from the others of its method and sequence: "seed 3", "perturbation 2"; "" without."""
        return name_repetition(self.seed, self.sequence.perturbed)

    @property
    def dataset_parameters(self) -> dict[str, Value]:
        """All parameters of the data set, with the seed."""
        return self.sequence.parameters_with_seed(self.seed)


@dataclass(frozen=True)
class Experiment:
    """Methods, sequences, mapper and limits of a comparison, complete and checked.

    ``source``: the command line that runs it, without "evalkit". ``timed``: whether times count; if not, runs may
    share the machine with other work.
    ``arguments``: those of ``evalkit.compare`` in Python, for methods that no command line can state; else empty.
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
    arguments: Mapping[str, object] = field(default_factory=dict)

    def runs(self) -> Iterator[RunSpec]:
        """Every run, with the methods interleaved in each repetition and every second repetition in reverse: AB BA AB.

        So a slow hour affects all methods alike where all runs are of one call, and no method always runs first or
        after the same method.
        """
        yield from self._runs

    @cached_property
    def _runs(self) -> tuple[RunSpec, ...]:
        code = cache(registry.hash_run_code)  # both read files, and an experiment may have thousands of runs
        files = cache(code_hash.read_file_state)
        repetitions = [(sequence, seed) for sequence in self.sequences for seed in sequence.seeds]
        return tuple(
            RunSpec(_compute_key(method, sequence, seed, code, files), method, sequence, seed)
            for turn, (sequence, seed) in enumerate(repetitions)
            for method in self.methods[:: -1 if turn % 2 else 1]
        )

    @property
    def whole_command(self) -> str:
        """The command line that repeats the experiment. It sets PYTHONPATH where a plug-in is found by it."""
        whole = self._python_call() if self.arguments else f"evalkit {self.source}"
        return _environment(self.methods, self.sequences) + whole

    def command(self, spec: RunSpec) -> str:
        """The command line that reproduces one run alone in a folder of its own; other results stay untouched.

        It sets PYTHONPATH where a plug-in is found by it. With ``arguments``, it repeats all runs in that folder.
        """
        folder, environment = f"{RESULTS}/{self.name}-one", _environment((spec.method,), (spec.sequence,))
        if self.arguments:
            return environment + self._python_call(out=folder)
        seed = "" if spec.seed is None else f" --seed {spec.seed}"
        sequence, method = shlex.quote(spec.sequence.label), shlex.quote(spec.method.label)
        words = f"evalkit {self.source} --sequence {sequence} --method {method}{seed} --no-page --out"
        return f"{environment}{words} {shlex.quote(folder)}"

    def _python_call(self, **more: object) -> str:
        arguments = ", ".join(
            f"{name}={value!r}" for name, value in {**self.arguments, **more, "resume": False}.items()
        )
        code = f"import sys, evalkit; evalkit.compare(sys.argv[1], {arguments})"
        return shlex.join(["python", "-c", code, shlex.split(self.source)[1]])

    def without_times(self) -> Experiment:
        """The same experiment with times that do not count."""
        return replace(self, timed=False, source=f"{self.source} --accuracy-only") if self.timed else self

    def select(self, sequences: list[str], methods: list[str], seeds: list[int]) -> Experiment:
        """The part of the experiment with these labels and seeds; an empty list selects all."""
        chosen = _select("sequence", sequences, self.sequences, lambda sequence: sequence.label, self.source)
        chosen_methods = _select("method", methods, self.methods, lambda method: method.label, self.source)
        if seeds:
            known = {seed for sequence in chosen for seed in sequence.seeds if seed is not None}
            if unknown := set(seeds) - known:
                raise UnknownName("seed", str(min(unknown)), [str(seed) for seed in known], self.source)
            chosen = tuple(
                replace(sequence, seeds=tuple(seed for seed in sequence.seeds if seed is None or seed in seeds))
                for sequence in chosen
            )
        return replace(self, sequences=chosen, methods=chosen_methods)


def _environment(methods: Iterable[Method], sequences: Iterable[SequenceSpec]) -> str:
    """Return the setting of PYTHONPATH by which the plug-ins are found, "" where they are installed."""
    paths = [registry.find_search_path(one.backend, other.dataset) for one in methods for other in sequences]
    entries = dict.fromkeys(entry for path in paths for entry in path.split(os.pathsep) if entry)
    return f"PYTHONPATH={shlex.quote(os.pathsep.join(entries))} " if entries else ""


def _select(
    kind: str, wanted: list[str], known: tuple[Item, ...], label: Callable[[Item], str], where: str
) -> tuple[Item, ...]:
    for name in wanted:
        if name not in map(label, known):
            raise UnknownName(kind, name, map(label, known), where)
    return tuple(item for item in known if not wanted or label(item) in wanted)


def _compute_key(
    method: Method,
    sequence: SequenceSpec,
    seed: int | None,
    code: Callable[[str, str], str],
    files: Callable[[str], list[object]],
) -> str:
    identity = {
        "labels": [method.label, sequence.label],  # labels with equal file names must not share a folder
        "backend": [method.backend, dict(method.parameters)],
        "dataset": [sequence.dataset, sequence.parameters_with_seed(seed)],
        "code": "" if method.missing else code(method.backend, sequence.dataset),
        "files": [files(value) for value in sequence.parameters.values() if isinstance(value, str) and value],
        **({"map": [files(file) for file in list_map_files(sequence.localisation)]} if sequence.localisation else {}),
    }
    digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:10]
    words = [sequence.label, *([] if seed is None else [f"s{seed}"]), method.label]
    return "-".join(_make_filename(word) for word in words) + f"-{digest}"


def _make_filename(word: str) -> str:
    """A word as part of a file name on any system: at most 60 bytes, and not the name of a device ("nul.txt")."""
    plain = "".join(char if char.isalnum() or char in "._" else "-" for char in word).strip("-.")
    short = plain.encode()[:60].decode(errors="ignore") or "x"
    return f"x-{short}" if _DEVICE.match(short) else short
