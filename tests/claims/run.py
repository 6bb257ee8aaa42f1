"""Check every statement of a report against the runs in its results.json, with arithmetic of its own.

Every sentence must be of a known kind; its names and numbers are recomputed from the scores of the runs. So is every
cell of the page that shows a score. Prints what is false; the exit code is 1 if anything is.

    python tests/claims/run.py reports/build/default
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parent))

import answer_statements
import overview_statements  # noqa: F401 - registers its kinds
import verdict_statements  # noqa: F401 - registers its kinds
from cells import check_cells
from facts import Facts
from statements import IN_OVERVIEW, IN_VERDICTS, Check, check_sentences, same

TABLES = (IN_VERDICTS, IN_OVERVIEW, answer_statements.IN_ANSWER, answer_statements.IN_PILLS)


def check_report(content: Mapping[str, Any], page: str = "", seen: set[str] | None = None) -> Iterator[str]:
    """Yield what is false in a results.json and on its page; ``seen``: gets the names of the kinds that occurred."""
    facts = Facts(content)
    for verdict in content["verdicts"]:
        where = verdict["sequence"]
        yield from same(f"{where}: outcome", verdict["outcome"], facts.outcome(where))
    for kinds, text, place in read_statements(content):
        yield from check_sentences(facts, kinds, text, *place, seen=seen)
    table, answer = answer_statements.standings(facts), content["answer"]
    for one in content["answer"]["standings"]:
        yield from same(f"standing of {one['method']}", (one["led"], one["counted"]), table[one["method"]])
        error, cpu, shared = facts.relative(answer["counted"], one["method"], answer["compared_with"])
        stated = [round(value, 9) if value else value for value in (one["ratio"], one["cpu_ratio"], one["shared"])]
        true = [round(value, 9) if value else value for value in (error, cpu, shared)]
        yield from same(f"{one['method']} against {answer['compared_with']}", stated, true)
    if page:
        yield from check_cells(facts, page)


def read_statements(content: Mapping[str, Any]) -> Iterator[tuple[list[tuple[str, Check]], str, tuple[str, ...]]]:
    """Yield every statement with the kinds it may be of, and the sequence it is about."""
    for verdict in content["verdicts"]:
        for sentence in verdict["sentences"]:
            yield IN_VERDICTS, sentence, (verdict["sequence"],)
    for sentence in content["overview"]:
        yield IN_OVERVIEW, sentence, ()
    answer = content["answer"]
    yield answer_statements.IN_ANSWER, f"{answer['title']} {answer['subtitle']}", ()
    for pill in answer["pills"]:
        yield answer_statements.IN_PILLS, pill["text"], ()


def main() -> int:
    """Check the report of a results folder."""
    folder = Path(sys.argv[1])
    content = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    seen: set[str] = set()
    faults = list(check_report(content, (folder / "index.html").read_text(encoding="utf-8"), seen))
    print("\n".join([*faults, f"{len(faults)} faults, {len(seen)} kinds of sentences"]))
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
