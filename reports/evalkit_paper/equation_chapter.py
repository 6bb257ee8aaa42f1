"""Chapter on the paper's equations: as printed, corrected, and the effect of a literal implementation."""

from __future__ import annotations

import numpy as np

from evalkit.core.se2 import Floats
from evalkit.execution.task import AnyTask, Result, make_task
from evalkit.plugins.parameters import Parameter
from evalkit.report.html import charts
from evalkit.report.html.blocks import Block, Cell, Figure, Figures, Section, Table, Text
from evalkit.report.html.charts import Axis, Curve, Points
from evalkit_paper import equation_checks as checks
from evalkit_paper.chapter import Chapter, Finding, Results, Settings, Verdict

ANCHOR = "equations"

PARAMETERS = (
    Parameter("seeds", 50, "", "draws of Table 1's noise", low=3, high=1000),
    Parameter("walls", 1000, "", "single walls with noise", low=20, high=100_000),
    Parameter("sequence", "lab", "", "simulated sequence for checks on scans"),
    Parameter("laps", 0.5, "", "how much of it", low=0.05, high=2.0),
    Parameter("pairs", 60, "", "successive scans for the stop rules", low=5, high=1000),
    Parameter("every", 5, "", "one in so many scans is mapped", low=1, high=100),
)


def tasks(settings: Settings) -> tuple[AnyTask, ...]:
    """One task per check; each takes seconds."""
    sequence, laps, seeds = settings["sequence"], settings["laps"], settings["seeds"]
    on_sequence = (
        make_task(
            "stopped odometry", checks.compare_stop_rules, sequence=sequence, seed=0, laps=laps, most=settings["pairs"],
            guess="odometry",
        ),
        make_task(
            "stopped off", checks.compare_stop_rules, sequence=sequence, seed=0, laps=laps, most=settings["pairs"],
            guess="off",
        ),
        make_task("composed", checks.check_composition, sequence=sequence, seed=0, laps=laps),
        make_task("subtracted", checks.check_l_free, sequence=sequence, seed=0, laps=laps, every=settings["every"]),
    )  # fmt: skip
    return (
        make_task("transposed", checks.check_transpose, seeds=seeds),
        make_task("mirrored", checks.check_mirrored_walls, walls=settings["walls"]),
        make_task("evaluated", checks.compare_error_times, seeds=seeds),
        make_task("headings", checks.check_heading, count=3600),
        make_task("shared", checks.count_shared_targets, seeds=seeds),
        *(task.depending_on("evalkit_datasets.synthetic") for task in on_sequence),
    )


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """Table of equations, with figures where a number is not enough."""
    blocks: list[Block] = [
        Text(
            "Every row is computed for this page; the same checks run as tests of the software. The wrong formulae "
            "exist only in this page's code, not in the method that is compared."
        ),
        _equation_table(results),
        Figures((_convergence_figure(results["transposed"]), _path_figure(results["composed"]))),
        Figures((_map_figure(results["subtracted"], "added"), _map_figure(results["subtracted"], "subtracted"))),
        Text(
            f"Scans: '{settings['sequence']}', {settings['laps']:g} laps, seed 0. Scene: the first room of Table 1.",
            "note",
        ),
    ]
    return (Section("Equations", blocks, ANCHOR),)


VERDICTS: tuple[tuple[str, Verdict, str], ...] = (
    ("Eq. 4, rotation", "reproduced with a correction", "printed transposed"),
    ("Eq. 4, single wall", "reproduced with a correction", "the guard against reflections is missing"),
    ("Eq. 5, error", "not determined by the text", "the printed error is not the error of Table 1"),
    ("Eq. 7, heading", "reproduced", "correct as printed"),
    ("Eq. 9, composition", "reproduced with a correction", "correct only for steps in the world frame"),
    ("Eq. 11, l_free", "reproduced with a correction", "the printed value is already negative"),
)


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """Findings on the equations that are wrong as printed, and on one that is correct."""
    del settings
    told = {name.text: (printed, literally) for name, printed, _, literally in _equation_rows(results)}
    return tuple(Finding(item, *told[item], verdict, why, ANCHOR) for item, verdict, why in VERDICTS)


def _equation_table(results: Results) -> Table:
    columns = ("Equation", "As printed", "Correct", "If implemented literally")
    return Table(columns, _equation_rows(results), sortable=False)


def _equation_rows(results: Results) -> list[tuple[Cell, str, str, str]]:
    rows = (
        ("Eq. 2, subsets", "matched subsets of equal size, N' <= N",
         "of several points with the same reference point only the closest is kept",
         _describe_subsets(results["shared"])),
        ("Eq. 4, rotation", "R = U V^T of K = U S V^T", "R = V diag(1, det(V U^T)) U^T",
         _describe_transpose(results["transposed"])),
        ("Eq. 4, single wall", "no guard against reflections", "the diagonal with the determinant, or one angle",
         _describe_mirrors(results["mirrored"])),
        ("Eq. 5, error", "mean squared distance, change below 1e-4", "mean distance (m), the error of Table 1",
         _describe_stop_rules(results["stopped odometry"], results["stopped off"])),
        ("Eq. 5, when", "before or after the step is not stated", "after the step, over the same pairs",
         _describe_before_step(results["evaluated"])),
        ("Eq. 7, heading", "theta = atan2(r21, r11)", "the same",
         _describe_heading(results["headings"])),
        ("Eq. 9, composition", "T_k = dT T_(k-1)",
         "on the left for dT in the world frame, on the right for dT in the body frame",
         _describe_composition(results["composed"])),
        ("Eq. 11, l_free", "l_free = ln(0.3 / 0.7), subtracted", "negative (-0.847), therefore added",
         _describe_l_free(results["subtracted"])),
    )  # fmt: skip
    return [(Cell(name), printed, correct, literally) for name, printed, correct, literally in rows]


