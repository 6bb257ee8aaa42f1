"""A tuning file made a plan: names, bounds, seeds and disjoint worlds are checked before the first run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from evalkit.commands.study.factors import Factor, factor
from evalkit.commands.study.plan import Response
from evalkit.commands.tune.plan import TUNED, Entrant, Training, Tuning
from evalkit.commands.tune.space import METHOD, SHARED, Space, derived, own, settings
from evalkit.config import experiment
from evalkit.config.experiment import Experiment, Method, SequenceSpec
from evalkit.core.errors import BadExperiment, BadParameter, UnknownName, brief
from evalkit.io.toml import load_toml
from evalkit.metrics import all_metrics, spans
from evalkit.plugins import registry
from evalkit.plugins.parameter_parsing import from_text
from evalkit.plugins.parameters import Parameter, Value

TOP = ("title", "description", "points", "seed", "run_cpu_s", "objective", "mapper", "limits", "method",
       "training", "held-out")  # fmt: skip
POINTS = 24
MIN_CONFIRMING = 4
"""Runs on fresh seeds that a decision takes: fewer have no interval worth the name."""

METRIC, LOST_M, RUN_CPU_S = "ate_rmse_m", 1.0, 60.0


def read(path: Path, name: str, command: str) -> Tuning:
    """The tuning of a file (TOML); BadExperiment names the file, the key and what was found."""
    content = load_toml(path, "a tuning (*.toml), or back ends and --on DATASET")
    return tuning(content, str(path), name, command)


def tuning(content: Mapping[str, Any], file: str, name: str, command: str) -> Tuning:
    """The tuning of a file's tables; ``file`` is named in errors, ``command`` runs it."""
    for key in content:
        if key not in TOP:
            raise BadExperiment(file, "", str(UnknownName("key", key, TOP)))
    methods = _tables(content, "method", file)
    held_out = _plan(content, methods, _tables(content, "held-out", file), file, "held-out")
    for method in held_out.methods:
        if method.label.endswith(TUNED):
            told = f"'label': found {method.label!r}, but tuned rows are to end in '{TUNED}'; take another"
            raise BadExperiment(file, "method", told)
    training = _training(content, methods, file)
    _disjoint(training, held_out.sequences, file)
    entrants = [
        _entrant(table, method, file, f"method {number + 1} ({method.label})")
        for number, (table, method) in enumerate(zip(methods, held_out.methods, strict=True))
    ]
    return Tuning(
        name,
        str(content.get("title", name)),
        str(content.get("description", "")),
        command,
        int(_number(content, "points", POINTS, file, whole=True, least=2)),
        int(_number(content, "seed", 0, file, whole=True, least=0)),
        _objective(content.get("objective", {}), file),
        _number(content, "run_cpu_s", RUN_CPU_S, file, least=1e-3),
        tuple(entrants),
        training,
        held_out.sequences,
        held_out.mapper,
        held_out.limits,
    )


def named(
    backends: Sequence[str], on: Sequence[str], held_out: Sequence[str], budget: int, given: Mapping[str, str]
) -> dict[str, Any]:
    """The tables of a tuning of back ends named on the command line, on data sets named there.

    Two seeds of each training world to search with, four to confirm, six fresh ones of it (or of the worlds held out)
    to judge on; ``given`` are settings of every data set.
    """

    def sequence(dataset: str, **seeds: list[int]) -> dict[str, Any]:
        spec = registry.dataset(dataset)
        parameters = from_text(dataset, spec.parameters, given)
        return {"use": dataset, **parameters, **(seeds if spec.seeded else {})}

    return {
        "title": f"Fair tuning on {', '.join(on)}",
        "points": budget,
        "method": [{"use": name} for name in backends],
        "training": [sequence(name, seeds=[0, 1], confirm=[10, 11, 12, 13]) for name in on],
        "held-out": [sequence(name, seeds=[20, 21, 22, 23, 24, 25]) for name in held_out or on],
    }


