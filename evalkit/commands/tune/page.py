"""The page of a tuning: gains, held-out comparison, error against CPU time, budgets, spaces and points."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence

from evalkit.commands.tune import charts
from evalkit.commands.tune.objective import mark_pareto_front
from evalkit.commands.tune.plan import TUNED
from evalkit.commands.tune.result import TuningResult
from evalkit.commands.tune.rows import build_held_out_blocks, format_number
from evalkit.commands.tune.search_loop import MethodSearch
from evalkit.commands.tune.space import get_parameter_name, is_continuous
from evalkit.report.formatting import format_amount
from evalkit.report.html.blocks import (
    Block,
    Bullets,
    Cell,
    Column,
    Command,
    Document,
    Figures,
    Fold,
    Section,
    Table,
    Text,
    Tone,
    slug,
)


def build_document(result: TuningResult) -> Document:
    """The whole page."""
    tuning = result.tuning
    lost = tuning.objective
    facts = (
        ("Budget", f"{tuning.points} points for every back end, the default among them"),
        ("A point", f"{len(tuning.search_runs)} training runs"),
        ("Objective", f"geometric mean of {lost.metric.label}; lost runs first"),
        ("CPU time", f"{sum(one.cpu_s for one in result.searches) / 60.0:.1f} min of search"),
    )
    sections = (
        _build_summary(result),
        Section("Held out", build_held_out_blocks(result), "held-out"),
        _build_fronts(result),
        Section("Budget", _build_budget(result), "budget"),
        Section("Search space", _build_spaces(result), "space"),
        Section("Points", [_build_points(result, one) for one in result.searched], "points"),
        _build_method(result),
    )
    return Document("evalkit tune", tuning.title, tuning.description, sections, facts)


def _build_summary(result: TuningResult) -> Section:
    columns = (
        Column("Back end"),
        Column("Chosen parameters", tip="own parameters that differ from the default"),
        Column("Search", number=True, tip="geometric mean error: default → best point"),
        Column("Fresh seeds", "x", number=True, tip="error of best point / default, with 95 % interval over the runs"),
        Column("Held out", "x", number=True, tip="error of tuned / default, median over all held-out runs"),
        Column("CPU per scan", "ms", number=True, tip="median in training: default → chosen"),
        Column("Verdict"),
    )
    blocks: list[Block] = [
        Bullets([f"{result.sentence(one)}." for one in result.searched]),
        Table(columns, [_make_summary_row(result, one) for one in result.searched]),
        Text(
            "The search overestimates its best point, because the same runs select and score it. Therefore the best "
            "point and the default run again on fresh seeds of the training worlds. The best point replaces the "
            "default only if it loses no more runs, is at least 5 % better and the whole interval is below 1. The "
            "chosen point is then compared with the default on held-out sequences.",
            "note",
        ),
    ]
    if absent := [(each.label, each.missing) for each in result.tuning.methods if each.missing]:
        blocks.append(Table(("Not available here", "Why"), absent))
    return Section("Summary", blocks, "summary")


def _make_summary_row(result: TuningResult, one: MethodSearch) -> Sequence[Cell | str]:
    label, metric = one.tunable.label, result.tuning.objective.metric
    if one.failed:
        why = next(iter(filter(None, one.default.lost)), "")
        nothing = [Cell("-", sort=math.inf)] * 4
        return (label, "default", *nothing, Cell(result.verdict(one), tone="bad", tip=why))
    held = result.held_out_verdicts.get(label)
    paired = held.paired if held is not None else None
    ratio = None if paired is None else paired.ratio
    tone: Tone = (
        "bad" if held is not None and held.overfitted else "good" if paired and paired.verdict == "better" else ""
    )
    return (
        Cell(label, link=f"#{slug(f'points of {label}')}"),
        _describe_changes(one),
        Cell(" → ".join(format_amount(metric, each.error) for each in (one.default, one.best)), sort=one.best.error),
        _make_ratio_cell(one),
        Cell("-", sort=1.0) if ratio is None else Cell(f"{ratio:.2f}", sort=ratio),
        Cell(f"{one.default.cpu_ms:.2f} → {one.chosen.cpu_ms:.2f}", sort=one.chosen.cpu_ms),
        Cell(result.verdict(one), tone=tone),
    )  # fmt: skip


def _make_ratio_cell(one: MethodSearch) -> Cell:
    """The error ratio of best point and default on fresh seeds."""
    ratio = one.ratio
    if ratio is None:
        return Cell("-", sort=1.0, tip=one.why)
    return Cell(f"{ratio.value:.2f} ({ratio.low:.2f} to {ratio.high:.2f})", ratio.value, tip=f"{ratio.support} runs")


def _describe_changes(one: MethodSearch) -> str:
    values, default = one.chosen.candidate.values, one.default.candidate.values
    changed = [
        f"{name} {_format_value(default[name])} → {_format_value(values[name])}"
        for name in values
        if values[name] != default[name]
    ]
    return ", ".join(changed) or "default"


def _build_fronts(result: TuningResult) -> Section:
    searches = [one for one in result.searched if not one.failed]
    if not searches:
        return Section("Accuracy against compute", [Text("No point has a value.")], "pareto-front")
    return Section(
        "Accuracy against compute",
        (
            charts.draw_pareto_fronts(searches, result.tuning.objective),
            Figures([charts.draw_points(one, result.tuning.objective) for one in searches]),
            Text(
                "All tried points in training: median over runs of the median CPU time per scan, and geometric mean "
                "error with lost runs at their bound. CPU times are measured beside other runs and without a warm-up: "
                "read them as ratios.",
                "note",
            ),
        ),
        "pareto-front",
    )


def _build_budget(result: TuningResult) -> list[Block]:
    columns = (
        Column("Back end"),
        Column("Points", number=True),
        Column("Search runs", number=True),
        Column("Fresh runs", number=True, tip="default and best point on fresh seeds"),
        Column("Lost runs", number=True, tip="failed, or at or beyond the bound; their error is the bound"),
        Column("CPU time", "s", number=True, tip="of all runs"),
        Column("Remark"),
    )
    return [Table(columns, [_make_budget_row(result, one) for one in result.searches]), *_build_sequences(result)]


def _make_budget_row(result: TuningResult, one: MethodSearch) -> Sequence[Cell | str]:
    fresh = one.confirmed or ()
    points, size = len(one.tried), one.tunable.space.size
    remark = ""
    if not one.tunable.space.factors:
        remark = "nothing to search"
    elif points < result.tuning.points:
        remark = f"all {size} combinations were tried" if size else "no other point was found"
    lost = sum(each.losses for each in (*one.tried, *fresh))
    return (
        one.tunable.label,
        _make_count_cell(points),
        _make_count_cell(sum(len(each.errors) for each in one.tried)),
        _make_count_cell(sum(len(each.errors) for each in fresh)),
        Cell(str(lost), sort=lost, tone="warn" if lost else ""),
        Cell(f"{one.cpu_s:.1f}", sort=one.cpu_s),
        remark,
    )


def _build_sequences(result: TuningResult) -> list[Block]:
    rows: list[Sequence[Cell | str]] = [
        (kind, one.sequence.label, _format_seeds(seeds), "")
        for one in result.tuning.training
        for kind, seeds in (("search", one.sequence.seeds), ("fresh seeds", one.confirm))
        if seeds
    ]
    trained = {one.sequence.dataset for one in result.tuning.training}
    for sequence in result.tuning.held_out:
        again = sequence.dataset in trained and sequence.seeds != (None,)
        known = "same world, other seeds" if again else "not in training"
        rows.append(("held out", sequence.label, _format_seeds(sequence.seeds), known))
    return [
        Table(
            ("Used for", "Sequence", "Seeds", ""),
            rows,
            "No world with the same seed and no recording is used for both training and held-out runs",
            False,
        )
    ]


def _build_spaces(result: TuningResult) -> list[Block]:
    columns = ("Back end", "Parameter", Column("Searched"), "Scale", Column("Default"), Column("Chosen"))
    rows: list[Sequence[Cell | str]] = []
    for one in result.searched:
        for factor in one.tunable.space.factors:
            name = get_parameter_name(factor)
            listed = [level.label if level.number is None else f"{level.number:g}" for level in factor.levels]
            searched = f"{listed[0]} to {listed[-1]} {factor.unit}" if is_continuous(factor) else ", ".join(listed)
            chosen = one.chosen.candidate.values[name]
            rows.append((one.tunable.label, name, searched, factor.scale if factor.numbers else "-",
                         _format_value(one.default.candidate.values[name]), _format_value(chosen)))  # fmt: skip
    left = [
        (one.tunable.label, name, why) for one in result.searched for name, why in one.tunable.excluded.items()
    ]  # fmt: skip
    blocks: list[Block] = [Table(columns, rows)]
    if left:
        blocks.append(Fold("Own parameters that were not searched", (Table(("Back end", "Parameter", "Why"), left),)))
    return blocks


def _build_points(result: TuningResult, one: MethodSearch) -> Block:
    names = [get_parameter_name(factor) for factor in one.tunable.space.factors]
    columns: tuple[Column | str, ...] = (
        Column("#", number=True), "found by", *names,
        Column("error", result.tuning.objective.metric.unit, number=True),
        Column("lost runs", number=True), Column("CPU", "ms", number=True), "",
    )  # fmt: skip
    marks = mark_pareto_front(one.tried).tolist()
    rows: list[Sequence[Cell | str]] = []
    for position, (each, on) in enumerate(zip(one.tried, marks, strict=True)):
        remarks = ["best"] * (each is one.best) + ["chosen"] * (each is one.chosen) + ["Pareto front"] * on
        values = [_make_value_cell(each.candidate.values[name]) for name in names]
        why = next(iter(filter(None, each.lost)), "")
        rows.append((
            _make_count_cell(position), each.candidate.found, *values, Cell(format_number(each.error), sort=each.error),
            Cell(str(each.losses), sort=each.losses, tone="warn" if each.losses else "", tip=why),
            Cell("-" if math.isnan(each.cpu_ms) else f"{each.cpu_ms:.2f}", sort=each.cpu_ms), ", ".join(remarks),
        ))  # fmt: skip
    return Fold(f"Points of {one.tunable.label}", (Table(columns, rows),))


def _build_method(result: TuningResult) -> Section:
    tuning = result.tuning
    bound = f"{tuning.objective.lost:g} {tuning.objective.metric.unit}".rstrip()
    items = (
        f"Point 0 is the default. Half of the {tuning.points} points are spread evenly (scrambled Sobol, seed "
        f"{tuning.seed}). The other half are steps from the best point so far that change fewer and fewer parameters "
        "at once (dynamically dimensioned search, Tolson and Shoemaker 2007). No point is tried twice.",
        f"A training run is lost if it fails, takes more than {tuning.run_cpu_s:g} s of CPU time or has an error of "
        f"{bound} or more; its error is then {bound}. Points with fewer lost runs are better, whatever the errors; "
        "then those with the smaller geometric mean; the earliest of equal points wins, so the default wins a tie.",
        "The search covers the back end's own parameters. The front end's parameters (guess, keyframes, local map, "
        "deskewing), the mapper, the scans and the metrics are the same for all.",
        f"On held-out sequences, labels of tuned methods end in '{TUNED.strip()}'. Every run has its own process and "
        "is scored as in any report. Wilcoxon's test over runs is adjusted over back ends (Holm); seeds of one world "
        "are not independent, so p is somewhat too small. Paired differences on one sequence have intervals of "
        "Student's t over the runs that are not adjusted for the number of sequences: one of twenty may differ by "
        "chance. Overfitted: significantly worse than the default over all runs or on one sequence, or fewer "
        "completed runs.",
    )
    alone = shlex.split(result.report)[2]
    machine = Fold("This machine", (Table(("What", "Value"), list(result.ran_on.items())),))
    full = Text(f"The full comparison of default and tuned methods, from {alone}:")
    return Section("How", (Bullets(items), Command(tuning.command), full, Command(result.report), machine), "how")


def _format_seeds(seeds: Sequence[int | None]) -> str:
    return ", ".join("recording" if seed is None else str(seed) for seed in seeds)


def _make_count_cell(value: int) -> Cell:
    return Cell(f"{value:,}", sort=value)


def _make_value_cell(value: object) -> Cell:
    numeric = isinstance(value, (int, float)) and not isinstance(value, bool)
    return Cell(_format_value(value), sort=float(value) if numeric else None)  # type: ignore[arg-type]  # checked by numeric


def _format_value(value: object) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    return f"{value:g}" if isinstance(value, float) else str(value)
