"""The experiment that runs default and tuned rows on the held-out sequences, as a file like any other."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from evalkit.commands.study.experiment_lines import setting_lines
from evalkit.commands.tune.plan import TUNED, Tuning
from evalkit.commands.tune.search_loop import SearchResult
from evalkit.config.experiment import Experiment, Method, SequenceSpec, experiment_from_tables
from evalkit.io.toml import parse_toml
from evalkit.plugins.parameters import Value


def experiment_text(tuning: Tuning, found: Sequence[SearchResult]) -> str:
    """The TOML: every method with its defaults, and once more with what was found where that was better."""
    by_label = {one.tunable.label: one for one in found}
    methods: list[str] = []
    for tunable in tuning.methods:
        methods += _method(tunable.method, tunable.label, tunable.method.parameters)
        one = by_label.get(tunable.label)
        if one is not None and one.tuned:
            methods += _method(tunable.method, tunable.label + TUNED, one.chosen.candidate.values)
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
        *methods,
        *(line for sequence in tuning.held_out for line in _sequence(sequence)),
    ]
    return "\n".join(lines) + "\n"


def held_out_plan(text: str, file: str) -> Experiment:
    """The plan of that text, as ``evalkit compare FILE`` reads it."""
    return experiment_from_tables(parse_toml(text), file, "tuned", f"compare {file}")


def _method(method: Method, label: str, values: Mapping[str, Value]) -> list[str]:
    head = ["", "[[method]]", f"use = {_text(method.backend)}", f"label = {_text(label)}"]
    return [*head, *setting_lines(values)]


def _sequence(sequence: SequenceSpec) -> list[str]:
    seeds = [seed for seed in sequence.seeds if seed is not None]
    head = ["", "[[sequence]]", f"use = {_text(sequence.dataset)}", f"label = {_text(sequence.label)}"]
    return [*head, *([f"seeds = {seeds}"] if seeds else []), *setting_lines(sequence.parameters)]


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)
