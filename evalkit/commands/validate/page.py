"""The page of an acceptance report."""

from __future__ import annotations

import re
from collections.abc import Mapping

from evalkit.commands.validate.acceptance import DECIDING, AcceptanceLevel, AcceptanceReport, Check, CheckOutcome
from evalkit.commands.validate.charts import figures
from evalkit.commands.validate.first_screen import first_figures
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
    render,
)

TONES: Mapping[CheckOutcome, Tone] = {
    "passed": "good", "failed": "bad", "not shown": "warn", "waived": "warn", "not judged": "warn",
    "informative": "", "not applicable": "",
}  # fmt: skip

MAX_CHECKS = 20
"""Checks of a level that are shown at once; if there are more, those that passed are folded."""


def render_page(report: AcceptanceReport, command: str) -> str:
    """The HTML page; ``command``: the command line that writes it."""
    sections = [
        _verdict(report, command),
        *(_level(report, level) for level in report.levels if level.checks),
        _method(report),
    ]
    facts = [("Claim", f"{'equal to' if report.claim == 'equal' else 'as good as'} the reference")]
    facts += [("Reference", f"{report.reference}: {report.why_reference}"), ("Margin", report.margin_text or "none")]
    facts += [("Peers", ", ".join(report.peers) or "none")]
    facts = facts if report.reference else []
    if "on" in report.settings:
        facts.append(("On", "; ".join(report.settings["on"])))
    return render(Document("evalkit validate", _title(report), f"{report.verdict}.", sections, tuple(facts)))


def _title(report: AcceptanceReport) -> str:
    if not report.reference:
        return f"{report.subject} {'passes' if report.passed else 'does not pass'}"
    relation = "equivalent to" if report.claim == "equal" else "as good as"
    if report.passed:
        return f"{report.subject} is {relation} {report.reference}"
    negation = "not" if report.claim == "equal" else "not shown to be"
    return f"{report.subject} is {negation} {relation} {report.reference}"


def _verdict(report: AcceptanceReport, command: str) -> Section:
    rows: list[list[Cell | str]] = []
    ran = [level for level in report.levels if level.outcome(report.claim) != "not applicable"]
    for level in ran:
        outcome = level.outcome(report.claim)
        passed, failed = len(level.passed(report.claim)), len(level.failed(report.claim))
        first = level.decisive_checks(report.claim)[0] if level.checks else None
        rows.append(
            [
                Cell(f"{level.number} {level.name}", link=f"#{_anchor(level)}", sort=level.number),
                level.question,
                Cell(outcome, tone=TONES[outcome]),
                f"{passed} of {passed + failed}" if passed + failed else "none",
                "" if first is None else f"{first.on}: {first.observed}" if first.on else first.observed,
            ]
        )
    columns = (
        "level",
        "question",
        "outcome",
        Column("deciding checks", tip="passed, of all that decide"),
        Column("first result", tip="of the first check that refutes the claim, or else supports it"),
    )
    blocks: list[Block] = [Figures(row, small=True) for row in first_figures(report) if row]
    blocks.append(Table(columns, rows, sortable=False))
    blocks += [Text(f"Waived: {name}: {why}", "warn") for name, why in report.waivers.items()]
    blocks += [Text(f"Not available here: {name}: {why}", "warn") for name, why in report.unavailable.items()]
    blocks += [Text("The command that wrote this page:", "note"), Command(command)]
    return Section("Verdict", blocks)


def _level(report: AcceptanceReport, level: AcceptanceLevel) -> Section:
    columns = (
        "check",
        "on",
        "outcome",
        "observed",
        Column("margin", tip="the margin, and its origin"),
        Column("weight", tip="whether the verdict depends on this check"),
    )
    outcome = level.outcome(report.claim)
    many = len(level.checks) > MAX_CHECKS
    shown = [check for check in level.checks if not many or check.outcome != "passed" or check is level.checks[0]]
    folded = [check for check in level.checks if check not in shown]
    blocks: list[Block] = [
        Text(level.question),
        Table(columns, [_row(report, check) for check in shown], caption=f"Outcome: {outcome}"),
    ]
    if folded:
        blocks.append(Fold("Checks that passed", [Table(columns, [_row(report, check) for check in folded])]))
    if charts := figures(level, report.subject, report.reference, report.margin):
        blocks.append(Figures(charts))
    return Section(f"{level.number} {level.name}", blocks, _anchor(level))


def _row(report: AcceptanceReport, check: Check) -> list[Cell | str]:
    decides = check.decides(report.claim) and check.outcome in ("passed", "failed")
    tone: Tone = TONES[check.outcome] if decides else "warn" if check.outcome == "failed" else ""
    informs = check.deciding in ("never", "always")
    weight = "decides" if decides else "informs" if informs else f'decides the claim "{check.deciding}"'
    observed = f"{check.observed}; {check.detail}" if check.detail else check.observed
    return [
        check.name, check.on or "all", Cell(check.outcome, tone=tone), observed, check.margin or "-",
        Cell(weight, tip=DECIDING[check.deciding]),
    ]  # fmt: skip


def _method(report: AcceptanceReport) -> Section:
    binaries = [(f"file {name}", what) for name, what in report.binaries.items()]
    facts = [*report.environment.items(), *binaries, *_settings(report)]
    fold = Fold("Environment and settings", [Table(("name", "value"), facts, sortable=False)])
    if not report.reference or "effort" not in report.settings:
        return Section("Method", [fold])
    effort, share = report.settings["effort"], report.settings["noise_share"]
    items = [
        f"The reference is {report.reference} ({report.why_reference}); --reference names another one. Settings given "
        "with --set apply to the reference too if it has a parameter of that name.",
        "The reference decides. Peers are other methods: the distance to their answers is shown and decides nothing.",
        "Equal: the same question has the same answer within the margin. In double precision the margin is 1e-9 m: "
        "a million times the rounding error, and a millionth of the sensor's noise.",
        "If only rounding separates the two, the margin is the computed effect of rounding to single precision on each "
        "set of questions; the formula is shown with the check. A tie between two equally near points, which single "
        "precision may break differently, is counted separately; whole runs show its effect.",
        f"As good: the interval of the difference lies below the margin, one-sided at 5 %. The margin is {share:g} of "
        "the noise level: an error half the size of another increases it by an eighth.",
        f"Rules and the drawn questions of level 1 (sizes, scales, headings, points, limits, edges, parameters) come "
        f"from --seed {report.settings.get('seed')}, which repeats them. Level 1 also uses {effort['pairs']} pairs of "
        "scans per sequence and seed, each with a guess 5 cm and 2 degrees off and with one 0.3 m and 0.15 rad off. "
        "Level 2 repeats the questions to the reference at each of "
        f"{effort['scans']} scans. Times are measured in one process, methods in turns, over {effort['timed']} scans.",
        "Every run and every set of questions has its own process: a crash, a hang or a leak of the implementation is "
        "a failed check.",
    ]
    return Section("Method", [Bullets(items), fold])


def _settings(report: AcceptanceReport) -> list[tuple[str, str]]:
    """Every setting by name; those of a plug-in with its role."""
    rows: list[tuple[str, str]] = []
    for name, value in report.settings.items():
        if isinstance(value, Mapping):
            rows += [(f"{name}: {key}", str(one)) for key, one in value.items()]
        else:
            rows.append((name, str(value)))
    return rows


def _anchor(level: AcceptanceLevel) -> str:
    return re.sub(r"[^a-z0-9]+", "-", f"level-{level.number}-{level.name}")
