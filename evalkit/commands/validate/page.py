"""The page of a dossier, and its JSON form."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping

from evalkit.commands.validate.acceptance import Dossier, Level, Line, Outcome
from evalkit.commands.validate.answers import GROUNDS
from evalkit.commands.validate.charts import figures
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

TONES: Mapping[Outcome, Tone] = {"passed": "good", "failed": "bad", "told": "", "not applicable": ""}


def json_text(found: Dossier) -> str:
    """The JSON form (``evalkit/commands/validate/acceptance.schema.json``)."""
    return json.dumps(found.as_json(), indent=1) + "\n"


def html(found: Dossier, command: str) -> str:
    """The whole page; ``command`` makes it again."""
    sections = [_verdict(found, command), *(_level(found, level) for level in found.levels), _method(found)]
    title = {
        ("equal", True): f"{found.backend} is equivalent to {found.twin}",
        ("equal", False): f"{found.backend} is not equivalent to {found.twin}",
        ("as-good", True): f"{found.backend} is as good as {found.twin}",
        ("as-good", False): f"{found.backend} is not shown to be as good as {found.twin}",
    }[found.claim, found.passed]
    facts = (
        ("Claim", "equal to the twin" if found.claim == "equal" else "as good as the twin"),
        ("Twin", f"{found.twin}: {found.why_twin}"),
        ("Margin", found.within or "not reached"),
        ("Beside it", ", ".join(found.against) or "nobody"),
        ("On", "; ".join(found.settings["on"])),
    )
    return render(Document("evalkit validate", title, f"{found.verdict}.", sections, facts))


def _verdict(found: Dossier, command: str) -> Section:
    rows: list[list[Cell | str]] = []
    for level in found.levels:
        outcome = level.outcome(found.claim)
        deciding = [line for line in level.lines if line.decides(found.claim) and line.outcome in ("passed", "failed")]
        passed = sum(line.outcome == "passed" for line in deciding)
        told = f"{passed} of {len(deciding)}" if deciding else "none"
        rows.append(
            [
                Cell(f"{level.number} {level.name}", link=f"#{_anchor(level)}", sort=level.number),
                level.question,
                Cell(outcome, tone=TONES[outcome]),
                told,
                _short(found, level),
            ]
        )
    columns = ("level", "question", "outcome", Column("lines that decide", tip="passed, of all that decide"), "found")
    blocks: list[Block] = [Table(columns, rows, sortable=False)]
    blocks += [Text(f"Not asked: {name}: {why}", "warn") for name, why in found.absent.items()]
    blocks += [Text("This page was made by:", "note"), Command(command)]
    return Section("Verdict", blocks)


def _short(found: Dossier, level: Level) -> str:
    """The line that says most: the first that refutes, else the first that decides, else the first."""
    lines = [line for line in level.lines if line.outcome != "not applicable"]
    deciding = [line for line in lines if line.decides(found.claim) and line.outcome == "passed"]
    deciding.sort(key=lambda line: line.ground != found.claim)
    shown = (level.failed(found.claim) or deciding or lines or list(level.lines))[:1]
    return "".join(f"{line.on}: {line.observed}" if line.on else line.observed for line in shown)


def _level(found: Dossier, level: Level) -> Section:
    columns = (
        "line",
        "on",
        "outcome",
        "found",
        Column("held against", tip="the margin, and where it comes from"),
        Column("counts", tip="whether the verdict hangs on it"),
    )
    outcome = level.outcome(found.claim)
    blocks: list[Block] = [
        Text(level.question),
        Table(columns, [_row(found, line) for line in level.lines], caption=f"Outcome: {outcome}"),
    ]
    drawn = figures(level, found.backend, found.twin, found.margin)
    if drawn:
        blocks.append(Figures(drawn))
    if verdicts := level.shown.get("verdicts"):
        rules = [
            [one["rule"], one["sentence"], Cell(one["outcome"], tone=TONES[one["outcome"]]), one["observed"]]
            for one in verdicts
        ]
        blocks.append(Fold("All rules", [Table(("rule", "it says", "outcome", "seen"), rows=rules)]))
    return Section(f"{level.number} {level.name}", blocks, _anchor(level))


def _row(found: Dossier, line: Line) -> list[Cell | str]:
    decides = line.decides(found.claim) and line.outcome in ("passed", "failed")
    tone: Tone = TONES[line.outcome] if decides else "warn" if line.outcome == "failed" else ""
    counts = "decides" if decides else "informs" if line.ground in ("", "always") else f"if {line.ground} is claimed"
    told = f"{line.observed}; {line.detail}" if line.detail else line.observed
    return [
        line.name, line.on or "all", Cell(line.outcome, tone=tone), told, line.margin or "-",
        Cell(counts, tip=GROUNDS[line.ground]),
    ]  # fmt: skip


def _method(found: Dossier) -> Section:
    asked, share = found.settings["effort"], found.settings["share"]
    items = [
        f"The twin is {found.twin} ({found.why_twin}); --twin names another. What is given with --set goes to the twin "
        "too where it has a parameter of that name.",
        "The twin decides. References are other methods: how far their answers lie is told, and refutes nothing.",
        "Equal means: asked the same question, the same answer within the margin. In double precision that is 1e-9 m: "
        "a million times what rounding leaves, and a millionth of what noise does.",
        "Where nothing but rounding parts the two, the margin is what rounding to single precision may do, computed "
        "for every set of questions; the formula stands beside the line. A tie between two equally near points, which "
        "single precision may break otherwise, is counted apart; whole runs show what it leads to.",
        f"As good means: the interval of the difference lies below the margin, one-sided at 5 %. The margin is "
        f"{share:g} of what noise alone leaves open: an error half the size of another adds an eighth to it.",
        f"Level 1 asks {asked['pairs']} pairs of scans a sequence and seed, each with a guess 5 cm and 2 degrees off "
        f"and with one 0.3 m and 0.15 rad off. Level 2 asks at each of {asked['scans']} scans what the twin was asked. "
        f"Times are taken in one process, methods in turns, over {asked['timed']} scans.",
        "Every run and every set of questions has a process of its own: a crash, a hang or a leak of the "
        "implementation is a line here.",
    ]
    settings = [(f"{whose}: {name}", str(value)) for whose in ("backend", "twin")
                for name, value in found.settings[whose].items()]  # fmt: skip
    facts = [*found.environment.items(), *settings]
    table = Table(("where", "what"), facts, sortable=False)
    blocks: list[Block] = [Bullets(items), Fold("Where it ran, and every setting", [table])]
    return Section("How it was judged", blocks)


def _anchor(level: Level) -> str:
    return re.sub(r"[^a-z0-9]+", "-", f"level-{level.number}-{level.name}")
