"""The page of ``evalkit basin``: curves, maps and overlays of failures, by scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from evalkit.commands.basin.convergence import SuccessCounts
from evalkit.commands.basin.result import LEVELS, BasinResult, BasinRow, BasinScene, find_answer
from evalkit.commands.basin.sequences import MAX_APART_M, MAX_APART_RAD
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats
from evalkit.report.html import charts
from evalkit.report.html.blocks import (
    Block,
    Bullets,
    Cell,
    Column,
    Command,
    Document,
    Figure,
    Figures,
    Fold,
    Heading,
    Section,
    Table,
    Text,
    slug,
)
from evalkit.report.html.charts import Axis, Curve, Points
from evalkit.stats.intervals import Interval

MAX_POINTS = 150
"""Points of a cloud in an overlay."""

WORST = 3
"""Overlays of failures per back end and scene."""

GREY, START, END = "#9aa3ad", "#e69f00", "#0072b2"
BANDS = 4
"""The largest number of curves with bands; more bands would overlap."""

REACHES = (
    "Below, R50, R75 and R95 are the reach: the largest offset up to which every bin succeeds for at least this "
    "percentage of its guesses, for guesses that are only shifted (m) or only turned (deg). A50, A75 and A95 are "
    "errors of the answers, quantiles over the whole volume (Pomerleau et al. 2013): large if many fail."
)
SHARE = Axis("success [%]", low=0.0, high=100.0)


def document(result: BasinResult, command: str) -> Document:
    """The whole page."""
    trials = result.scenes[0].trials
    count = sum(row.basin is not None for row in result.rows) * trials.offsets
    facts = (
        ("Trials", f"{count:,}"),
        ("Guesses", f"up to {trials.reach_m:g} m and {math.degrees(trials.reach_rad):g} deg off"),
        ("Success", f"within {result.criterion.within_m:g} m and {math.degrees(result.criterion.within_rad):g} deg"),
        ("Seed", str(trials.seed)),
    )
    lead = (
        "The error of the initial guess up to which each registration finds the truth: every back end, with its own "
        "settings, registers the same pairs of scans from the same disturbed guesses."
    )
    scenes = [_scene(result, scene) for scene in result.scenes]
    return Document(
        "evalkit basin", "Convergence basins", lead, (_summary(result), *scenes, _method(result, command)), facts
    )


def _summary(result: BasinResult) -> Section:
    names = [scene.trials.place for scene in result.scenes]
    rows = [
        [Cell(each.label), *(_share_at(result, scene, each.label) for scene in result.scenes)]
        for each in result.methods
        if not each.reason
    ]
    columns = [Column("Back end"), *(Column(name, "%", number=True) for name in names)]
    blocks: list[Block] = [
        Table(
            columns,
            rows,
            "Success in the whole volume of shifts and turns, with Wilson's 95 % interval over the guesses",
        ),
        Text(REACHES, "note"),
        Text(
            "The intervals are over the guesses, for these pairs of scans: others (another --seed) can differ by more.",
            "note",
        ),
        Text(
            "Success is measured against the truth, not by the back end's own flag. If a back end raised an "
            "exception or ended its process, the trials count as failures.",
            "note",
        ),
    ]
    if absent := [(each.label, each.reason) for each in result.methods if each.reason]:
        blocks.append(Table(("Not run", "Reason"), absent))
    if raised := [(row.backend, row.scene, row.reason) for row in result.broken]:
        blocks.append(Table(("Failed", "Scene", "Reason"), raised))
    return Section("Summary", blocks, "summary")


def _share_at(result: BasinResult, scene: BasinScene, label: str) -> Cell:
    row = next(row for row in result.at(scene) if row.backend == label)
    if row.basin is None:
        return Cell("no answer", sort=-1.0, tone="bad", tip=row.reason, link=f"#{slug(row.scene)}")
    share = row.basin.overall()
    return Cell(
        _interval(share), sort=share.value, tone="bad" if row.reason else "", tip=row.reason, link=f"#{slug(row.scene)}"
    )


def _table(rows: Sequence[BasinRow]) -> Table:
    columns = [
        Column("Back end"),
        Column("Success", "%", number=True, tip="of the guesses that fill the volume"),
        *(Column(f"R{100 * level:.0f}", "m", number=True, tip="shifted guesses up to here succeed this often")
          for level in LEVELS),
        Column("R95", "deg", number=True, tip="turned guesses up to here succeed this often"),
        *(Column(name, "m", number=True, tip="this share of the answers is nearer to the truth (Pomerleau 2013)")
          for name in ("A50", "A75", "A95")),
        *(Column(name, "deg", number=True) for name in ("A50", "A75", "A95")),
        Column("False", "%", number=True, tip="of the failures reported as converged"),
    ]  # fmt: skip
    return Table(columns, [_line(row) for row in rows])


def _line(row: BasinRow) -> Sequence[Cell | str]:
    if row.basin is None:
        return (row.backend, Cell("no answer", sort=-1.0, tone="bad", tip=row.reason), *[Cell("-", sort=-1.0)] * 11)
    errors, claimed, share = row.basin.accuracy(), row.basin.falsely_claimed(), row.basin.overall()
    return (
        row.backend,
        Cell(_interval(share), sort=share.value, tip=row.reason or "to its worst failures", link=_anchor(row)),
        *(Cell(f"{row.reach_m(level):.2f}", sort=row.reach_m(level)) for level in LEVELS),
        Cell(f"{row.reach_deg(0.95):.0f}", sort=row.reach_deg(0.95)),
        *(_number(value, 3) for value in errors[:, 0]),
        *(_number(math.degrees(value), 1) for value in errors[:, 1]),
        Cell("-", sort=-1.0)
        if claimed is None
        else Cell(f"{100 * claimed.value:.0f}", sort=claimed.value, link=_anchor(row), tip="to its worst failures"),
    )


def _scene(result: BasinResult, scene: BasinScene) -> Section:
    name = scene.trials.place
    run_labels = {each.label for each in result.methods if not each.reason}
    every = [row for row in result.at(scene) if row.backend in run_labels]
    rows = [row for row in every if row.basin is not None]
    blocks: list[Block] = [Text(f"{scene.what[0].upper()}{scene.what[1:]}. {_directions(scene)}")]
    if rows:
        blocks += [
            _table(every),
            Figures([_curve_figure(rows, name, turned=turned) for turned in (False, True)]),
            Figures([_map(row) for row in rows], small=True),
            Fold("Over the offset in x and y", (Figures([_plane(row) for row in rows], small=True),)),
            Fold("Counts and intervals", [_counts(row) for row in rows]),
            Fold("Failures with the best guesses", _failures(rows, scene)),
        ]
    return Section(f"{name[0].upper()}{name[1:]}", blocks, slug(name))


def _directions(scene: BasinScene) -> str:
    known = scene.known
    best = max(value for value in known.sigma_m if math.isfinite(value))
    bound = "(the bound of Cramer and Rao if all noise were across the walls; along slanted beams less of it is)"
    if names := known.names():
        return (
            f"Degenerate: the {' and the '.join(names)} is unobservable here; guesses and answers are not evaluated "
            f"along it. The other directions can be determined to {100 * best:.2g} cm {bound}."
        )
    weakest = known.shares.min()
    return (
        f"No direction is degenerate: each point gives the weakest {weakest:.2f} of its information, enough for "
        f"{100 * best:.2g} cm {bound}."
    )


def _curve_figure(rows: Sequence[BasinRow], name: str, *, turned: bool) -> Figure:
    """The success over the turn or over the distance of the guesses."""
    series = [(row.backend, row.around() if turned else row.along()) for row in rows]
    unit = 180.0 / math.pi if turned else 1.0
    curves = [_curve(label, shares, unit, len(rows) <= BANDS) for label, shares in series]
    axis = Axis("turn of the guess [deg]" if turned else "offset of the guess [m]", low=0.0)
    quantity, kind = ("turn", "turned and not shifted") if turned else ("distance", "shifted and not turned")
    title, caption = f"Success over the {quantity}, {name}", f"Guesses that are {kind}{_bands(rows)}."
    return Figure(charts.lines(curves, axis, SHARE), title, caption)


def _bands(rows: Sequence[BasinRow]) -> str:
    most = max(float(np.nanmax(shares.high - shares.low)) for row in rows for shares in (row.along(), row.around()))
    within = f"Wilson's 95 % intervals, at most {100 * most:.0f} points wide"
    return f"; bands: {within}" if len(rows) <= BANDS else f"; {within}, are in the JSON file"


def _curve(label: str, shares: SuccessCounts, unit: float, band: bool) -> Curve:
    middles = unit * _middles(shares.edges[0])
    if not band:
        return Curve(label, middles, 100 * shares.share, marks=True)
    return Curve(label, middles, 100 * shares.share, 100 * shares.low, 100 * shares.high, marks=True)


def _map(row: BasinRow) -> Figure:
    shares = row.cells()
    body = charts.heat(
        100 * shares.share.T, Axis("offset of the guess [m]"), Axis("turn of the guess [deg]"),
        _tick_labels(_middles(shares.edges[0])), _tick_labels(np.degrees(_middles(shares.edges[1]))), SHARE,
        printed=lambda value: f"{value:.0f}",
    )  # fmt: skip
    return Figure(body, f"{row.backend}, {row.scene}", "Success in % of the guesses in each cell.")


def _plane(row: BasinRow) -> Figure:
    shares = row.plane()
    middles = _tick_labels(_middles(shares.edges[0]))
    body = charts.heat(
        100 * shares.share.T, Axis("offset in x [m]"), Axis("offset in y [m]"), middles, middles, SHARE,
        printed=lambda value: f"{value:.0f}",
    )  # fmt: skip
    return Figure(body, f"{row.backend}, {row.scene}", "All turns; hatched or grey: no trials.")


def _counts(row: BasinRow) -> Table:
    shares = row.cells()
    distances, turns = shares.edges[0], np.degrees(shares.edges[1])
    heads = [f"{low:.2g} to {high:.2g} m" for low, high in pairwise(distances)]
    rows: list[tuple[Cell | str, ...]] = [
        (f"{low:.3g} to {high:.3g} deg", *(_count(shares, column, number) for column in range(len(heads))))
        for number, (low, high) in enumerate(pairwise(turns))
    ]
    return Table(("turn", *(Column(head, number=True) for head in heads)), rows, f"{row.backend}, {row.scene}", False)


def _count(shares: SuccessCounts, *cell: int) -> Cell:
    if not shares.trials[cell]:
        return Cell("-")
    low, high = 100 * shares.low[cell], 100 * shares.high[cell]
    return Cell(f"{shares.successes[cell]}/{shares.trials[cell]} ({low:.0f} to {high:.0f} %)")


def _failures(rows: Sequence[BasinRow], scene: BasinScene) -> list[Block]:
    """The failures with the best guesses: the target, and the source moved by the guess and by the answer."""
    blocks: list[Block] = []
    for row in rows:
        worst = row.basin.worst(WORST) if row.basin is not None else ()
        if len(worst):
            figures = [_overlay(row, scene, int(attempt)) for attempt in worst]
            blocks += [Heading(_title(row)), Figures(figures, small=True)]
    return blocks or [Text("There are none.")]


def _overlay(row: BasinRow, scene: BasinScene, attempt: int) -> Figure:
    number = int(scene.trials.pair_numbers(len(scene.seen))[attempt])
    pair, guess, end = scene.seen[number], Pose.of(scene.guesses()[attempt]), find_answer(row, attempt)
    layers = [
        Points("target", _thin(pair.target.points), GREY, 3.0),
        Points("source, guess", _thin(guess.transform(pair.source.points)), START, 3.0),
    ]
    if end is not None:
        layers.append(Points("source, answer", _thin(end.transform(pair.source.points)), END, 3.0))
    metres, degrees = _apart(guess, pair.target_from_source)
    caption = f"Guess {metres:.2f} m and {degrees:.1f} deg off"
    if end is None:
        caption += ", no answer"
    else:
        metres, degrees = _apart(end, pair.target_from_source)
        caption += f"; answer {metres:.2f} m and {degrees:.1f} deg off"
    flag = ", reported as converged" if row.outcome.claimed[attempt] else ""
    body = charts.scatter(layers, Axis("x [m]"), Axis("y [m]"))
    return Figure(body, f"Trial {attempt}, pair {number}", f"{caption}{flag}.")


def _method(result: BasinResult, command: str) -> Section:
    trials = result.scenes[0].trials
    items = (
        *_pairs(result),
        f"The guess is the truth plus an offset: {trials.offsets} offsets, even in distance, bearing and turn (an "
        "additive low-discrepancy sequence from a seeded start), the same for all; a quarter is only shifted and "
        "a quarter only turned, for the curves.",
        "Unobservable directions result from the point-to-line Hessian of the scene, its turn scaled by "
        "the points' mean square distance: a direction is degenerate where twice the best possible standard deviation "
        "exceeds the tolerance. Guesses and answers are evaluated without them.",
        "A back end that raises has no answer to that guess; one that ends its process has none in its task.",
        "Back ends keep their own settings; the largest distance of a pair, chosen for tracking, decides the basin "
        "more than anything else.",
    )
    rows = [(name, str(value)) for each in result.methods for name, value in each.values.items()]
    owners = [each.label for each in result.methods for _ in each.values]
    table = Table(("Back end", "Setting", "Value"), [(owner, *row) for owner, row in zip(owners, rows, strict=True)])
    return Section("Method", (Bullets(items), Command(command), Fold("Settings of the back ends", (table,))), "how")


def _pairs(result: BasinResult) -> list[str]:
    """The origin of the pairs of scans."""
    items = []
    if simulated := [scene.trials for scene in result.scenes if not scene.trials.data]:
        items.append(
            f"A simulated scene gives {simulated[0].pairs} pairs of scans of {simulated[0].beams} beams with "
            f"{100 * simulated[0].noise_m:.3g} cm of noise on every range, from two nearby poses; the true "
            "motion is exact."
        )
    if recorded := [scene for scene in result.scenes if scene.trials.data]:
        counts = ", ".join(f"{len(scene.seen)} of {scene.trials.place}" for scene in recorded)
        items.append(
            f"A data set gives pairs of its scans, spread evenly ({counts}), as points of the robot's base with the "
            "scans deskewed: as near each other as in a simulated scene if its truth is a trajectory, within "
            f"{MAX_APART_M:g} m and {math.degrees(MAX_APART_RAD):.1f} deg if it is measured relations, whose times "
            "differ too much from those of the scans in a turn, and whose errors remain. "
            "Observability is computed from the walls of its scans, along the axes of the world, or of each first scan "
            "where only relations are known."
        )
    return items


def _apart(pose: Pose, truth: Pose) -> tuple[float, float]:
    left = truth.inverse() @ pose
    return math.hypot(left.x, left.y), abs(math.degrees(left.theta))


def _thin(points: Floats) -> Floats:
    return points[:: max(1, len(points) // MAX_POINTS)]


def _middles(edges: Floats) -> Floats:
    return np.asarray(0.5 * (edges[:-1] + edges[1:]))


def _tick_labels(values: Floats) -> list[float]:
    return [float(f"{value:.2g}") for value in values]


def _title(row: BasinRow) -> str:
    return f"{row.backend} {'on' if row.trials.data else 'in the'} {row.scene}"


def _anchor(row: BasinRow) -> str:
    return f"#{slug(_title(row))}" if row.basin is not None and row.basin.worst(1).size else ""


def _interval(share: Interval) -> str:
    return f"{100 * share.value:.0f} ({100 * share.low:.0f} to {100 * share.high:.0f})"


def _number(value: float, digits: int) -> Cell:
    return Cell(f"{value:.{digits}f}", sort=value) if math.isfinite(value) else Cell("none", sort=math.inf)
