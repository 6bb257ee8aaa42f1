"""A study file made a plan: every name, level, metric and key is checked before the first run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

from evalkit.commands.study.factors import Factor, Level, Scale, Settings, factor
from evalkit.commands.study.plan import Design, EnvelopeChoice, Kind, Point, Response, Study
from evalkit.commands.study.sampling import placed
from evalkit.config import experiment
from evalkit.core.errors import BadExperiment, BadParameter, EvalkitError, UnknownName, brief
from evalkit.io.toml import load_toml
from evalkit.metrics import all_metrics
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value, resolve_parameters

ROOMS = ("method", "sequence", "mapper", "limits")
TOP = ("title", "description", "seeds", *ROOMS, "response", "factor", "design", "envelope")
DESIGN = ("name", "kind", "factors", "points", "resolution", "seed", "seeds", "deal", "with")
NEEDS = {"optimal": "points", "sobol": "points", "latin": "points", "fractional": "resolution"}
"""The key that a kind of design cannot do without."""


def read(path: Path, command: str) -> Study:
    """The study of a file (TOML); BadExperiment names the file, the key and what was found."""
    content = load_toml(path, "a study (*.toml)")
    return study(content, str(path), command)


def study(content: Mapping[str, Any], file: str, command: str) -> Study:
    """The study of a file's tables; ``file`` is named in errors, ``command`` runs it."""
    _known(content, TOP, file, "")
    base = _Base(content, file)
    known = [factor(t, file, _place("factor", i, t), base.settings) for i, t in _tables(content, "factor", file)]
    for found in known:
        base.check(found)
    responses = [_response(t, file, f"response {i + 1}") for i, t in _tables(content, "response", file)]
    designs = [_design(t, file, _place("design", i, t), known, base) for i, t in _tables(content, "design", file)]
    for kind, names in (("factor", [f.name for f in known]), ("design", [d.name for d in designs])):
        if doubled := [name for name in names if names.count(name) > 1]:
            raise BadExperiment(file, "", f"two {kind}s are named '{doubled[0]}'; give one another name")
    envelopes = _tables(content, "envelope", file, needed=False)
    return Study(
        str(content.get("title", Path(file).stem)),
        str(content.get("description", "")),
        command,
        base.method.backend,
        base.sequence.dataset,
        base.mapper.name,
        base.mapper.scans,
        base.method.missing or base.sequence.missing,
        tuple(responses),
        tuple(known),
        tuple(designs),
        tuple(_envelope(t, file, f"envelope {i + 1}", designs, responses) for i, t in envelopes),
        base.limit_s,
    )


