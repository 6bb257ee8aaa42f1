"""Read a study file: every name, level, metric and key is checked before the first run."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

from evalkit.commands.study.plan import Design, DesignKind, EnvelopeChoice, Point, Study
from evalkit.commands.study.sampling import sample
from evalkit.config.experiment_file import experiment_from_tables
from evalkit.config.forms import RESPONSE, STUDY
from evalkit.config.toml_tables import TomlTable, all_mistakes, flatten
from evalkit.core.errors import BadExperiment, EvalkitError, UnknownName, brief
from evalkit.design.factors import Factor, FactorLevel, FactorSettings, Scale, read_factor
from evalkit.design.responses import Response
from evalkit.io.toml import load_toml
from evalkit.metrics import all_metrics
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value, resolve_parameters

REQUIRED = {"optimal": "points", "sobol": "points", "latin": "points", "fractional": "resolution"}
"""The key that a kind of design requires."""


def load_study(path: Path, command: str) -> Study:
    """The study of a file (TOML). Raises BadExperiment with the file, the key and what was found."""
    content = load_toml(path, "a study (*.toml)")
    with all_mistakes(content, "study"):
        return study_from_tables(content, str(path), command)


def study_from_tables(content: Mapping[str, Any], file: str, command: str) -> Study:
    """The study of a file's tables; ``file`` is named in errors, ``command`` runs the study."""
    table = TomlTable(content, file, form=STUDY)
    table.check_keys()
    base = _BaseSettings(table)
    factors = [_read_factor(each, base) for each in table.tables("factor", "a study")]
    responses = [_read_response(each) for each in table.tables("response", "a study")]
    designs = [_read_design(each, factors, base) for each in table.tables("design", "a study")]
    for kind, names in (("factor", [f.name for f in factors]), ("design", [d.name for d in designs])):
        if doubled := [name for name in names if names.count(name) > 1]:
            raise table.error(f"two {kind}s are named '{doubled[0]}'; give one another name")
    return Study(
        table.text("title", Path(file).stem),
        table.text("description"),
        command,
        base.method.backend,
        base.sequence.dataset,
        base.mapper.name,
        base.mapper.scans,
        base.method.missing or base.sequence.missing,
        tuple(responses),
        tuple(factors),
        tuple(designs),
        tuple(_read_envelope(each, designs, responses) for each in table.tables("envelope")),
        base.limit_s,
    )


class _BaseSettings:
    """The study's own settings; every point changes a few of them."""

    def __init__(self, table: TomlTable) -> None:
        groups: dict[str, dict[str, Any]] = {}
        for group in ("method", "sequence"):
            if not isinstance(table.content.get(group), Mapping):
                raise table.error(f"no table [{group}]: a study needs one, with use = NAME")
            groups[group] = dict(table.content[group])
        if "seeds" in table.content:
            groups["sequence"]["seeds"] = table.content["seeds"]
        limits = table.table("limits", "")
        limits.check_keys()
        content = {
            "method": [groups["method"]], "sequence": [groups["sequence"]], "mapper": table.content.get("mapper", {}),
            "limits": limits.content,
        }  # fmt: skip
        try:
            plan = experiment_from_tables(content, table.file, "study", "study")
        except BadExperiment as error:  # a study has one [method] and one [sequence]
            where, *texts = error.args
            place, what = (re.sub(r"^(method|sequence) 1\b", r"\1", text) for text in texts)
            raise BadExperiment(where, place, what) from error
        self.table, self.method, self.sequence, self.mapper = table, plan.methods[0], plan.sequences[0], plan.mapper
        self.limit_s = plan.limits.run_s
        self._spec = registry.find_backend(self.method.backend)
        self._checked_sequences: set[str] = set()
        self.settings: FactorSettings = {
            **{f"method.{name}": value for name, value in self.method.parameters.items()},
            **{f"sequence.{name}": value for name, value in self.sequence.parameters.items()},
            **{f"mapper.{name}": value for name, value in self.mapper.parameters.items()},
        }

    def point(self, levels: Mapping[str, FactorLevel], fixed: FactorSettings, table: TomlTable) -> Point:
        """The point with these levels and the settings that a design fixes.

        Raises BadExperiment for ``table`` if a setting is unknown or has a value that it cannot take.
        """
        settings = dict(self.settings) | dict(fixed)
        for level in levels.values():
            settings |= level.sets
        groups: dict[str, dict[str, Value]] = {"method": {}, "sequence": {}, "mapper": {}}
        for name, value in settings.items():
            group, _, parameter = name.partition(".")
            if group not in groups:
                raise table.error(str(UnknownName("setting", name, settings)))
            groups[group][parameter] = value
        with table.errors():
            return Point(
                levels,
                frontend.complete_parameters("method", self._spec, groups["method"]),
                self._sequence_parameters(groups["sequence"]),
                resolve_parameters("mapper", registry.mapper(self.mapper.name).parameters, groups["mapper"]),
            )

    def _sequence_parameters(self, given: Mapping[str, Value]) -> dict[str, Value]:
        """All parameters but the seed; a simulated sequence is created once to check its parameters."""
        spec = registry.dataset(self.sequence.dataset)
        complete = resolve_parameters("sequence", spec.parameters, given)
        if not spec.seeded:
            return complete
        complete.pop("seed")
        identity = json.dumps(complete, sort_keys=True)
        if not self.sequence.missing and identity not in self._checked_sequences:
            try:
                spec.make(**complete)
            except (ValueError, EvalkitError) as error:
                what = f"{self.sequence.dataset} cannot be made with {identity}: {error}"
                raise BadExperiment(self.table.file, "sequence", what) from error
            self._checked_sequences.add(identity)
        return complete

    def seeds(self, table: TomlTable) -> tuple[int | None, ...]:
        """The seeds of a design's table, or the study's."""
        if "seeds" not in table.content:
            return self.sequence.seeds
        if self.sequence.seeds == (None,):
            raise table.error(f"'seeds': {self.sequence.dataset} is a recording and has none; remove the key")
        return table.whole_numbers("seeds")


