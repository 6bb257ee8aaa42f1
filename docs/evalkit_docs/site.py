"""The pages of the site that are not in docs/pages: generated references, files of the repository, included blocks."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

from evalkit_docs import command_reference, metric_reference, plugin_reference, tuning_reference

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "pages"

GENERATED: Mapping[str, Callable[[], str]] = {
    "reference/metrics.md": metric_reference.write_metrics,
    "reference/commands.md": command_reference.write_commands,
    "reference/back-ends.md": plugin_reference.write_back_ends,
    "reference/data-sets.md": plugin_reference.write_data_sets,
    "reference/tuning.md": tuning_reference.write_tuning,
}
"""Pages generated from the program."""

ELSEWHERE: Mapping[str, str] = {
    "external/protocol.md": "evalkit/external/PROTOCOL.md",
    "external/examples.md": "evalkit/external/examples/README.md",
    "changes.md": "CHANGELOG.md",
}
"""Pages of the site that are files of the repository."""

BLOCK = re.compile(
    r"^<!-- block: (?P<file>\S+) (?P<language>\w+) (?P<index>\d+)(?: as (?P<title>\S+))? -->$", re.MULTILINE
)
LINK = re.compile(r"\[(?P<text>[^][]+)\]\((?P<target>[^)#:\s]+)(?P<anchor>#[^)\s]*)?\)")


def write_pages() -> dict[str, str]:
    """Return the pages that are not in the folder of pages, by name."""
    generated = {name: write() for name, write in GENERATED.items()}
    return generated | {name: _load_page(name, file) for name, file in ELSEWHERE.items()}


def include_blocks(content: str) -> str:
    """Return a page with the code blocks of other files: ``<!-- block: FILE LANGUAGE INDEX as TITLE -->``.

    Raises LookupError if a file has no such block.
    """
    return BLOCK.sub(_block, content)


def _block(match: re.Match[str]) -> str:
    language, title = match["language"], match["title"]
    source = (ROOT / match["file"]).read_text(encoding="utf-8")
    blocks: list[str] = re.findall(rf"^```{language}\n(.*?)^```$", source, re.DOTALL | re.MULTILINE)
    if int(match["index"]) >= len(blocks):
        raise LookupError(f"{match['file']}: {len(blocks)} blocks of {language}, asked for number {match['index']}")
    head = f'{language} title="{title}"' if title else language
    return f"```{head}\n{blocks[int(match['index'])]}```"


def _load_page(name: str, file: str) -> str:
    """Return a file as a page: links to files that are pages lead to these pages, other links become plain text."""
    content = (ROOT / file).read_text(encoding="utf-8")
    return LINK.sub(lambda match: _link(match, name, (ROOT / file).parent), content)


def _link(match: re.Match[str], name: str, folder: Path) -> str:
    target = (folder / match["target"]).resolve()
    for page, file in ELSEWHERE.items():
        if target == ROOT / file:
            up = "../" * name.count("/")
            return f"[{match['text']}]({up}{page}{match['anchor'] or ''})"
    return match["text"]
