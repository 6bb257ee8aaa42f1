"""The chapter on the paper's equations: as printed, as they must be, and what a literal implementation would do."""

from __future__ import annotations

import numpy as np

from evalkit.core.se2 import Floats
from evalkit.execution.task import AnyTask, Result, make_task
from evalkit.plugins.protocols import Parameter
from evalkit.report.html import charts
from evalkit.report.html.charts import Axis, Curve, Points
from evalkit.report.html.document import Block, Cell, Figure, Figures, Section, Table, Text
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


def jobs(settings: Settings) -> tuple[AnyTask, ...]:
    """One computation a check; each takes seconds."""
    sequence, laps, seeds = settings["sequence"], settings["laps"], settings["seeds"]
    on_sequence = (
        make_task(
            "stopped odometry", checks.stopped, sequence=sequence, seed=0, laps=laps, most=settings["pairs"],
            guess="odometry",
        ),
        make_task(
            "stopped off", checks.stopped, sequence=sequence, seed=0, laps=laps, most=settings["pairs"], guess="off"
        ),
        make_task("composed", checks.composed, sequence=sequence, seed=0, laps=laps),
        make_task("subtracted", checks.subtracted, sequence=sequence, seed=0, laps=laps, every=settings["every"]),
    )  # fmt: skip
    return (
        make_task("transposed", checks.transposed, seeds=seeds),
        make_task("mirrored", checks.mirrored, walls=settings["walls"]),
        make_task("evaluated", checks.evaluated, seeds=seeds),
        make_task("headings", checks.headings, count=3600),
        make_task("shared", checks.shared, seeds=seeds),
        *(task.depending_on("evalkit_datasets.synthetic") for task in on_sequence),
    )


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """The table of equations, and a drawing where one shows more than a number."""
    blocks: list[Block] = [
        Text(
            "Every line is backed by a computation made for this page; the same checks run as tests of the software. "
            "The mistakes stand in this page's own code, none in the method that is compared."
        ),
        _table(results),
        Figures((_transposed(results["transposed"]), _composed(results["composed"]))),
        Figures((_map(results["subtracted"], "added"), _map(results["subtracted"], "taken"))),
        Text(
            f"The scans are those of '{settings['sequence']}', {settings['laps']:g} laps, seed 0; the scene is the "
            "first one of Table 1.",
            "note",
        ),
    ]
    return (Section("Equations", blocks, ANCHOR),)


VERDICTS: tuple[tuple[str, Verdict, str], ...] = (
    ("Eq. 4, rotation", "reproduced with a correction", "transposed in print"),
    ("Eq. 4, single wall", "reproduced with a correction", "the guard against reflections is missing"),
    ("Eq. 5, error", "not determined by the text", "the printed error is not the one Table 1 lists"),
    ("Eq. 7, heading", "reproduced", "right as printed"),
    ("Eq. 9, composition", "reproduced with a correction", "right only for steps in the world's frame"),
    ("Eq. 11, l_free", "reproduced with a correction", "the printed value is negative already"),
)


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """A line for every equation that cannot be meant as printed, and for one that can."""
    del settings
    told = {name.text: (printed, literally) for name, printed, _, literally in _rows(results)}
    return tuple(Finding(item, *told[item], verdict, why, ANCHOR) for item, verdict, why in VERDICTS)


def _table(results: Results) -> Table:
    columns = ("Equation", "As printed", "Correct", "If implemented literally")
    return Table(columns, _rows(results), sortable=False)


def _rows(results: Results) -> list[tuple[Cell, str, str, str]]:
    rows = (
        ("Eq. 2, subsets", "matched subsets of equal size, N' <= N",
         "of several points that share a reference point only the closest stays", _shared(results["shared"])),
        ("Eq. 4, rotation", "R = U V^T of K = U S V^T", "R = V diag(1, det(V U^T)) U^T",
         _never(results["transposed"])),
        ("Eq. 4, single wall", "no guard against reflections", "the diagonal with the determinant, or one angle",
         _mirrors(results["mirrored"])),
        ("Eq. 5, error", "mean squared distance, change below 1e-4", "mean distance (m), the one Table 1 lists",
         _stops(results["stopped odometry"], results["stopped off"])),
        ("Eq. 5, when", "not said whether before or after the step", "after the step, over the same pairs",
         _before(results["evaluated"])),
        ("Eq. 7, heading", "theta = atan2(r21, r11)", "the same",
         _right(results["headings"])),
        ("Eq. 9, composition", "T_k = dT T_(k-1)",
         "on the left for a dT in the world's frame, on the right for one in the body's", _thrown(results["composed"])),
        ("Eq. 11, l_free", "l_free = ln(0.3 / 0.7), subtracted", "it is negative (-0.847): added",
         _marked(results["subtracted"])),
    )  # fmt: skip
    return [(Cell(name), printed, correct, literally) for name, printed, correct, literally in rows]