def _read_factor(table: TomlTable, base: _BaseSettings) -> Factor:
    """A factor whose levels can all be set."""
    factor = read_factor(_label_table(table), base.settings)
    for level in factor.levels:
        base.point({factor.name: level}, {}, replace(table, place=f"factor '{factor.name}'"))
    return factor


def _read_response(table: TomlTable) -> Response:
    table.check_keys()
    metric = table.choice("metric", "metric", {metric.name: metric for metric in all_metrics()})
    scale: Any = table.content.get("scale", RESPONSE.default("scale"))
    if scale not in get_args(Scale):
        raise table.bad_value("scale", "linear or log")
    lost = table.content.get("lost")
    number = isinstance(lost, (int, float)) and not isinstance(lost, bool)
    if lost is not None and (not number or (scale == "log" and lost <= 0)):
        raise table.bad_value("lost", "a number (positive on a log scale)")
    return Response(metric, scale, lost)


def _read_design(table: TomlTable, factors: list[Factor], base: _BaseSettings) -> Design:
    table = _label_table(table)
    table.check_keys()
    kinds: dict[str, DesignKind] = {kind: kind for kind in get_args(DesignKind)}
    kind = table.choice("kind", "kind of design", kinds)
    numbers = {key: _read_number(table, key, kind) for key in ("points", "resolution")}
    chosen = _read_chosen_factors(table, factors)
    if not isinstance(table.content.get("with", {}), Mapping):
        raise table.bad_value("with", "a table of settings")
    with table.errors():
        positions, levels = sample(kind, chosen, **numbers, seed=table.whole_number("seed"))
    fixed = flatten(table.content.get("with", {}))
    points = tuple(base.point(row, fixed, table) for row in levels)
    dealt = table.flag("deal")
    name = table.text("name", kind)
    return Design(name, kind, chosen, positions, points, base.seeds(table), numbers["resolution"], dealt)


def _read_number(table: TomlTable, key: str, kind: DesignKind) -> int:
    """The value of a key that this kind of design requires, 0 if the kind has no such key."""
    if REQUIRED.get(kind) == key:
        return table.whole_number(key)
    if key in table.content:
        found = brief(table.content[key])
        raise table.error(f"'{key}': found {found}; a design '{kind}' has none, remove the key")
    return 0


def _read_chosen_factors(table: TomlTable, factors: list[Factor]) -> tuple[Factor, ...]:
    """The factors that a design names; no two of them set the same parameter."""
    by_name = {factor.name: factor for factor in factors}
    names = table.content.get("factors")
    if not isinstance(names, list) or not names:
        raise table.bad_value("factors", "a list of factors' names")
    owners: dict[str, str] = {}
    for name in names:
        if not isinstance(name, str) or name not in by_name:
            raise table.error(str(UnknownName("factor", str(name), by_name)))
        for sets in {setting for level in by_name[name].levels for setting in level.sets}:
            if sets in owners:
                raise table.error(f"'factors': '{owners[sets]}' and '{name}' both set {sets}; keep one")
            owners[sets] = name
    return tuple(by_name[name] for name in names)


def _read_envelope(table: TomlTable, designs: list[Design], responses: list[Response]) -> EnvelopeChoice:
    table.check_keys()
    grids = {design.name: design for design in designs if design.kind == "grid"}
    grid = table.choice("design", "grid design", grids)
    ordered = {factor.name: factor.name for factor in grid.factors if factor.numbers is not None}
    x, y = (table.choice(key, "factor with numbers", ordered, where=f"'{key}'") for key in ("x", "y"))
    if x == y:
        raise table.bad_value("y", "another factor than 'x'")
    response = table.choice("metric", "response", {response.name: response for response in responses})
    return EnvelopeChoice(grid.name, x, y, response, table.number("limit"))


def _label_table(table: TomlTable) -> TomlTable:
    """The table with its name, or what it sets, in its place."""
    return table.with_label(str(table.content.get("name", table.content.get("sets", ""))))
