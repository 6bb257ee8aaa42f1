"""Chapters on the study that the paper announces: ICP parameters and driving, and the settings of the map."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, cast

import numpy as np

from evalkit.commands.study.config import load_study
from evalkit.commands.study.envelope import compute_panels, describe_panels
from evalkit.commands.study.formatting import describe_interactions, describe_limit, describe_main_effects
from evalkit.commands.study.page import build_sections, sum_cpu_minutes
from evalkit.commands.study.plan import Study
from evalkit.commands.study.result import StudyResult
from evalkit.core import se2
from evalkit.core.se2 import Floats
from evalkit.design.run_points import RunScores
from evalkit.execution.task import AnyTask, make_task
from evalkit.odometry import frontend
from evalkit.odometry.run_odometry import estimate_poses
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.specs import FIRST_STAGE
from evalkit.report.html.blocks import Section, Text
from evalkit_paper import verdicts
from evalkit_paper.chapter import Chapter, Finding, Results, Settings

REFERENCE = "paper"
"""NumPy reference of the compiled core."""

STUDY, MAPS = "study", "maps"
OPEN_CHOICES = ("bounds", "once per scan", "traversal")
"""Factors of the map's study that the text leaves open."""

PARAMETERS = (
    Parameter("file", "reports/study.toml", "", "the study: factors, designs, responses"),
    Parameter("comparisons", 6, "", "points at which the core is compared with the NumPy reference", low=1),
    Parameter("comparison_scans", 60, "scans", "scans compared at each of these points", low=2),
)
MAP_PARAMETERS = (Parameter("file", "reports/study-maps.toml", "", "the study of the map's settings"),)


def tasks(settings: Settings) -> tuple[AnyTask, ...]:
    """Runs of the study and, of ICP parameters, the points at which core and reference are compared."""
    study = read_study(settings)
    if study.missing:
        return ()
    return (*study.tasks(), *(_comparison_tasks(study, settings) if "comparisons" in settings else ()))


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """Sections: description and cost, then those of ``evalkit study``."""
    study, (name, heading) = read_study(settings), _place(settings)
    if study.missing:
        return (Section(heading, (Text(f"Not computed here: {study.missing}", "warn"),), name),)
    outcome = _study_result(study, results)
    text = describe_cost(outcome)
    if "comparisons" in settings:
        text += f" {describe_agreement(settings, results)}"
    first = Section(heading, (Text(study.description), Text(text)), name)
    return (first, *build_sections(outcome, f"{heading}: ", f"{name}-"))


def study_findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """Findings of the study on the paper's claims."""
    study = read_study(settings)
    if study.missing:
        return ()
    outcome = _study_result(study, results)
    response = study.responses[0]
    fits = outcome.fits(response)
    texts = [f"{design.name}: {describe_main_effects(response, design, fit)} {describe_interactions(response, fit, 2)}"
            for design, fit in fits]  # fmt: skip
    matter = [
        fit.factor(number).largest.value.excludes(0.0) for design, fit in fits for number in range(len(design.factors))
    ]
    found = [Finding(
        "Contribution 3: study of grid resolution, ICP parameters and vehicle speed",
        "announced; no table or figure of it is printed", " ".join(texts),
        verdicts.judge_study(sum(matter), len(matter)), f"{STUDY}-effects",
    )]  # fmt: skip
    for choice in study.envelopes:
        design, panels = study.design(choice.design), compute_panels(outcome, choice)
        limit = f"{describe_limit(choice)}, {' '.join(describe_panels(choice, design, panels))}"
        slow = verdicts.judge_slow([bool(panel.inside.flat[0]) for panel in panels])
        fast = verdicts.judge_fast([not panel.inside.all() for panel in panels])
        found += [
            Finding("Consistent maps at low to medium speed", "no figure is given", limit, slow, f"{STUDY}-envelope"),
            Finding("Fast motion is a limit", "no figure is given", limit, fast, f"{STUDY}-envelope"),
        ]
    return tuple(found)


def map_findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """Findings on the settings of the map that the paper studies or leaves open."""
    study = read_study(settings)
    if study.missing:
        return ()
    levels = _levels(_study_result(study, results))
    found = []
    if cells := levels.get("cell"):
        text = ", ".join(f"{name} m {value:.3f}" for name, value in cells.items())
        found.append(Finding(
            "Study of the grid's resolution", "announced, no table printed", f"F1 at 10 cm by cell size: {text}",
            verdicts.judge_cells(cells), f"{MAPS}-curves",
        ))  # fmt: skip
    spans = {name: (min(levels[name].values()), max(levels[name].values())) for name in OPEN_CHOICES if name in levels}
    if spans:
        text = "; ".join(f"{name}: F1 {low:.3f} to {high:.3f}" for name, (low, high) in spans.items())
        found.append(Finding(
            "Bounds of the log-odds, several beams in one cell, cells that a beam crosses",
            "l_min and l_max without values; nothing on the other two", text, verdicts.judge_open_choices(spans),
            f"{MAPS}-curves",
        ))  # fmt: skip
    return tuple(found)


