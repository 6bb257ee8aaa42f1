"""Write an experiment as the TOML file that describes it, with every setting."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict

from evalkit.config.experiment import Experiment
from evalkit.plugins.parameters import Value


def format_experiment(experiment: Experiment) -> str:
    """The text of the file."""
    lines = [
        f"title = {_format_text(experiment.title)}",
        f"description = {_format_text(experiment.description)}",
        "",
        "[mapper]",
        f"use = {_format_text(experiment.mapper.name)}",
        f"scans = {experiment.mapper.scans}",
        *_format_settings(experiment.mapper.parameters),
        "",
        "[limits]",
        *_format_settings(asdict(experiment.limits)),
    ]
    for method in experiment.methods:
        lines += ["", "[[method]]", f"use = {_format_text(method.backend)}", f"label = {_format_text(method.label)}"]
        lines += [f"tuned_on = {json.dumps(list(method.tuned_on))}"] if method.tuned_on else []
        lines += _format_settings(method.parameters)
    for sequence in experiment.sequences:
        seeds = [seed for seed in sequence.seeds if seed is not None]
        repeats = [f"nuisance = {len(seeds)}", f"nuisance_scans = {sequence.excerpt_scans}"]
        lines += ["", "[[sequence]]", f"use = {_format_text(sequence.dataset)}"]
        lines += [
            f"label = {_format_text(sequence.label)}",
            *(repeats if sequence.perturbed else [f"seeds = {seeds}"] if seeds else []),
        ]
        lines += _format_settings(sequence.parameters)
    return "\n".join(lines) + "\n"


def _format_settings(settings: Mapping[str, Value]) -> list[str]:
    return [f"{name} = {json.dumps(value, ensure_ascii=False)}" for name, value in settings.items()]


def _format_text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)
