"""Read an experiment file, and check all that it says."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from evalkit.config.experiment import Experiment, MapperChoice, Method, SequenceSpec
from evalkit.config.forms import EXPERIMENT, LIMITS, MAPPER, METHOD, SEQUENCE
from evalkit.config.limits import Limits
from evalkit.config.localisation import read_localisation
from evalkit.config.toml_tables import TomlTable, all_mistakes, flatten
from evalkit.core.errors import BadExperiment, EvalkitError, brief
from evalkit.io.toml import load_toml
from evalkit.odometry import frontend
from evalkit.plugins import defaults, registry
from evalkit.plugins.parameters import EXCERPT, NUISANCE, resolve_parameters
from evalkit.plugins.result_files import is_same_result
from evalkit.plugins.specs import RecordedOdometrySpec, RecordedSlamSpec

GROUND_TRUTH = "ground_truth"
"""The parameter of readers that names a true trajectory."""

NUISANCE_KEYS = (NUISANCE, EXCERPT)
MAX_NUISANCE = 64
MIN_EXCERPT_SCANS = 50
MAX_LABEL = 500


def load_experiment(path: Path) -> Experiment:
    """Load an experiment file (TOML). Raises BadExperiment with the file, the key and what was found."""
    content = load_toml(path, "an experiment (*.toml)")
    with all_mistakes(content, "experiment"):
        return experiment_from_tables(content, str(path), path.stem, f"compare {shlex.quote(str(path))}")


def experiment_from_tables(content: Mapping[str, Any], file: str, name: str, source: str) -> Experiment:
    """The experiment that TOML tables describe. ``file``: named in errors; ``source``: used in commands."""
    table = TomlTable(content, file, form=EXPERIMENT)
    table.check_keys()
    with table.errors():
        methods = tuple(_read_method(each) for each in table.tables("method", "an experiment"))
        repeats = _read_nuisance(table, (0, 0))
        sequences = tuple(_read_sequence(each, repeats) for each in table.tables("sequence", "an experiment"))
        mapper = _read_mapper(table.table("mapper", " with use = NAME"))
    _require_distinct("method", [method.label for method in methods], file)
    _require_distinct("sequence", [sequence.label for sequence in sequences], file)
    for sequence in sequences:
        _require_other_than_truth(methods, sequence, file)
    return Experiment(
        name,
        table.text("title", name),
        table.text("description"),
        source,
        methods,
        sequences,
        mapper,
        _read_limits(table.table("limits", "")),
        table.flag("timed"),
    )


def _read_method(table: TomlTable) -> Method:
    use, label = table.text("use"), _read_label(table)
    given = flatten({key: value for key, value in table.content.items() if key not in METHOD.keys})
    with table.errors():
        spec = registry.find_backend(use)
        for name in table.texts("tuned_on"):
            registry.dataset(name)
    tuned_on = tuple(dict.fromkeys((*spec.tuned_on, *table.texts("tuned_on"))))
    parameters = frontend.complete_parameters(table.with_label(label).place, spec, given)
    return Method(label, use, parameters, spec.missing(), tuned_on)


def _read_nuisance(table: TomlTable, default: tuple[int, int]) -> tuple[int, int]:
    """The number of perturbations of each recording, and the scans of each (0: all)."""
    count, scans = (table.whole_number(key, value) for key, value in zip(NUISANCE_KEYS, default, strict=True))
    if count == 1 or count > MAX_NUISANCE:
        raise table.bad_value(NUISANCE, f"0, or 2 to {MAX_NUISANCE} perturbations")
    if 0 < scans < MIN_EXCERPT_SCANS:
        raise table.bad_value(EXCERPT, f"0 for whole recordings, or at least {MIN_EXCERPT_SCANS} scans")
    return count, scans


def _read_sequence(table: TomlTable, repeats: tuple[int, int]) -> SequenceSpec:
    use, label = table.text("use"), _read_label(table)
    given = flatten({key: value for key, value in table.content.items() if key not in SEQUENCE.keys})
    with table.errors():
        spec = registry.dataset(use)
    table = table.with_label(label)
    if "seeds" in table.content and not spec.seeded:
        raise table.error(f"'seeds': {use} is a recording and has none; remove the key")
    if "seed" in given and spec.seeded:
        raise table.error("found 'seed'; write seeds = [0, 1, ...]")
    if spec.seeded and any(key in table.content for key in NUISANCE_KEYS):
        raise table.error(f"'nuisance': {use} has seeds; write seeds = [0, 1, ...]")
    count, scans = (0, 0) if spec.seeded else _read_nuisance(table, repeats)
    seeds: tuple[int | None, ...] = table.whole_numbers("seeds") if spec.seeded else (None,)
    parameters = resolve_parameters(table.place, spec.parameters, given)
    if spec.seeded:
        parameters.pop("seed")
    try:
        missing = spec.missing(**parameters)
    except EvalkitError as error:
        raise table.error(str(error)) from error
    if missing and spec.suffixes:  # the user names a reader's files: a wrong path is a mistake of the file
        raise table.error(missing)
    known = read_localisation(table)
    if not count or missing:
        return SequenceSpec(label, use, parameters, seeds, missing, localisation=known)
    numbers = (*(() if scans else seeds), *range(1, count + 1))
    return SequenceSpec(label, use, parameters, numbers, perturbed=True, excerpt_scans=scans, localisation=known)


def _read_mapper(table: TomlTable) -> MapperChoice:
    name = table.text("use") if "use" in table.content else defaults.find_default_mapper()
    scans = table.whole_number("scans")
    given = {key: value for key, value in table.content.items() if key not in MAPPER.keys}
    with table.errors():
        spec = registry.mapper(name)
    return MapperChoice(name, resolve_parameters("mapper", spec.parameters, given), scans)


def _read_limits(table: TomlTable) -> Limits:
    table.check_keys()
    return Limits(**{key: table.positive_number(key) for key in LIMITS.keys})  # type: ignore[arg-type]


def _read_label(table: TomlTable) -> str:
    """The label of a method or sequence; refuses text that a terminal, spreadsheet or file system would interpret."""
    label = table.text("label", table.text("use"))
    if not label or not label.isprintable() or label[0] in "=+-@" or len(label) > MAX_LABEL:
        limit = f"printable text of at most {MAX_LABEL} characters"
        expected = f"{limit}; a spreadsheet reads text that begins with one of = + - @ as a formula"
        raise table.error(f"'label': found {brief(label)}, expected {expected}")
    return label


def _require_distinct(kind: str, labels: list[str], file: str) -> None:
    for label, count in Counter(labels).items():
        if count > 1:
            raise BadExperiment(file, "", f"two {kind}s are labelled '{label}'; give one a label = \"...\" of its own")


def _require_other_than_truth(methods: tuple[Method, ...], sequence: SequenceSpec, file: str) -> None:
    """Raise BadExperiment for poses computed elsewhere that are the ground truth: their error is zero."""
    truth = str(sequence.parameters.get(GROUND_TRUTH, ""))
    for method in methods if truth else ():
        spec = registry.find_backend(method.backend)
        own = spec.addresses if isinstance(spec, (RecordedOdometrySpec, RecordedSlamSpec)) else ()
        if any(is_same_result(each, truth) for each in own):
            what = f"'{method.label}': its poses are the ground truth of {sequence.label}, {truth}: its error is zero"
            remedy = f"give another ground truth ({GROUND_TRUTH}, --ground-truth), or leave the method out"
            raise BadExperiment(file, "", f"{what}; {remedy}")
