"""A point of a study written as an experiment file, to be run and reported like any other."""

from __future__ import annotations

import json
from collections.abc import Mapping

from evalkit.commands.study.plan import Study
from evalkit.plugins.parameters import Value


def experiment_lines(study: Study, key: str) -> str:
    """The TOML of the experiment that runs one point with all its seeds, every setting in full."""
    point = study.points[key]
    seeds = [seed for seed in study.seeds(key) if seed is not None]
    return "\n".join(
        [
            f"title = {json.dumps(f'{study.title}: {key}')}",
            "",
            "[mapper]",
            f"use = {json.dumps(study.mapper)}",
            f"scans = {study.scans}",
            *setting_lines(point.mapper),
            "",
            "[[method]]",
            f"use = {json.dumps(study.backend)}",
            *setting_lines(point.method),
            "",
            "[[sequence]]",
            f"use = {json.dumps(study.dataset)}",
            *([f"seeds = {seeds}"] if seeds else []),
            *setting_lines(point.sequence),
        ]
    )


def setting_lines(settings: Mapping[str, Value]) -> list[str]:
    """A line of TOML for every setting."""
    return [f"{name} = {json.dumps(value)}" for name, value in settings.items()]
