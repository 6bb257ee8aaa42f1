"""Chapter on what the paper leaves open about its two stages: readings of local map and stop rule, on one drive."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from evalkit.execution.task import AnyTask, make_task
from evalkit.metrics.trajectory import rms
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter, Value
from evalkit.report.html.blocks import Cell, Column, Section, Table, Text, Tone
from evalkit_paper import stage_errors, verdicts
from evalkit_paper.chapter import Case, Chapter, Finding, Results, Settings

ANCHOR = "two-stages"
PRINTED = "printed"
"""Mark of the cases that the paper's text allows."""


_CELLS: Mapping[str, Value] = {"local_map": "grid", "local_map_cell_m": 0.05}
_NEAR: Mapping[str, Value] = {"keyframe_distance_m": 0.2, "keyframe_angle_deg": 10.0}
_LOG_ODDS_2 = 0.8807970779778823  # 1 / (1 + exp(-2))

CONFIGURATIONS = (
    Case("odometry only", parameters={"scan_to_scan": False, "scan_to_map": False}),
    Case("scan to scan only, 1e-4", parameters={"scan_to_map": False, "deskew": False}),
    Case("scan to map only, 10 keyframes (0.5 m, 20 deg), 1e-4", parameters={"scan_to_scan": False}),
    Case(
        "last 10 scans, mean square 1e-4 m^2", "paper-literal", {"local_map": "scans", "deskew": False}, mark=PRINTED
    ),
    Case("last 10 scans, mean 1e-4", parameters={"local_map": "scans", "deskew": False}, mark=PRINTED),
    Case("occupied cells (P > 0.5), mean 1e-4", parameters={**_CELLS, "deskew": False}, mark=PRINTED),
    Case("10 keyframes (0.2 m, 10 deg), mean 1e-4, deskewed", parameters=_NEAR),
    Case("10 keyframes (0.5 m, 20 deg), mean 1e-4, deskewed ('paper')"),
    Case("10 keyframes (0.2 m, 10 deg), 1e-6, deskewed", "paper-tight", _NEAR),
    Case("the same, one-to-one only in scan to map", "paper-tight", {**_NEAR, "s2s.one_to_one": False}),
    Case("10 keyframes (0.5 m, 20 deg), 1e-6, deskewed ('paper-tight')", "paper-tight"),
    Case("10 cm voxel means of 10 keyframes, every pair, 1e-6, deskewed", "paper-tight",
                  {"local_map_voxel_m": 0.1, "one_to_one": False}),
    Case("occupied cells (log-odds > 2), every pair, 1e-6, deskewed", "paper-tight",
                  {**_CELLS, "local_map_probability": _LOG_ODDS_2, "one_to_one": False}),
    Case("lasting map of 10 cm voxels, every pair, 1e-6, deskewed ('paper-map')", "paper-map"),
)  # fmt: skip

PARAMETERS = (
    Parameter("seeds", 1, "", "drives with different noise", low=1, high=20),
    Parameter("laps", 2.0, "", "laps of the laboratory", low=0.05, high=10.0),
    Parameter("speed_mps", 0.3, "m/s", "speed between the ramps", low=0.05, high=3.0),
    Parameter("rate_hz", 10.0, "Hz", "lidar rate", low=5.0, high=15.0),
)


def tasks(settings: Settings) -> tuple[AnyTask, ...]:
    """Tasks: every configuration for every seed."""
    return tuple(_task(settings, each, seed) for each in CONFIGURATIONS for seed in range(settings["seeds"]))


def _task(settings: Settings, each: Case, seed: int) -> AnyTask:
    drive = {"seed": seed, **{name: settings[name] for name in ("laps", "speed_mps", "rate_hz")}}
    return make_task(
        f"{each.name}, seed {seed}",
        measure_configuration,
        backend=each.backend,
        parameters=dict(each.parameters),
        sequence=drive,
    ).depending_on("evalkit_datasets.worlds.synthetic", "evalkit_baselines.paper")


