"""Chapter on the paper's equations: as printed, corrected, and the effect of a literal implementation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from evalkit.core.se2 import Floats
from evalkit.execution.task import AnyTask, Result, make_task
from evalkit.plugins.parameters import Parameter
from evalkit.report.html import charts
from evalkit.report.html.blocks import Block, Cell, Figure, Figures, Section, Table, Text
from evalkit.report.html.charts import Axis, Curve, Points
from evalkit_paper import equation_checks as checks
from evalkit_paper import verdicts
from evalkit_paper.chapter import Chapter, Finding, Judgement, Results, Settings

ANCHOR = "equations"
K, LAST_ERROR = 0, 2
"""Columns of ``table_1.QUANTITIES``."""

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
    seeds, drive = settings["seeds"], {"sequence": settings["sequence"], "seed": 0, "laps": settings["laps"]}
    on_sequence = (
        *(
            make_task(f"stopped {guess}", checks.compare_stop_rules, **drive, most=settings["pairs"], guess=guess)
            for guess in ("odometry", "off")
        ),
        make_task("composed", checks.check_composition, **drive),
        make_task("free space", checks.check_free_space, **drive, every=settings["every"]),
    )
    return (
        make_task("formulas", checks.check_formulas, count=200),
        make_task("transposed", checks.check_transpose, seeds=seeds),
        make_task("mirrored", checks.check_mirrored_walls, walls=settings["walls"]),
        make_task("evaluated", checks.measure_table_errors, seeds=seeds),
        make_task("shared", checks.count_shared_targets, seeds=seeds),
        *(task.depending_on("evalkit_datasets.worlds.synthetic") for task in on_sequence),
    )


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """Table of equations, with figures where a number is not enough."""
    columns = ("Equation", "As printed", "Correct", "If implemented literally")
    rows = [(Cell(row.name), row.printed, row.correct, row.literally(results)) for row in EQUATIONS]
    blocks: list[Block] = [
        Text(
            "Every row is computed for this page; the same checks run as tests of the software. The wrong formulae "
            "exist only in this page's code, not in the method that is compared."
        ),
        Table(columns, rows, sortable=False),
        Figures((_convergence_figure(results["transposed"]), _path_figure(results["composed"]))),
        Text(
            f"Scans: '{settings['sequence']}', {settings['laps']:g} laps, seed 0. Scene: the first room of Table 1.",
            "note",
        ),
    ]
    return (Section("Equations", blocks, ANCHOR),)


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """A finding on every equation."""
    del settings
    return tuple(Finding(row.name, row.printed, row.literally(results), row.judge(results), ANCHOR)
                 for row in EQUATIONS)  # fmt: skip


@dataclass(frozen=True)
class Equation:
    """An equation as printed and corrected, its effect if implemented literally, and the judgement."""

    name: str
    printed: str
    correct: str
    literally: Callable[[Results], str]
    judge: Callable[[Results], Judgement]


def _formula(name: str, printed: str, key: str, unit: str = "m") -> Equation:
    """An equation that is correct as printed: this software computes it."""

    def tell(results: Results) -> str:
        found = results["formulas"]
        return f"Differs by at most {max(found[key], 1e-16):.0e} {unit} over {found['count']} random values."

    return Equation(
        name, printed, "the same", tell, lambda results: verdicts.judge_formula(results["formulas"][key])
    )  # fmt: skip


def _describe_subsets(results: Results) -> str:
    found = results["shared"]
    return (
        f"Without the filter {found['pairs_all']:.0f} points of the first scan use only {found['targets_all']:.0f} "
        f"reference points: the subsets differ in size. With it {found['pairs_one']:.0f} one-to-one pairs of "
        f"{found['points']} points remain."
    )


def _describe_transpose(results: Results) -> str:
    found = results["transposed"]
    return (
        f"The transpose turns each step the wrong way: {found['printed_reached']} of {found['seeds']} seeds reach the "
        f"true motion within 40 iterations, {found['correct_reached']} with the correct formula; final mean distance "
        f"{found['printed'][:, -1].mean():.2f} m against {found['correct'][:, -1].mean():.3f} m."
    )


def _judge_transpose(results: Results) -> Judgement:
    printed, correct = (results["transposed"][f"{name}_reached"] for name in ("printed", "correct"))
    seeds = results["transposed"]["seeds"]
    return verdicts.judge_correction(printed / seeds, correct / seeds, "R = V diag(1, det(V U^T)) U^T")


def _describe_mirrors(results: Results) -> str:
    found = results["mirrored"]
    return (
        f"{found['unguarded']} of {found['walls']:,} noisy walls are mirrored, {found['guarded']} with the guard; a "
        f"point 1 m in front of the wall moves {found['worst_m']:.1f} m, behind it."
    )


def _judge_mirrors(results: Results) -> Judgement:
    found = results["mirrored"]
    printed, guarded = (1.0 - found[name] / found["walls"] for name in ("unguarded", "guarded"))
    return verdicts.judge_correction(printed, guarded, "a guard against reflections")


def _describe_stop_rules(results: Results) -> str:
    near, far = results["stopped odometry"], results["stopped off"]
    printed, tight, off = near["rules"]["printed"], near["rules"]["tight"], far["rules"]
    last = results["evaluated"]["square"][:, LAST_ERROR].mean()
    return (
        f"On Table 1's scene its last value is {last:.4f} m^2. On successive scans from the odometry's guess it stops "
        f"after {np.median(printed['iterations']):.0f} iterations (with epsilon 1e-6: "
        f"{np.median(tight['iterations']):.0f}), because the mean square is only "
        f"{np.median(printed['first_square']):.1g} m^2 at the start and hardly changes by 1e-4. From a guess "
        f"{100 * np.median(far['guess_m']):.0f} cm and {np.median(far['guess_deg']):.0f} deg off the remaining error "
        f"is {100 * np.median(off['printed']['error_m']):.1f} cm and {np.median(off['printed']['error_deg']):.2f} deg; "
        f"with epsilon 1e-6 {100 * np.median(off['tight']['error_m']):.1f} cm and "
        f"{np.median(off['tight']['error_deg']):.2f} deg."
    )


def _judge_table_errors(results: Results, one: str, other: str, column: int) -> tuple[float, float]:
    found = results["evaluated"]
    return float(found[f"{one} sigmas"][column]), float(found[f"{other} sigmas"][column])


def _describe_before_step(results: Results) -> str:
    found = results["evaluated"]
    more = found["before"][:, K] - found["after"][:, K]
    return f"Computed before the step: {more.mean():+.2f} iterations on Table 1's scene ({len(more)} seeds)."


def _describe_composition(results: Results) -> str:
    found = results["composed"]
    return (
        f"Exact body-frame steps composed on the left end {found['left_error_m']:.1f} m from the true position after "
        f"{found['path_m']:.1f} m with turns up to {found['turned_deg']:.0f} deg; on the right "
        f"{found['right_error_m']:.0e} m."
    )


def _judge_composition(results: Results) -> Judgement:
    left, right = (float(results["composed"][f"{side}_error_m"] < verdicts.EXACT) for side in ("left", "right"))
    return verdicts.judge_correction(left, right, "steps in the body frame are composed on the right")


def _describe_update(results: Results) -> str:
    found = results["free space"]
    return f"{100 * found['wrong']:.1f} % of {found['cells']:,} truly free cells are marked occupied."


EQUATIONS = (
    _formula("Eq. 1, extrinsics", "P_body = R_l [r cos phi, r sin phi] + t_l", "extrinsics"),
    _formula("Eq. 2, nearest point", "each p with its nearest q", "nearest"),
    Equation(
        "Eq. 2, subsets", "matched subsets of equal size, N' <= N",
        "of several points with the same reference point only the closest is kept", _describe_subsets,
        lambda results: verdicts.judge_subsets(results["shared"]["pairs_one"], results["shared"]["targets_one"]),
    ),
    _formula("Eq. 3, centroids and K", "K = sum (p - pbar)(q - qbar)^T", "alignment"),
    Equation("Eq. 4, rotation", "R = U V^T of K = U S V^T", "R = V diag(1, det(V U^T)) U^T", _describe_transpose,
             _judge_transpose),
    Equation("Eq. 4, single wall", "no guard against reflections", "the diagonal with the determinant, or one angle",
             _describe_mirrors, _judge_mirrors),
    Equation(
        "Eq. 5, error", "mean squared distance, change below 1e-4", "mean distance (m), the error of Table 1",
        _describe_stop_rules,
        lambda results: verdicts.judge_error(*_judge_table_errors(results, "square", "after", LAST_ERROR)),
    ),
    Equation(
        "Eq. 5, when", "before or after the step is not stated", "after the step, over the same pairs",
        _describe_before_step,
        lambda results: verdicts.judge_error_time(*_judge_table_errors(results, "after", "before", K)),
    ),
    _formula("Eq. 6 and 8, homogeneous matrix and position (read from their place between eq. 4 and 9)",
             "T of R and t, position of T", "matrix"),
    _formula("Eq. 7, heading", "theta = atan2(r21, r11)", "heading", "rad"),
    Equation("Eq. 9, composition", "T_k = dT T_(k-1)",
             "on the left for dT in the world frame, on the right for dT in the body frame", _describe_composition,
             _judge_composition),
    Equation("Eq. 10, update", "adds l_occ = 0.847 or l_free = ln(0.3 / 0.7) = -0.847", "the same", _describe_update,
             lambda results: verdicts.judge_free_space(results["free space"]["wrong"])),
    _formula("Eq. 11, logistic function", "p = 1 / (1 + exp(-l))", "logistic", "in probability"),
)  # fmt: skip


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


CHAPTER = Chapter(ANCHOR, PARAMETERS, tasks, sections, findings)