def _describe_subsets(found: Result) -> str:
    return (
        f"Without the filter {found['pairs_all']:.0f} points of the first scan use only {found['targets_all']:.0f} "
        f"reference points: the subsets differ in size. With it {found['pairs_one']:.0f} one-to-one pairs of "
        f"{found['points']} points remain."
    )


def _describe_transpose(found: Result) -> str:
    return (
        f"The transpose turns each step the wrong way: {found['printed_reached']} of {found['seeds']} seeds reach the "
        f"true motion within 40 iterations, {found['correct_reached']} with the correct formula; final mean distance "
        f"{found['printed'][:, -1].mean():.2f} m against {found['correct'][:, -1].mean():.3f} m."
    )


def _describe_mirrors(found: Result) -> str:
    return (
        f"{found['unguarded']} of {found['walls']:,} noisy walls are mirrored, {found['guarded']} with the guard; a "
        f"point 1 m in front of the wall moves {found['worst_m']:.1f} m, behind it."
    )


def _describe_stop_rules(near: Result, far: Result) -> str:
    printed, tight, off = near["rules"]["printed"], near["rules"]["tight"], far["rules"]
    return (
        f"On successive scans from the odometry's guess it stops after {np.median(printed['iterations']):.0f} "
        f"iterations (with epsilon 1e-6: {np.median(tight['iterations']):.0f}), because the mean square is only "
        f"{np.median(printed['first_square']):.1g} m^2 at the start and hardly changes by 1e-4. From a guess "
        f"{100 * np.median(far['guess_m']):.0f} cm and {np.median(far['guess_deg']):.0f} deg off the remaining error "
        f"is {100 * np.median(off['printed']['error_m']):.1f} cm and {np.median(off['printed']['error_deg']):.2f} deg; "
        f"with epsilon 1e-6 {100 * np.median(off['tight']['error_m']):.1f} cm and "
        f"{np.median(off['tight']['error_deg']):.2f} deg."
    )


def _describe_before_step(found: Result) -> str:
    more = found["before"] - found["after"]
    return f"Computed before the step: {more.mean():+.2f} iterations on Table 1's scene ({len(more)} seeds)."


def _describe_heading(found: Result) -> str:
    return f"Correct: error at most {max(found['worst_rad'], 1e-16):.0e} rad over {found['count']:,} headings."


def _describe_composition(found: Result) -> str:
    return (
        f"Exact body-frame steps composed on the left end {found['left_error_m']:.1f} m from the true position after "
        f"{found['path_m']:.1f} m with turns up to {found['turned_deg']:.0f} deg; on the right "
        f"{found['right_error_m']:.0e} m."
    )


def _describe_l_free(found: Result) -> str:
    return (
        f"{100 * found['subtracted_wrong']:.0f} % of {found['cells']:,} truly free cells are marked occupied; "
        f"{100 * found['added_wrong']:.1f} % if it is added."
    )


def _convergence_figure(found: Result) -> Figure:
    curves = [
        _range_curve("R = U V^T as printed", found["printed"]),
        _range_curve("R = V diag(1, det) U^T", found["correct"]),
    ]
    body = charts.lines(curves, Axis("iteration", low=1.0), Axis("mean distance [m]", "log"))
    return Figure(body, "Equation 4 on Table 1's scene", "Mean over the seeds; bands: minimum to maximum.")


def _range_curve(label: str, profiles: Floats) -> Curve:
    iterations = np.arange(1.0, profiles.shape[1] + 1)
    return Curve(label, iterations, profiles.mean(axis=0), profiles.min(axis=0), profiles.max(axis=0))


def _path_figure(found: Result) -> Figure:
    layers = (
        Points("truth", found["true"], "#000000", 3.0, joined=True),
        Points("steps on the right", found["right"], "#56b4e9", 1.2, joined=True),
        Points("steps on the left (eq. 9)", found["left"], "#d55e00", 1.5, joined=True),
    )
    body = charts.scatter(layers, Axis("x [m]"), Axis("y [m]"))
    return Figure(body, "Equation 9 with body-frame steps", "The same exact steps, composed on either side.")


def _map_figure(found: Result, name: str) -> Figure:
    left, right, bottom, top = found["extent_m"]
    body = charts.picture(1.0 - found[name][::-1], (left, right, bottom, top))
    title = {"added": "l_free added", "subtracted": "l_free subtracted, as printed"}[name]
    wrong = 100 * found[f"{name}_wrong"]
    return Figure(body, title, f"Black: occupied. {wrong:.1f} % of the truly free cells are marked occupied.")


CHAPTER = Chapter(ANCHOR, PARAMETERS, tasks, sections, findings)
