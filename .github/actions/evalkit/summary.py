"""Print the JSON of ``evalkit validate`` as Markdown for the summary of a job: the verdict and the levels."""

import json
import sys
from pathlib import Path
from typing import Any

from evalkit.report.formatting import escape_markdown


def summarise(report: dict[str, Any]) -> str:
    """Return the Markdown of a validation; of decisive checks that did not pass, what was observed."""
    lines = [f"## evalkit: {_escape(report['subject'])}", "", _escape(report["verdict"]), ""]
    lines += ["| level | outcome | decisive checks passed |", "|---|---|---|"]
    missed = []
    for level in report["levels"]:
        checks = [check for check in level["checks"] if check["decides"] and check["outcome"] != "not applicable"]
        passed = sum(check["outcome"] == "passed" for check in checks)
        missed += [check for check in checks if check["outcome"] in ("failed", "not shown")]
        outcome = f"**{level['outcome']}**" if level["outcome"] == "failed" else level["outcome"]
        lines.append(f"| {level['name']} | {outcome} | {passed} of {len(checks)} |")
    lines.append("")
    lines += [
        f"* {check['outcome']}: {_escape(' '.join((check['name'], check['on'], check['observed'])))}"
        for check in missed
    ]
    return "\n".join(lines) + "\n"


def _escape(text: str) -> str:
    return escape_markdown(" ".join(text.split()))


if __name__ == "__main__":
    sys.stdout.write(summarise(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))))