def measure_configuration(
    *, backend: str, parameters: Mapping[str, Any], sequence: Mapping[str, Any]
) -> dict[str, Any]:
    """One configuration over one drive: "ate_m", "final_percent", "path_m"; "s2s", "s2m" (mean iterations or None)."""
    lab = registry.dataset("lab").make(**sequence)
    found = stage_errors.run_with_errors(lab, backend, parameters)
    truth = stage_errors.true_trajectory(lab)
    counts = {stage: found.iterations[stage][1:] for stage in stage_errors.STAGES}
    return {
        "ate_m": rms(stage_errors.position_errors_m(found.estimate, truth)),
        "final_percent": stage_errors.final_percent(found.estimate, truth),
        "path_m": truth.path_m,
        **{stage: None if np.isnan(each).all() else float(np.nanmean(each)) for stage, each in counts.items()},
    }


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """The section of this chapter."""
    path_m = _values(settings, results, CONFIGURATIONS[0], "path_m")[0]
    columns = (
        "Configuration", "Possible reading",
        Column("ATE", "m", number=True, tip="RMS after least-squares alignment; mean over the seeds"),
        Column("final", "% of path", number=True, tip="error of the last pose, aligned at the first"),
        Column("S2S iterations", number=True), Column("S2M iterations", number=True),
    )  # fmt: skip
    best = min(float(np.mean(_values(settings, results, each, "ate_m"))) for each in CONFIGURATIONS)
    rows = [_configuration_row(settings, results, each, best) for each in CONFIGURATIONS]
    text = (
        f"The laboratory, {settings['laps']:g} laps ({path_m:.0f} m) at {settings['speed_mps']:g} m/s and "
        f"{settings['rate_hz']:g} Hz, {settings['seeds']} seed{'s' if settings['seeds'] > 1 else ''}. The paper "
        "describes neither the local map of its second stage nor the unit of its threshold; possible readings of the "
        "text are marked. One-to-one pairs of at most 0.3 m unless a row says otherwise."
    )
    return (Section("Two stages: what the text leaves open", (Text(text), Table(columns, rows)), ANCHOR),)


def _configuration_row(settings: Settings, results: Results, each: Case, best: float) -> list[Cell | str]:
    ate, final = (_values(settings, results, each, name) for name in ("ate_m", "final_percent"))
    odometry = float(np.mean(_values(settings, results, CONFIGURATIONS[0], "ate_m")))
    mean = float(np.mean(ate))
    tone: Tone = "bad" if mean > odometry else "good" if mean <= 1.5 * best else ""
    spread = f" ({min(ate):.3f} to {max(ate):.3f})" if len(ate) > 1 else ""
    iterations = [_values(settings, results, each, stage) for stage in stage_errors.STAGES]
    return [
        each.name, "yes" if each.mark else "",
        Cell(f"{mean:.3f}{spread}", mean, tone), Cell(f"{np.mean(final):.2f}", float(np.mean(final))),
        *(Cell(f"{np.mean(count):.1f}", float(np.mean(count))) if count else Cell("", -1.0) for count in iterations),
    ]  # fmt: skip


def _values(settings: Settings, results: Results, each: Case, name: str) -> list[float]:
    found = (results[f"{each.name}, seed {seed}"][name] for seed in range(settings["seeds"]))
    return [value for value in found if value is not None]


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """Finding: how much the drift depends on the reading of the text."""
    mean = {each.name: float(np.mean(_values(settings, results, each, "ate_m"))) for each in CONFIGURATIONS}
    literal = [mean[each.name] for each in CONFIGURATIONS if each.mark]
    return (
        Finding(
            "Section 3, the two stages", "scan to scan, then scan to a local map that is not described",
            f"ATE {min(literal):.3f} to {max(literal):.3f} m for the readings of the text, {min(mean.values()):.3f} m "
            f"at best, {mean['odometry only']:.3f} m by odometry alone",
            verdicts.judge_two_stages(literal, mean["odometry only"]), ANCHOR,
        ),
    )  # fmt: skip


CHAPTER = Chapter("configurations", PARAMETERS, tasks, sections, findings)
