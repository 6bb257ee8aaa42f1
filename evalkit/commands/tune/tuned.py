"""The experiment that runs default and tuned rows on the held-out sequences, as a file like any other."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from evalkit.commands.study.experiment_lines import setting_lines
from evalkit.commands.tune.plan import TUNED, Tuning
from evalkit.commands.tune.search_loop import Searched
from evalkit.config import experiment
from evalkit.config.experiment import Contestant, Course, Plan
from evalkit.plugins.protocols import Value


def experiment_text(tuning: Tuning, found: Sequence[Searched]) -> str:
    """The TOML: every contestant with its defaults, and once more with what was found where that was better."""
    by_label = {one.entrant.label: one for one in found}
    contestants: list[str] = []
    for entrant in tuning.entrants:
        contestants += _contestant(entrant.contestant, entrant.label, entrant.contestant.parameters)
        one = by_label.get(entrant.label)
        if one is not None and one.tuned:
            contestants += _contestant(entrant.contestant, entrant.label + TUNED, one.chosen.candidate.values)
    lines = [
        f"# Written by: {tuning.command}",
        f"title = {_text(f'{tuning.title} (default and tuned rows)')}",
        f"description = {_text(tuning.description)}",
        "",
        "[mapper]",
        f"use = {_text(tuning.mapper.name)}",
        f"scans = {tuning.mapper.scans}",
        *setting_lines(tuning.mapper.parameters),
        "",
        "[limits]",
        *setting_lines(asdict(tuning.limits)),
        *contestants,
        *(line for course in tuning.held_out for line in _sequence(course)),
    ]
    return "\n".join(lines) + "\n"


def held_out_plan(text: str, file: str) -> Plan:
    """The plan of that text, as ``evalkit report FILE`` reads it."""
    return experiment.plan(tomllib.loads(text), file, "tuned", f"report {file}")


def _contestant(contestant: Contestant, label: str, values: Mapping[str, Value]) -> list[str]:
    head = ["", "[[contestant]]", f"use = {_text(contestant.backend)}", f"label = {_text(label)}"]
    return [*head, *setting_lines(values)]


def _sequence(course: Course) -> list[str]:
    seeds = [seed for seed in course.seeds if seed is not None]
    head = ["", "[[sequence]]", f"use = {_text(course.dataset)}", f"label = {_text(course.label)}"]
    return [*head, *([f"seeds = {seeds}"] if seeds else []), *setting_lines(course.parameters)]


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)