def _plan(
    content: Mapping[str, Any], methods: Sequence[Any], sequences: Sequence[Any], file: str, kind: str
) -> Experiment:
    """The experiment of the methods on some sequences; ``kind`` names these in errors."""
    bare = [{key: value for key, value in table.items() if key != "search"} for table in methods]
    rest = {key: content[key] for key in ("mapper", "limits") if key in content}
    try:
        return experiment.plan({**rest, "method": bare, "sequence": sequences}, file, "tuning", "tuning")
    except BadExperiment as error:
        where, place, what = error.args
        raise BadExperiment(where, place.replace("sequence", kind), what.replace("sequences", kind)) from error


def _training(content: Mapping[str, Any], methods: Sequence[Any], file: str) -> tuple[Training, ...]:
    tables = _tables(content, "training", file)
    bare = [{key: value for key, value in table.items() if key != "confirm"} for table in tables]
    sequences = _plan(content, methods, bare, file, "training").sequences
    found = []
    for number, (table, sequence) in enumerate(zip(tables, sequences, strict=True)):
        place = f"training {number + 1} ({sequence.label})"
        if sequence.missing:
            raise BadExperiment(file, place, f"cannot be trained on here: {sequence.missing}")
        found.append(Training(sequence, _confirm(table, sequences, sequence, file, place)))
    if sum(len(one.confirm) for one in found) < MIN_CONFIRMING:
        told = (
            "'confirm': the best point is compared with the default on fresh seeds, and it takes "
            f"{MIN_CONFIRMING} runs in all, e.g. confirm = [100, 101, 102, 103]; recordings have no seeds, so train "
            "on a simulated world too"
        )
        raise BadExperiment(file, "training", told)
    return tuple(found)


def _confirm(
    table: Mapping[str, Any], sequences: Sequence[SequenceSpec], sequence: SequenceSpec, file: str, place: str
) -> tuple[int, ...]:
    """The fresh seeds of a sequence: its world is searched with none of them, in no other training table either."""
    seeds = table.get("confirm", [])
    if not isinstance(seeds, list) or not all(type(seed) is int and seed >= 0 for seed in seeds):
        raise BadExperiment(file, place, f"'confirm': found {brief(seeds)}, expected a list of whole numbers from 0")
    if seeds and sequence.seeds == (None,):
        raise BadExperiment(
            file, place, f"'confirm': {sequence.dataset} is a recording and has no seeds; remove the key"
        )
    searched = {seed for each in sequences if each.dataset == sequence.dataset for seed in each.seeds}
    if both := sorted(set(seeds) & searched):
        raise BadExperiment(file, place, f"'confirm': seed {both[0]} is searched with too; take fresh ones")
    return tuple(dict.fromkeys(seeds))


def _disjoint(training: Sequence[Training], held_out: Sequence[SequenceSpec], file: str) -> None:
    """Refuses a world and seed, or a recording, that is trained on and judged on, however it is driven or read."""
    trained = {one: each.sequence.label for each in training for one in _identities(each.sequence, each.confirm)}
    for sequence in held_out:
        for identity in _identities(sequence, ()):
            if identity in trained:
                what, seed = identity
                found = f"{what} is" if seed is None else f"{what} with seed {seed} is"
                told = f"{found} in training too ({trained[identity]}); judge on another world, seed or recording"
                raise BadExperiment(file, f"held-out ({sequence.label})", told)


def _identities(sequence: SequenceSpec, more: Sequence[int]) -> set[tuple[str, int | None]]:
    """What a sequence shows: its world with each seed, or its recording by name and by the file it reads."""
    seeded = registry.dataset(sequence.dataset).seeded
    if seeded:
        return {(sequence.dataset, seed) for seed in (*sequence.seeds, *more)}
    path = sequence.parameters.get("path")
    return {(str(Path(path).resolve()) if isinstance(path, str) and path else sequence.dataset, None)}


