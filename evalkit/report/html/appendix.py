"""The appendix of a report: how to read it, tests over all runs, metrics, methods, data, provenance."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from evalkit.metrics.metric import Metric
from evalkit.metrics.validated import load_validation
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.comparison import Comparison, MethodCard
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.significance import SIGNIFICANCE_LEVEL
from evalkit.report.formatting import capitalise
from evalkit.report.html import appendix_tables, report_tables
from evalkit.report.html.blocks import (
    Block,
    Bullets,
    Card,
    Cards,
    Chips,
    Command,
    Facts,
    Fold,
    Heading,
    Html,
    Section,
    Table,
    Text,
)
from evalkit.report.html.method_colours import Strokes
from evalkit.results.run_record import RunRecord
from evalkit.stats.ranks import NotTested
from evalkit.stats.runs import MIN_RUNS

HOW = (
    f"Each number is the median over the complete runs. From {MIN_RUNS} runs on, the 95 % interval below it is that of "
    "Student's t over the runs: it holds the median over all possible runs. Two runs, and the perturbed runs of a "
    "recording, show the lowest and the highest value. A single run has an interval from stretches of up to 10 s of "
    "it, which describes this run only; a metric without one value per scan then has none.",
    "Green: clearly better than every other method that completed every run and held the track. Shaded: close to the "
    "best value and not clearly different from it: the interval of the paired difference over runs contains zero, or "
    "the difference is below 5 % (for positions: or 2 mm), or below the accuracy of the ground truth. Where maps "
    "decide, it is also not clearly worse in any other map metric. Single runs give no verdict. A method that lost "
    "the track in any run, kept the initial guess on more than half of the scans, or whose settings were chosen on a "
    "data set, is not ranked there.",
    "Point at a dash to see the reason. The name of a method and each number lead to its runs, with their commands. "
    "Click a heading to sort.",
)
PAIRS = (
    "The difference on the same scans (or run by run) with its interval; above zero is worse. If the interval "
    "contains zero, no difference is shown. “Detectable” is the difference, in the direction found, that these runs "
    "detect in four cases of five; a smaller one may exist. Every row is a separate test: of twenty rows without a "
    "true difference, one may show a difference."
)
TESTS = (
    "This table predicts a further sequence of the same kind and needs more runs than the verdicts, which describe "
    "these sequences. One pair per sequence and seed. Ratio: median of the error divided by the reference's; below 1 "
    "is better. Larger: probability that a run's error exceeds that of a run of the reference on the same sequence "
    "(A12 of Vargha and Delaney, its mean over the sequences weighted by their pairs; 50 % is no difference). p: "
    "Wilcoxon's signed-rank test, adjusted for all rows by Holm. Detectable: the ratio that so many runs detect in "
    "four cases of five, whatever the other rows show; “none” if they cannot. Seeds of one sequence are similar, and "
    "the best-ranked method is chosen from the same runs, so p is too small rather than too large. “No difference "
    "shown” means that there is no difference, or too few runs to show one."
)
FILES = Markup(
    '<p class="note">The same numbers in other formats: <a href="results.json">results.json</a> (<a '
    'href="results.schema.json">schema</a>), <a href="runs.csv">runs.csv</a>, <a href="scores.csv">scores.csv</a>, <a '
    'href="summary.csv">summary.csv</a>.</p>'
)
QUANTILES = (
    "A50, A75 and A95: the error (in the deciding metric of each sequence) that 50, 75 and 95 % of a method's runs "
    "do not exceed. Compare them only between methods with the same runs: the column beside them states how many, and "
    "on how many sequences."
)


def build_appendix(analysis: Analysis, strokes: Strokes) -> tuple[Section, ...]:
    """Return the sections of the appendix."""
    return (
        Section("How to read the numbers", [Bullets(HOW)], "reading"),
        Section("Tests over all runs", _build_tests(analysis, strokes), "evidence"),
        Section("Metrics", _build_metrics(analysis.comparison.metrics), "metrics"),
        Section("Methods", _build_methods(analysis.comparison, strokes), "methods"),
        Section("Data", _build_data(analysis.sequences), "data"),
        Section("Provenance", _build_provenance(analysis, strokes), "provenance"),
    )


def count_notes(records: Sequence[RunRecord]) -> dict[str, int]:
    """Return the defects counted while reading a sequence: the highest count over its runs."""
    counts: dict[str, int] = {}
    for record in records:
        for name, count in record.result.notes.items():
            counts[name] = max(counts.get(name, 0), int(count))
    return {name: count for name, count in counts.items() if count}


def _build_tests(analysis: Analysis, strokes: Strokes) -> list[Block]:
    found = analysis.significance
    over = f"Errors over {', '.join(found.sequences)}, with ground truth and a geometry that determines the pose. "
    text = over if found.sequences else ""
    text += "A failed run counts as the worst. A method is left out on data that its settings were chosen on. "
    if isinstance(found.ranks, NotTested):
        text += f"Ranks are not tested: {found.ranks.reason}."
    else:
        differ = "differ significantly" if found.ranks.p <= SIGNIFICANCE_LEVEL else "do not differ significantly"
        text += (
            f"Ranks over {found.ranks.data_sets} data sets {differ}, with p = {found.ranks.p:.2g} "
            f"(Friedman); two methods differ if their mean ranks are at least {found.ranks.critical_difference:.2f} "
            "apart (critical difference, Nemenyi)."
        )
    blocks: list[Block] = [Text(text), appendix_tables.records_table(analysis, strokes), Text(QUANTILES, "note")]
    if found.comparisons:
        title = "Paired tests over all runs, against the methods of the title, the best-ranked and the reference method"
        table = appendix_tables.comparisons_table(analysis, strokes)
        blocks.append(Fold(title, [Text(TESTS, "note"), table], "over-all-runs"))
    return blocks


def _build_metrics(metrics: Sequence[Metric]) -> list[Block]:
    blocks: list[Block] = [
        Text("Definitions, because the same names mean different things in the literature. Map metrics without a "
             "reference are comparable only for the same log, mapper and resolution.", "note")
    ]  # fmt: skip
    groups: dict[str, list[Metric]] = {}
    for metric in metrics:
        groups.setdefault(metric.group, []).append(metric)
    for number, (group, members) in enumerate(groups.items(), start=1):
        blocks.append(Heading(capitalise(group), f"group-{number}"))
        if group == "map consistency":
            found = load_validation()
            text = (
                f"Spearman's rank correlation of each metric with the true error, over {found.map_count} maps from "
                f"perturbed trajectories ({', '.join(found.worlds)}; {found.mapper}): 1 same order, 0 no relation, "
                f"below 0 reverse order. Measured {found.created} with:"
            )
            blocks += [Heading("Rank agreement", "rank-agreement", 4), Text(text, "note")]
            blocks += [Command(found.command), appendix_tables.agreement_table(found, members)]
        headline = [_metric_card(metric) for metric in members if metric.headline]
        others = [_metric_card(metric) for metric in members if not metric.headline]
        blocks += [Cards(headline)] if headline else []
        count = f"{len(others)} {'more' if headline else 'metrics'}"
        blocks += [Fold(count, [Cards(others)], f"metrics-more-{number}")] if others else []
    return blocks


def _metric_card(metric: Metric) -> Card:
    unit = f" [{metric.unit}]" if metric.unit else ""
    better = f", {metric.better} is better" if metric.better else ""
    facts = [("Limitations", metric.limitations), ("Source", metric.source), ("Key", metric.name)]
    facts[1:1] = [("Support", metric.support)] if metric.support else []
    title = f"{capitalise(metric.label)}{unit}{better}"
    return Card(title, [Text(metric.definition), Facts(facts)], f"metric-{metric.name}")


def _build_methods(comparison: Comparison, strokes: Strokes) -> list[Block]:
    cards = [
        _method_card(label, card, place, strokes) for place, (label, card) in enumerate(comparison.methods.items(), 1)
    ]  # fmt: skip
    fair: list[Block] = [Bullets(comparison.fairness)] if comparison.fairness else []
    return [*fair, Cards(cards, wide=True, level=3)]


def _method_card(label: str, card: MethodCard, place: int, strokes: Strokes) -> Card:
    facts = [("Initial guess", card.guess)] if card.guess else []
    chosen = f"{', '.join(card.tuned_on)} (documentation: How each method was tuned, on what)"
    facts += [("Settings chosen on", chosen)] if card.tuned_on else []
    facts += [("Licence", card.licence), ("Source", card.citation)]
    blocks: list[Block] = [Text(card.summary)]
    blocks += [Text(card.missing, "warn")] if card.missing else []
    blocks += [Facts(facts), *appendix_tables.settings_fold(card.settings, f"settings-{place}")]
    chips = report_tables.CHIPS.get(card.role, ())
    return Card(label, blocks, f"method-{place}", strokes.get(label), chips)


def _build_data(sequences: Sequence[SequenceAnalysis]) -> list[Block]:
    cards = []
    for number, sequence in enumerate(sequences, start=1):
        card = sequence.card
        facts = (*sequence.drive, ("Sensor", card.sensor), ("Ground truth", card.truth), ("Licence", card.licence),
                 ("Source", card.citation))  # fmt: skip
        blocks: list[Block] = [Text(card.summary), Facts(facts)]
        blocks += [Text("Known defects", "note"), Bullets(card.defects)] if card.defects else []
        if notes := count_notes(sequence.all_runs):
            listed = ", ".join(f"{count} {name}" for name, count in notes.items())
            blocks.append(Text(f"Counted while reading: {listed}", "note"))
        blocks += appendix_tables.settings_fold(card.settings, f"sequence-{number}-settings")
        chips: Chips = (("degenerate geometry", "warn"),) if card.degenerate else ()
        cards.append(Card(sequence.label, blocks, chips=chips))
    return [Cards(cards, wide=True, level=3)]


def _build_provenance(analysis: Analysis, strokes: Strokes) -> list[Block]:
    comparison = analysis.comparison
    when = f"Started {comparison.started:%Y-%m-%d %H:%M:%S}, finished {comparison.finished:%Y-%m-%d %H:%M:%S}."
    runs = [
        appendix_tables.runs_fold(analysis, one, number, strokes) for number, one in enumerate(analysis.sequences, 1)
    ]
    mapper: list[Block] = [Text(f"The mapper of all maps: {comparison.mapper}", "note")] if comparison.mapper else []
    return [
        Command(comparison.command),
        Text(when, "note"),
        Html(FILES),
        *mapper,
        Table(("Machine and software", "Value"), list(comparison.environment.items()), sortable=False),
        Heading("Runs and the commands that reproduce them", "runs"),
        *runs,
    ]  # fmt: skip