def read_study(settings: Settings) -> Study:
    """Read the study of the chapter's file."""
    file = Path(str(settings["file"]))
    changed_ns = file.stat().st_mtime_ns if file.exists() else 0
    return _read_cached(file, changed_ns)


def describe_cost(outcome: StudyResult) -> str:
    """Describe the amount of computation."""
    study = outcome.study
    lost = sum(bool(outcome.lost(key, seed)) for key in study.points for seed in study.seeds(key))
    return (
        f"{len(study.points):,} points in {len(study.designs)} designs, {len(outcome.results):,} runs in "
        f"{sum_cpu_minutes(outcome):.1f} minutes of CPU; {lost:,} runs failed and count as failed in every number."
    )


def describe_agreement(settings: Settings, results: Results) -> str:
    """Describe the difference between core and reference."""
    study = read_study(settings)
    names = [task.name for task in _comparison_tasks(study, settings)]
    metres = max(float(results[name]["apart_m"]) for name in names)
    scans = sum(int(results[name]["scans"]) for name in names)
    return (
        f"All runs use '{study.backend}'. At {len(names)} points of the designs, over {scans:,} scans, its "
        f"poses and those of '{REFERENCE}' with the same parameters are at most {metres:.1e} m apart."
    )


def compare_poses(
    backends: tuple[str, str], parameters: Mapping[str, Value], dataset: str, sequence: Mapping[str, Value], scans: int
) -> dict[str, Any]:
    """Largest distance (m) and angle (rad) between the poses of two back ends over the first scans, and their number.

    Both get the same parameters; a parameter that only one of them has keeps its default.
    """
    one, other = (_poses(name, parameters, dataset, sequence, scans) for name in backends)
    difference = se2.between(one, other)
    return {
        "apart_m": float(np.linalg.norm(difference[:, :2], axis=1).max()),
        "apart_rad": float(np.abs(difference[:, 2]).max()),
        "scans": len(one),
    }


def _poses(
    name: str, parameters: Mapping[str, Value], dataset: str, sequence: Mapping[str, Value], scans: int
) -> Floats:
    spec = registry.backend(name)
    known = {parameter.name for parameter in frontend.settable_parameters(spec)}
    own = {key: value for key, value in parameters.items() if key in known or key.startswith(FIRST_STAGE)}
    odometry = frontend.make_odometry(spec, frontend.complete_parameters(name, spec, own))
    return estimate_poses(odometry, islice(registry.dataset(dataset).make(**sequence).frames(), scans))


def _comparison_tasks(study: Study, settings: Settings) -> tuple[AnyTask, ...]:
    """Comparisons of core and reference at points evenly spread over the designs."""
    points = list(study.points.values())
    count = min(int(settings["comparisons"]), len(points))
    chosen = [points[number * len(points) // count] for number in range(count)]
    first = study.seeds(chosen[0].key)[0]
    seed: dict[str, Value] = {} if first is None else {"seed": first}
    return tuple(
        make_task(
            f"comparison {point.key}", compare_poses, backends=(REFERENCE, study.backend),
            parameters=dict(point.method), dataset=study.dataset, sequence={**point.sequence, **seed},
            scans=int(settings["comparison_scans"]),
        ).depending_on("evalkit_baselines.paper", "evalkit_baselines.embedded")
        for point in chosen
    )  # fmt: skip


def _levels(outcome: StudyResult) -> dict[str, dict[str, float]]:
    """Mean of the first response by factor and level, over the designs that vary one factor at a time."""
    found: dict[str, dict[str, float]] = {}
    for design in (design for design in outcome.study.designs if design.kind == "curves"):
        for point in design.points:
            value = float(np.nanmean(outcome.row(design, outcome.study.responses[0], point)))
            for factor, level in point.levels.items():
                found.setdefault(factor, {})[level.label] = value
    return found


def _place(settings: Settings) -> tuple[str, str]:
    """Anchor and heading of the chapter with these settings."""
    return (STUDY, "The study") if "comparisons" in settings else (MAPS, "The map's settings")


def _study_result(study: Study, results: Results) -> StudyResult:
    return StudyResult(study, {task.name: cast(RunScores, results[task.name]) for task in study.tasks()})


@lru_cache(maxsize=4)
def _read_cached(file: Path, _changed_ns: int) -> Study:
    return load_study(file, f"evalkit study {file}")


CHAPTER = Chapter(STUDY, PARAMETERS, tasks, sections, study_findings)
MAP_CHAPTER = Chapter(MAPS, MAP_PARAMETERS, tasks, sections, map_findings)
