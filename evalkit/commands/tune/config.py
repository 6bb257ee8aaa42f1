"""Read a tuning file: names, bounds, seeds and disjoint worlds are checked before the first run."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from evalkit.commands.tune.plan import TUNED, Training, TunableMethod, Tuning
from evalkit.commands.tune.space import METHOD, SHARED, Space, list_own_parameters, make_declared_factors, settings
from evalkit.config.experiment import Experiment, Method, SequenceSpec
from evalkit.config.experiment_file import experiment_from_tables
from evalkit.config.forms import TUNING
from evalkit.config.toml_tables import TomlTable, all_mistakes
from evalkit.core.errors import BadExperiment, UnknownName
from evalkit.design.factors import Factor, read_factor
from evalkit.design.responses import Response
from evalkit.io.toml import load_toml
from evalkit.metrics import all_metrics, spans
from evalkit.plugins import registry
from evalkit.plugins.parameter_parsing import parse_dataset_without_seed
from evalkit.plugins.parameters import Parameter, Value

MIN_CONFIRM_RUNS = 4
"""Fewest runs on fresh seeds to decide on: fewer give no useful interval."""

OWN_SEEDS = "a tuning takes 0 and 1 to search with, 10 to 13 to confirm and 20 to 25 held out"
"""The seeds of a simulated data set that is named on the command line."""


def load_tuning(path: Path, name: str, command: str) -> Tuning:
    """The tuning of a file (TOML). Raises BadExperiment with the file, the key and what was found."""
    content = load_toml(path, "a tuning (*.toml), or back ends and --on DATASET")
    with all_mistakes(content, "tuning"):
        return tuning_from_tables(content, str(path), name, command)


def tuning_from_tables(content: Mapping[str, Any], file: str, name: str, command: str) -> Tuning:
    """The tuning of a file's tables; ``file`` is named in errors, ``command`` runs the tuning."""
    table = TomlTable(content, file, form=TUNING)
    table.check_keys()
    methods = table.tables("method", "a tuning")
    held_out = _make_plan(table, table.tables("held-out", "a tuning"), "held-out")
    for method in held_out.methods:
        if method.label.endswith(TUNED):
            what = f"'label': found {method.label!r}, but tuned methods end in '{TUNED}'; take another label"
            raise BadExperiment(file, "method", what)
    training = _read_training(table)
    _check_disjoint(training, held_out.sequences, file)
    return Tuning(
        name,
        table.text("title", name),
        table.text("description"),
        command,
        table.whole_number("points"),
        table.whole_number("seed"),
        _read_objective(table.table("objective", " with metric and lost")),
        table.number("run_cpu_s"),
        tuple(
            _make_tunable(each.with_label(method.label), method)
            for each, method in zip(methods, held_out.methods, strict=True)
        ),
        training,
        held_out.sequences,
        held_out.mapper,
        held_out.limits,
    )


def make_tuning_tables(
    backends: Sequence[str], on: Sequence[str], held_out: Sequence[str], budget: int, given: Mapping[str, str]
) -> dict[str, Any]:
    """The tables of a tuning of back ends and data sets named on the command line.

    Each training world has two seeds to search with and four to confirm; each held-out world (by default the training
    worlds) has six fresh seeds. ``on``, ``held_out``: data sets, as "NAME laps=0.3". ``given``: parameters of every
    data set, as text.
    """

    def sequence(text: str, **seeds: list[int]) -> dict[str, Any]:
        dataset, parameters = parse_dataset_without_seed(text, OWN_SEEDS, given)
        return {"use": dataset, "label": text, **parameters, **(seeds if registry.dataset(dataset).seeded else {})}

    return {
        "title": f"Fair tuning on {', '.join(on)}",
        "points": budget,
        "method": [{"use": name} for name in backends],
        "training": [sequence(name, seeds=[0, 1], confirm=[10, 11, 12, 13]) for name in on],
        "held-out": [sequence(name, seeds=[20, 21, 22, 23, 24, 25]) for name in held_out or on],
    }


def _make_plan(table: TomlTable, sequences: Sequence[TomlTable], kind: str) -> Experiment:
    """The experiment of the methods on some sequences; ``kind`` names these in errors."""
    methods = [_remove_key(each, "search") for each in table.tables("method", "a tuning")]
    rest = {key: table.content[key] for key in ("mapper", "limits") if key in table.content}
    own = [_remove_key(each, "confirm") if kind == "training" else each.content for each in sequences]
    content = {**rest, "method": methods, "sequence": own}
    try:
        return experiment_from_tables(content, table.file, "tuning", "tuning")
    except BadExperiment as error:
        where, place, what = error.args
        what = re.sub(r"^sequence(?= \d)|sequences", kind, what)
        raise BadExperiment(where, place.replace("sequence", kind), what) from error


def _remove_key(table: TomlTable, key: str) -> dict[str, Any]:
    return {name: value for name, value in table.content.items() if name != key}