class _Base:
    """The study's own settings, which every point changes in a few."""

    def __init__(self, content: Mapping[str, Any], file: str) -> None:
        rooms = {room: content.get(room) for room in ("method", "sequence")}
        for room, table in rooms.items():
            if not isinstance(table, Mapping):
                raise BadExperiment(file, "", f"no table [{room}]: a study needs one, with use = NAME")
        sequence = dict(rooms["sequence"] or {}) | ({"seeds": content["seeds"]} if "seeds" in content else {})
        tables = {"method": [rooms["method"]], "sequence": [sequence], "mapper": content.get("mapper", {})}
        if isinstance(limits := content.get("limits", {}), Mapping):
            _known(limits, ("run_s",), file, "limits")
        tables |= {"limits": limits}
        plan = experiment.plan(tables, file, "study", "study")
        self.file, self.method, self.sequence, self.mapper = file, plan.methods[0], plan.sequences[0], plan.mapper
        self.limit_s = plan.limits.run_s
        self._spec = registry.find_backend(self.method.backend)
        self._made: set[str] = set()
        self.settings: Settings = {
            **{f"method.{name}": value for name, value in self.method.parameters.items()},
            **{f"sequence.{name}": value for name, value in self.sequence.parameters.items()},
            **{f"mapper.{name}": value for name, value in self.mapper.parameters.items()},
        }

    def check(self, found: Factor) -> None:
        """Refuses a factor one of whose levels cannot be set."""
        for level in found.levels:
            self.point({found.name: level}, {}, f"factor '{found.name}'")

    def point(self, levels: Mapping[str, Level], fixed: Settings, place: str) -> Point:
        """The point of levels, and of settings that a design fixes; BadExperiment where one cannot be set."""
        settings = dict(self.settings) | dict(fixed)
        for level in levels.values():
            settings |= level.sets
        rooms: dict[str, dict[str, Value]] = {"method": {}, "sequence": {}, "mapper": {}}
        for name, value in settings.items():
            room, _, parameter = name.partition(".")
            if room not in rooms:
                raise BadExperiment(self.file, place, str(UnknownName("setting", name, settings)))
            rooms[room][parameter] = value
        try:
            return Point(
                levels,
                frontend.complete_parameters("method", self._spec, rooms["method"]),
                self._sequence(rooms["sequence"]),
                resolve_parameters("mapper", registry.mapper(self.mapper.name).parameters, rooms["mapper"]),
            )
        except (UnknownName, BadParameter) as error:
            raise BadExperiment(self.file, place, str(error)) from error

    def _sequence(self, given: Mapping[str, Value]) -> dict[str, Value]:
        """All parameters but the seed; a simulated sequence is made once, to see that it can be."""
        spec = registry.dataset(self.sequence.dataset)
        complete = resolve_parameters("sequence", spec.parameters, given)
        if not spec.seeded:
            return complete
        complete.pop("seed")
        identity = json.dumps(complete, sort_keys=True)
        if not self.sequence.missing and identity not in self._made:
            try:
                spec.make(**complete)
            except (ValueError, EvalkitError) as error:
                told = f"{self.sequence.dataset} cannot be made with {identity}: {error}"
                raise BadExperiment(self.file, "sequence", told) from error
            self._made.add(identity)
        return complete

    def seeds(self, table: Mapping[str, Any], place: str) -> tuple[int | None, ...]:
        """The seeds of a design's table, or the study's."""
        if "seeds" not in table:
            return self.sequence.seeds
        sequence = {"use": self.sequence.dataset, "seeds": table["seeds"]}
        try:
            plan = experiment.plan({"method": [{"use": self.method.backend}], "sequence": [sequence]}, "", "", "")
        except BadExperiment as error:
            raise BadExperiment(self.file, place, error.args[2]) from error
        return plan.sequences[0].seeds


def _response(table: Mapping[str, Any], file: str, place: str) -> Response:
    _known(table, ("metric", "scale", "lost"), file, place)
    metrics = {metric.name: metric for metric in all_metrics()}
    name, scale, lost = table.get("metric"), table.get("scale", "linear"), table.get("lost")
    if name not in metrics:
        raise BadExperiment(file, place, str(UnknownName("metric", str(name), metrics)))
    if scale not in get_args(Scale):
        raise BadExperiment(file, place, f"'scale': found {brief(scale)}, expected linear or log")
    number = isinstance(lost, (int, float)) and not isinstance(lost, bool)
    if lost is not None and (not number or (scale == "log" and lost <= 0)):
        raise BadExperiment(file, place, f"'lost': found {brief(lost)}, expected a number (positive on a log scale)")
    return Response(metrics[name], scale, lost)


def _design(table: Mapping[str, Any], file: str, place: str, known: list[Factor], base: _Base) -> Design:
    _known(table, DESIGN, file, place)
    kind: Any = table.get("kind")
    if kind not in get_args(Kind):
        raise BadExperiment(file, place, str(UnknownName("kind of design", str(kind), get_args(Kind))))
    numbers = {key: _whole(table, key, kind, file, place) for key in ("points", "resolution")}
    chosen = _chosen(table.get("factors"), known, file, place)
    fixed = table.get("with", {})
    if not isinstance(fixed, Mapping):
        raise BadExperiment(file, place, f"'with': found {brief(fixed)}, expected a table of settings")
    try:
        positions, levels = placed(kind, chosen, **numbers, seed=int(table.get("seed", 0)))
    except BadParameter as error:
        raise BadExperiment(file, place, str(error)) from error
    fixed = dict(_flat(fixed))
    points = tuple(base.point(row, fixed, place) for row in levels)
    deal = table.get("deal", False)
    if not isinstance(deal, bool):
        raise BadExperiment(
            file, place, f"'deal': found {brief(deal)}, expected true or false (one seed a point, in turn)"
        )
    seeds, name = base.seeds(table, place), str(table.get("name", kind))
    return Design(name, kind, chosen, positions, points, seeds, numbers["resolution"], deal)


