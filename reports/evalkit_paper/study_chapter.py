"""The chapter of the study that the paper announces: grid resolution, ICP parameters and driving."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import cast

from evalkit.commands.study.config import read
from evalkit.commands.study.curves import curve_blocks, envelope_blocks
from evalkit.commands.study.effect_tables import effect_blocks
from evalkit.commands.study.envelope import panels, sentences
from evalkit.commands.study.evaluate import RunScores
from evalkit.commands.study.formatting import fitted, limit_words, main_words, pair_words
from evalkit.commands.study.page import cpu_minutes, design_blocks, point_blocks, summary
from evalkit.commands.study.plan import Study
from evalkit.commands.study.result import StudyResult
from evalkit.execution.task import AnyTask, make_task
from evalkit.plugins.parameters import Parameter, Value
from evalkit.report.html.document import Block, Fold, Section, Text
from evalkit_paper import core_agreement
from evalkit_paper.chapter import Chapter, Finding, Results, Settings

TWIN = "paper"
"""The readable twin of the core."""

PARAMETERS = (
    Parameter("file", "reports/study.toml", "", "the study: factors, designs, responses"),
    Parameter("twins", 6, "", "points at which the core is held against its NumPy twin", low=1),
    Parameter("twin_scans", 60, "scans", "so many scans of each", low=2),
)
STUDY = "study"
ENVELOPE = "study-envelope"


def jobs(settings: Settings) -> tuple[AnyTask, ...]:
    """Every run of the study, and the points at which core and twin are held against each other."""
    study = plan(settings)
    return () if study.missing else (*study.tasks(), *_twins(study, settings))


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """What matters, effects, single factors, envelopes."""
    study = plan(settings)
    if study.missing:
        return (Section("The study", (Text(f"Not computed here: {study.missing}", "warn"),), STUDY),)
    outcome = _outcome(study, results)
    first: tuple[Block, ...] = (
        Text(study.description),
        Text(cost_words(outcome) + " " + twin_words(settings, results)),
        *summary(outcome),
        Fold("Designs, and why these", design_blocks(outcome)),
        Fold("Points, each with the command that computes it again", point_blocks(outcome)),
    )
    made = (
        Section("The study", first, STUDY),
        Section("Study: effects", effect_blocks(outcome), "study-effects"),
        Section("Study: one factor at a time", curve_blocks(outcome), "study-curves"),
        Section("Study: operating envelope", envelope_blocks(outcome), ENVELOPE),
    )
    return tuple(section for section in made if section.blocks)


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """What the study answers of the paper's claims."""
    study = plan(settings)
    if study.missing:
        return ()
    outcome = _outcome(study, results)
    response = study.responses[0]
    told = [f"{design.name}: {main_words(response, design, fit)} {pair_words(response, fit, 2)}"
            for design, fit in fitted(outcome, response)]  # fmt: skip
    made = [Finding(
        "Contribution 3: study of grid resolution, ICP parameters and vehicle speed",
        "announced; no table or figure of it is printed",
        " ".join(told),
        "not determined by the text",
        f"{len(outcome.results):,} runs of the compiled twin; the levels and the designs are this project's choice",
        "study-effects",
    )]  # fmt: skip
    for choice in study.envelopes:
        design, found = study.design(choice.design), panels(outcome, choice)
        slow_holds = all(panel.inside.flat[0] for panel in found)
        fast_fails = not all(panel.inside.all() for panel in found)
        made.append(Finding(
            "Consistent maps at low to medium speed; fast motion is a limit",
            "no figure is given",
            f"{limit_words(choice)}, {' '.join(sentences(choice, design, found))}",
            "reproduced" if slow_holds and fast_fails else "not determined by the text",
            "what a speed costs is decided by odometry, deskewing and the scan rate, of which the text names only the "
            "last" if slow_holds else "in some configurations even the slowest drives leave the limit",
            ENVELOPE,
        ))  # fmt: skip
    return tuple(made)


def plan(settings: Settings) -> Study:
    """The study of the chapter's file."""
    file = Path(str(settings["file"]))
    changed_ns = file.stat().st_mtime_ns if file.exists() else 0
    return _read(file, changed_ns)


def cost_words(outcome: StudyResult) -> str:
    """How much was computed."""
    study = outcome.study
    lost = sum(bool(outcome.lost(key, seed)) for key in study.points for seed in study.seeds(key))
    return (
        f"{len(study.points):,} points in {len(study.designs)} designs, {len(outcome.results):,} runs in "
        f"{cpu_minutes(outcome):.1f} minutes of CPU; {lost:,} runs are lost, and stay in every number."
    )


def twin_words(settings: Settings, results: Results) -> str:
    """How equal core and twin are where both were asked."""
    study = plan(settings)
    names = [job.name for job in _twins(study, settings)]
    metres = max(float(results[name]["apart_m"]) for name in names)
    scans = sum(int(results[name]["scans"]) for name in names)
    return (
        f"All runs are made with '{study.backend}'; at {len(names)} points of the designs, over {scans:,} scans, its "
        f"poses and those of '{TWIN}' with the same parameters are at most {metres:.1e} m apart."
    )


def _twins(study: Study, settings: Settings) -> tuple[AnyTask, ...]:
    """Points evenly spread over the designs, asked of both."""
    points = list(study.points.values())
    count = min(int(settings["twins"]), len(points))
    chosen = [points[number * len(points) // count] for number in range(count)]
    first = study.seeds(chosen[0].key)[0]
    seed: dict[str, Value] = {} if first is None else {"seed": first}
    return tuple(
        make_task(
            f"twin {point.key}",
            core_agreement.apart,
            backends=(TWIN, study.backend),
            parameters=dict(point.method),
            dataset=study.dataset,
            sequence={**point.sequence, **seed},
            scans=int(settings["twin_scans"]),
        ).depending_on("evalkit_baselines.paper", "evalkit_baselines.embedded")
        for point in chosen
    )


def _outcome(study: Study, results: Results) -> StudyResult:
    return StudyResult(study, {task.name: cast(RunScores, results[task.name]) for task in study.tasks()})


@lru_cache(maxsize=4)
def _read(file: Path, _changed_ns: int) -> Study:
    return read(file, f"evalkit study {file}")


CHAPTER = Chapter("study", PARAMETERS, jobs, sections, findings)
