"""What the site consists of beside its written pages: generated pages, pages that stand elsewhere, blocks of others."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

from evalkit_docs import command_reference, metric_reference, plugin_reference

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "pages"

GENERATED: Mapping[str, Callable[[], str]] = {
    "reference/metrics.md": metric_reference.metrics,
    "reference/commands.md": command_reference.commands,
    "reference/back-ends.md": plugin_reference.back_ends,
    "reference/data-sets.md": plugin_reference.data_sets,
}
"""Pages written from the program itself."""

ELSEWHERE: Mapping[str, str] = {
    "external/protocol.md": "evalkit/external/PROTOCOL.md",
    "external/examples.md": "evalkit/external/examples/README.md",
    "changes.md": "CHANGELOG.md",
}
"""Pages of the site that are files of the repository, as they stand."""

BLOCK = re.compile(
    r"^<!-- block: (?P<file>\S+) (?P<language>\w+) (?P<index>\d+)(?: as (?P<title>\S+))? -->$", re.MULTILINE
)
LINK = re.compile(r"\[(?P<text>[^][]+)\]\((?P<target>[^)#:\s]+)(?P<anchor>#[^)\s]*)?\)")


def added() -> dict[str, str]:
    """The pages that are not in the folder of pages."""
    made = {name: write() for name, write in GENERATED.items()}
    return made | {name: _taken(name, file) for name, file in ELSEWHERE.items()}


def expanded(content: str) -> str:
    """A page with the code blocks it takes from other files: ``<!-- block: FILE LANGUAGE INDEX as TITLE -->``.

    LookupError where a file has no such block.
    """
    return BLOCK.sub(_block, content)


def _block(found: re.Match[str]) -> str:
    language, title = found["language"], found["title"]
    source = (ROOT / found["file"]).read_text(encoding="utf-8")
    blocks: list[str] = re.findall(rf"^```{language}\n(.*?)^```$", source, re.DOTALL | re.MULTILINE)
    if int(found["index"]) >= len(blocks):
        raise LookupError(f"{found['file']}: {len(blocks)} blocks of {language}, asked for number {found['index']}")
    head = f'{language} title="{title}"' if title else language
    return f"```{head}\n{blocks[int(found['index'])]}```"


def _taken(name: str, file: str) -> str:
    """A file as a page: links to files that are pages lead there, the others are told by name."""
    content = (ROOT / file).read_text(encoding="utf-8")
    return LINK.sub(lambda found: _linked(found, name, (ROOT / file).parent), content)


def _linked(found: re.Match[str], name: str, folder: Path) -> str:
    target = (folder / found["target"]).resolve()
    for page, file in ELSEWHERE.items():
        if target == ROOT / file:
            up = "../" * name.count("/")
            return f"[{found['text']}]({up}{page}{found['anchor'] or ''})"
    return found["text"]