def _whole(table: Mapping[str, Any], key: str, kind: str, file: str, place: str) -> int:
    """The number of a key that this kind of design needs, 0 where it has none."""
    found = table.get(key)
    if NEEDS.get(kind) == key and (type(found) is not int or found < 1):
        raise BadExperiment(file, place, f"'{key}': found {brief(found)}, expected a whole number from 1")
    if NEEDS.get(kind) != key and key in table:
        raise BadExperiment(file, place, f"'{key}': found {brief(found)}; a design '{kind}' has none, remove the key")
    return int(found or 0)


def _chosen(names: object, known: list[Factor], file: str, place: str) -> tuple[Factor, ...]:
    """The factors of these names, no two of which set the same."""
    by_name = {found.name: found for found in known}
    if not isinstance(names, list) or not names:
        raise BadExperiment(file, place, f"'factors': found {brief(names)}, expected a list of factors' names")
    owners: dict[str, str] = {}
    for name in names:
        if name not in by_name:
            raise BadExperiment(file, place, str(UnknownName("factor", str(name), by_name)))
        for sets in {setting for level in by_name[name].levels for setting in level.sets}:
            if sets in owners:
                raise BadExperiment(file, place, f"'factors': '{owners[sets]}' and '{name}' both set {sets}; keep one")
            owners[sets] = name
    return tuple(by_name[name] for name in names)


def _envelope(
    table: Mapping[str, Any], file: str, place: str, designs: list[Design], responses: list[Response]
) -> EnvelopeChoice:
    _known(table, ("design", "x", "y", "metric", "limit"), file, place)
    grids = {design.name: design for design in designs if design.kind == "grid"}
    if table.get("design") not in grids:
        raise BadExperiment(file, place, str(UnknownName("grid design", str(table.get("design")), grids)))
    ordered = {f.name: f for f in grids[table["design"]].factors if f.numbers is not None}
    for key in ("x", "y"):
        if table.get(key) not in ordered:
            told = UnknownName("factor with numbers", str(table.get(key)), ordered, f"'{key}'")
            raise BadExperiment(file, place, str(told))
    if table["x"] == table["y"]:
        raise BadExperiment(file, place, f"'y': found {brief(table['y'])}, expected another factor than 'x'")
    known = {response.name: response for response in responses}
    if table.get("metric") not in known:
        raise BadExperiment(file, place, str(UnknownName("response", str(table.get("metric")), known)))
    limit = table.get("limit")
    if isinstance(limit, bool) or not isinstance(limit, (int, float)):
        raise BadExperiment(file, place, f"'limit': found {brief(limit)}, expected a number")
    return EnvelopeChoice(table["design"], table["x"], table["y"], known[table["metric"]], float(limit))


def _tables(
    content: Mapping[str, Any], key: str, file: str, needed: bool = True
) -> list[tuple[int, Mapping[str, Any]]]:
    tables = content.get(key, [])
    if not isinstance(tables, list) or not all(isinstance(table, Mapping) for table in tables):
        raise BadExperiment(file, key, f"expected tables [[{key}]]")
    if needed and not tables:
        raise BadExperiment(file, "", f"no [[{key}]]: a study needs at least one")
    return list(enumerate(tables))


def _place(kind: str, number: int, table: Mapping[str, Any]) -> str:
    name = table.get("name", table.get("sets", ""))
    return f"{kind} {number + 1} ({name})" if name else f"{kind} {number + 1}"


def _known(table: Mapping[str, Any], keys: tuple[str, ...], file: str, place: str) -> None:
    for key in table:
        if key not in keys:
            raise BadExperiment(file, place, str(UnknownName("key", key, keys)))


def _flat(table: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Nested tables with dotted names."""
    found: list[tuple[str, Any]] = []
    for key, value in table.items():
        found += _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else [(prefix + key, value)]
    return found