def _read_training(table: TomlTable) -> tuple[Training, ...]:
    tables = table.tables("training", "a tuning")
    sequences = _make_plan(table, tables, "training").sequences
    training = []
    for each, sequence in zip(tables, sequences, strict=True):
        place = each.with_label(sequence.label)
        if sequence.missing:
            raise place.error(f"cannot be trained on here: {sequence.missing}")
        training.append(Training(sequence, _read_confirm_seeds(place, sequences, sequence)))
    if sum(len(one.confirm) for one in training) < MIN_CONFIRM_RUNS:
        what = (
            "'confirm': the best point is compared with the default on fresh seeds, and it takes "
            f"{MIN_CONFIRM_RUNS} runs in all, e.g. confirm = [100, 101, 102, 103]; recordings have no seeds, so train "
            "on a simulated world too"
        )
        raise BadExperiment(table.file, "training", what)
    return tuple(training)


def _read_confirm_seeds(table: TomlTable, sequences: Sequence[SequenceSpec], sequence: SequenceSpec) -> tuple[int, ...]:
    """The fresh seeds of a sequence: no training table searches with any of them on the same data set."""
    seeds = table.whole_numbers("confirm", empty=True)
    if seeds and sequence.seeds == (None,):
        raise table.error(f"'confirm': {sequence.dataset} is a recording and has no seeds; remove the key")
    searched = {seed for each in sequences if each.dataset == sequence.dataset for seed in each.seeds}
    if both := sorted(set(seeds) & searched):
        raise table.error(f"'confirm': seed {both[0]} is searched with too; take fresh ones")
    return seeds


def _check_disjoint(training: Sequence[Training], held_out: Sequence[SequenceSpec], file: str) -> None:
    """Refuses a world and seed, or a recording, in both training and held-out tables, whatever its parameters."""
    trained = {one: each.sequence.label for each in training for one in _identify_data(each.sequence, each.confirm)}
    for sequence in held_out:
        for identity in _identify_data(sequence, ()):
            if identity in trained:
                name, seed = identity
                subject = f"{name} is" if seed is None else f"{name} with seed {seed} is"
                what = f"{subject} in training too ({trained[identity]}); judge on another world, seed or recording"
                raise BadExperiment(file, f"held-out ({sequence.label})", what)


def _identify_data(sequence: SequenceSpec, more: Sequence[int]) -> set[tuple[str, int | None]]:
    """What a sequence shows: its world with each seed, or its recording by name and by the file it reads."""
    seeded = registry.dataset(sequence.dataset).seeded
    if seeded:
        return {(sequence.dataset, seed) for seed in (*sequence.seeds, *more)}
    path = sequence.parameters.get("path")
    return {(str(Path(path).resolve()) if isinstance(path, str) and path else sequence.dataset, None)}


def _make_tunable(table: TomlTable, method: Method) -> TunableMethod:
    """A method with the space to search: what its table names, or what its back end's parameters declare."""
    default = method.parameters
    spec = registry.find_backend(method.backend)
    unusable = bool(method.missing or spec.broken)
    parameters = () if unusable else list_own_parameters(spec)
    if "search" not in table.content or unusable:
        factors, excluded = make_declared_factors([p for p in parameters if p.name in default], default)
        return TunableMethod(method, Space(factors, default), excluded)
    search = table.content["search"]
    if not isinstance(search, Mapping):
        raise table.bad_value("search", "a table of parameters and their levels")
    known = {parameter.name: parameter for parameter in parameters}
    chosen = tuple(
        _make_factor(replace(table, place=f"{table.place}: search.{name}"), name, value, known, default)
        for name, value in search.items()
    )
    excluded = {name: "not named in 'search'" for name in known if name not in search}
    return TunableMethod(method, Space(chosen, default), excluded)


def _make_factor(
    table: TomlTable, name: str, value: object, known: Mapping[str, Parameter], default: Mapping[str, Value]
) -> Factor:
    """The factor of one parameter; ``value``: its levels, or a table with ``levels`` and other keys of a factor."""
    if name in SHARED:
        raise table.error(
            "a parameter of the front end, which is the same for all methods; set it as a fixed value of the method if "
            "it must differ"
        )
    if name not in known:
        raise table.error(str(UnknownName("parameter", name, known)))
    content = dict(value) if isinstance(value, Mapping) else {"levels": value}
    levels = content.get("levels")
    if isinstance(known[name].default, float) and isinstance(levels, list):
        content["levels"] = [float(level) if type(level) is int else level for level in levels]
    base = {f"{METHOD}{each}": setting for each, setting in default.items()}
    complete = {"sets": f"{METHOD}{name}", "name": name, "unit": known[name].unit, **content}
    factor = read_factor(replace(table, content=complete), base)
    with table.errors():
        for level in factor.levels:
            for setting in settings(level).values():
                known[name].check("levels", setting)
    return factor


def _read_objective(table: TomlTable) -> Response:
    table.check_keys()
    with_walls = {metric.name for metric in spans.METRICS}  # spans end at walls; training runs draw no map
    metrics = {m.name: m for m in all_metrics() if m.better == "lower" and m.group in ("drift", "relations")}
    known = {name: metric for name, metric in metrics.items() if (metric.counterpart or name) not in with_walls}
    metric = table.choice("metric", "error of a trajectory whose lower values are better", known)
    return Response(metric, "log", table.number("lost"))