def _entrant(table: Mapping[str, Any], method: Method, file: str, place: str) -> Entrant:
    spec = registry.find_backend(method.backend)
    default = method.parameters
    parameters = () if method.missing else own(spec)
    search = table.get("search")
    if search is None or method.missing:
        factors, left = derived([p for p in parameters if p.name in default], default)
        return Entrant(method, Space(factors, default), left)
    if not isinstance(search, Mapping):
        raise BadExperiment(
            file, place, f"'search': found {brief(search)}, expected a table of parameters and their levels"
        )
    known = {parameter.name: parameter for parameter in parameters}
    chosen = tuple(_factor(name, told, known, default, file, place) for name, told in search.items())
    left = {name: "not named in 'search'" for name in known if name not in search}
    return Entrant(method, Space(chosen, default), left)


def _factor(
    name: str, table: object, known: Mapping[str, Parameter], default: Mapping[str, Value], file: str, place: str
) -> Factor:
    where = f"{place}: search.{name}"
    if name in SHARED:
        raise BadExperiment(file, where, "a setting of the front end, which belongs to all methods alike; set it "
                            "as a fixed value of the method if it must differ")  # fmt: skip
    if name not in known:
        raise BadExperiment(file, where, str(UnknownName("parameter", name, known)))
    levels = table.get("levels") if isinstance(table, Mapping) else table
    rest = {key: value for key, value in table.items() if key != "levels"} if isinstance(table, Mapping) else {}
    if isinstance(known[name].default, float) and isinstance(levels, list):
        levels = [float(value) if type(value) is int else value for value in levels]
    base = {f"{METHOD}{each}": value for each, value in default.items()}
    told = {"sets": f"{METHOD}{name}", "name": name, "unit": known[name].unit, "levels": levels, **rest}
    made = factor(told, file, where, base)
    for level in made.levels:
        for value in settings(level).values():
            _checked(known[name], value, file, where)
    return made


def _checked(parameter: Parameter, value: Value, file: str, where: str) -> None:
    try:
        parameter.check("levels", value)
    except BadParameter as error:
        raise BadExperiment(file, where, str(error)) from error


def _objective(table: object, file: str) -> Response:
    if not isinstance(table, Mapping):
        raise BadExperiment(
            file, "objective", f"found {brief(table)}, expected a table [objective] with metric and lost"
        )
    for key in table:
        if key not in ("metric", "lost"):
            raise BadExperiment(file, "objective", str(UnknownName("key", key, ("metric", "lost"))))
    taped = {metric.name for metric in spans.METRICS}  # their tapes end at walls, which no training run draws
    known = {m.name: m for m in all_metrics() if m.better == "lower" and m.group in ("drift", "relations")}
    known = {name: metric for name, metric in known.items() if name not in taped}
    name = table.get("metric", METRIC)
    if name not in known:
        told = UnknownName("error of a trajectory whose lower values are better", str(name), known)
        raise BadExperiment(file, "objective", str(told))
    return Response(known[name], "log", _number(table, "lost", LOST_M, file, least=1e-9, place="objective"))


def _number(
    table: Mapping[str, Any], key: str, default: float, file: str, whole: bool = False, least: float = 0.0,
    place: str = "",
) -> float:  # fmt: skip
    value = table.get(key, default)
    right = type(value) is int or (isinstance(value, float) and not whole)
    if not right or not least <= value < float("inf"):
        raise BadExperiment(
            file, place, f"'{key}': found {brief(value)}, expected a {'whole ' * whole}number from {least:g}"
        )
    return float(value)


def _tables(content: Mapping[str, Any], key: str, file: str) -> list[Mapping[str, Any]]:
    tables = content.get(key, [])
    if not isinstance(tables, list) or not all(isinstance(table, Mapping) for table in tables):
        raise BadExperiment(file, key, f"expected tables [[{key}]]")
    if not tables:
        raise BadExperiment(file, "", f"no [[{key}]]: a tuning needs at least one")
    return list(tables)
