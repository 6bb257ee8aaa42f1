"""Chapter on the study that the paper announces: grid resolution, ICP parameters and driving."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import cast

from evalkit.commands.study.config import load_study
from evalkit.commands.study.curves import build_curve_blocks, build_envelope_blocks
from evalkit.commands.study.effect_tables import build_effect_blocks
from evalkit.commands.study.envelope import compute_panels, describe_panels
from evalkit.commands.study.evaluate import RunScores
from evalkit.commands.study.formatting import (
    describe_interactions,
    describe_limit,
    describe_main_effects,
)
from evalkit.commands.study.page import build_design_blocks, build_point_blocks, build_summary, sum_cpu_minutes
from evalkit.commands.study.plan import Study
from evalkit.commands.study.result import StudyResult
from evalkit.execution.task import AnyTask, make_task
from evalkit.plugins.parameters import Parameter, Value
from evalkit.report.html.blocks import Block, Fold, Section, Text
from evalkit_paper import core_agreement
from evalkit_paper.chapter import Chapter, Finding, Results, Settings

REFERENCE = "paper"
"""NumPy reference of the compiled core."""

PARAMETERS = (
    Parameter("file", "reports/study.toml", "", "the study: factors, designs, responses"),
    Parameter("comparisons", 6, "", "points at which the core is compared with the NumPy reference", low=1),
    Parameter("comparison_scans", 60, "scans", "scans compared at each of these points", low=2),
)
STUDY = "study"
ENVELOPE = "study-envelope"


def tasks(settings: Settings) -> tuple[AnyTask, ...]:
    """Runs of the study, and the points at which core and reference are compared."""
    study = read_study(settings)
    return () if study.missing else (*study.tasks(), *_comparison_tasks(study, settings))


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """Sections: summary, effects, single factors, envelopes."""
    study = read_study(settings)
    if study.missing:
        return (Section("The study", (Text(f"Not computed here: {study.missing}", "warn"),), STUDY),)
    outcome = _study_result(study, results)
    first: tuple[Block, ...] = (
        Text(study.description),
        Text(describe_cost(outcome) + " " + describe_agreement(settings, results)),
        *build_summary(outcome),
        Fold("Designs, and why these", build_design_blocks(outcome)),
        Fold("Points, each with the command that computes it again", build_point_blocks(outcome)),
    )
    made = (
        Section("The study", first, STUDY),
        Section("Study: effects", build_effect_blocks(outcome), "study-effects"),
        Section("Study: one factor at a time", build_curve_blocks(outcome), "study-curves"),
        Section("Study: operating envelope", build_envelope_blocks(outcome), ENVELOPE),
    )
    return tuple(section for section in made if section.blocks)


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """Findings of the study on the paper's claims."""
    study = read_study(settings)
    if study.missing:
        return ()
    outcome = _study_result(study, results)
    response = study.responses[0]
    told = [f"{design.name}: {describe_main_effects(response, design, fit)} {describe_interactions(response, fit, 2)}"
            for design, fit in outcome.fits(response)]  # fmt: skip
    made = [Finding(
        "Contribution 3: study of grid resolution, ICP parameters and vehicle speed",
        "announced; no table or figure of it is printed",
        " ".join(told),
        "not determined by the text",
        f"{len(outcome.results):,} runs of the compiled core; levels and designs are the choice of this project",
        "study-effects",
    )]  # fmt: skip
    for choice in study.envelopes:
        design, found = study.design(choice.design), compute_panels(outcome, choice)
        slow_holds = all(panel.inside.flat[0] for panel in found)
        fast_fails = not all(panel.inside.all() for panel in found)
        made.append(Finding(
            "Consistent maps at low to medium speed; fast motion is a limit",
            "no figure is given",
            f"{describe_limit(choice)}, {' '.join(describe_panels(choice, design, found))}",
            "reproduced" if slow_holds and fast_fails else "not determined by the text",
            "the effect of speed depends on odometry, deskewing and scan rate; the text names only the "
            "last" if slow_holds else "in some configurations even the slowest drives exceed the limit",
            ENVELOPE,
        ))  # fmt: skip
    return tuple(made)


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


def _comparison_tasks(study: Study, settings: Settings) -> tuple[AnyTask, ...]:
    """Comparisons of core and reference at points evenly spread over the designs."""
    points = list(study.points.values())
    count = min(int(settings["comparisons"]), len(points))
    chosen = [points[number * len(points) // count] for number in range(count)]
    first = study.seeds(chosen[0].key)[0]
    seed: dict[str, Value] = {} if first is None else {"seed": first}
    return tuple(
        make_task(
            f"comparison {point.key}",
            core_agreement.compare_poses,
            backends=(REFERENCE, study.backend),
            parameters=dict(point.method),
            dataset=study.dataset,
            sequence={**point.sequence, **seed},
            scans=int(settings["comparison_scans"]),
        ).depending_on("evalkit_baselines.paper", "evalkit_baselines.embedded")
        for point in chosen
    )


def _study_result(study: Study, results: Results) -> StudyResult:
    return StudyResult(study, {task.name: cast(RunScores, results[task.name]) for task in study.tasks()})


@lru_cache(maxsize=4)
def _read_cached(file: Path, _changed_ns: int) -> Study:
    return load_study(file, f"evalkit study {file}")


CHAPTER = Chapter("study", PARAMETERS, tasks, sections, findings)