def _shared(found: Result) -> str:
    return (
        f"Without the filter {found['pairs_all']:.0f} points of the first scan meet only {found['targets_all']:.0f} "
        f"reference points: the subsets differ in size. With it {found['pairs_one']:.0f} pairs of {found['points']} "
        "stay, one to one."
    )


def _never(found: Result) -> str:
    return (
        f"It is the transpose, so each step turns the wrong way: {found['printed_reached']} of {found['seeds']} seeds "
        f"reach the truth within 40 iterations, with the right one {found['correct_reached']}; mean distance left "
        f"{found['printed'][:, -1].mean():.2f} m against {found['correct'][:, -1].mean():.3f} m."
    )


def _mirrors(found: Result) -> str:
    return (
        f"{found['unguarded']} of {found['walls']:,} noisy walls come back mirrored, with the guard "
        f"{found['guarded']}; a point 1 m before the wall lands {found['worst_m']:.1f} m away, behind it."
    )


def _stops(near: Result, far: Result) -> str:
    printed, tight, off = near["rules"]["printed"], near["rules"]["tight"], far["rules"]
    return (
        f"On successive scans from the odometry's guess it stops after {np.median(printed['iterations']):.0f} "
        f"iterations (iterated to the end: {np.median(tight['iterations']):.0f}), for the mean square is "
        f"{np.median(printed['first_square']):.1g} m^2 from the start and can hardly change by 1e-4. From a guess "
        f"{100 * np.median(far['guess_m']):.0f} cm and {np.median(far['guess_deg']):.0f} deg off it leaves "
        f"{100 * np.median(off['printed']['error_m']):.1f} cm and {np.median(off['printed']['error_deg']):.2f} deg; "
        f"iterated to the end {100 * np.median(off['tight']['error_m']):.1f} cm and "
        f"{np.median(off['tight']['error_deg']):.2f} deg."
    )


def _before(found: Result) -> str:
    more = found["before"] - found["after"]
    return f"Before the step takes {more.mean():+.2f} iterations on Table 1's scene ({len(more)} seeds)."


def _right(found: Result) -> str:
    return f"Right: at most {max(found['worst_rad'], 1e-16):.0e} rad off over {found['count']:,} headings."


def _thrown(found: Result) -> str:
    return (
        f"Exact body-frame steps put on the left end {found['left_error_m']:.1f} m from the truth after "
        f"{found['path_m']:.1f} m with turns up to {found['turned_deg']:.0f} deg; on the right "
        f"{found['right_error_m']:.0e} m."
    )


def _marked(found: Result) -> str:
    return (
        f"{100 * found['taken_wrong']:.0f} % of {found['cells']:,} truly free cells are marked occupied; added, "
        f"{100 * found['added_wrong']:.1f} % are."
    )


def _transposed(found: Result) -> Figure:
    curves = [
        _band("R = U V^T as printed", found["printed"]),
        _band("R = V diag(1, det) U^T", found["correct"]),
    ]
    body = charts.lines(curves, Axis("iteration", low=1.0), Axis("mean distance [m]", "log"))
    return Figure(body, "Equation 4 on Table 1's scene", "Mean over the seeds; bands from the least to the greatest.")


def _band(label: str, profiles: Floats) -> Curve:
    iterations = np.arange(1.0, profiles.shape[1] + 1)
    return Curve(label, iterations, profiles.mean(axis=0), profiles.min(axis=0), profiles.max(axis=0))


def _composed(found: Result) -> Figure:
    layers = (
        Points("truth", found["true"], "#000000", 3.0, joined=True),
        Points("steps on the right", found["right"], "#56b4e9", 1.2, joined=True),
        Points("steps on the left (eq. 9)", found["left"], "#d55e00", 1.5, joined=True),
    )
    body = charts.scatter(layers, Axis("x [m]"), Axis("y [m]"))
    return Figure(body, "Equation 9 with body-frame steps", "The same exact steps, put together on either side.")


def _map(found: Result, name: str) -> Figure:
    left, right, bottom, top = found["extent_m"]
    body = charts.picture(1.0 - found[name][::-1], (left, right, bottom, top))
    title = {"added": "l_free added", "taken": "l_free subtracted, as printed"}[name]
    wrong = 100 * found[f"{name}_wrong"]
    return Figure(body, title, f"Black: occupied. {wrong:.1f} % of the truly free cells are marked occupied.")


CHAPTER = Chapter(ANCHOR, PARAMETERS, jobs, sections, findings)
