"""MkDocs' hooks: adds the pages that are written from the program, and a report as the tutorial makes it."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from evalkit_docs import example, site
from evalkit_docs.blocks import CONSOLE, blocks, commands

HIGHLIGHTED = f'<div class="language-{CONSOLE} highlight">'


def on_files(files: Any, config: Any) -> Any:
    """The site's files with the added pages and the pictures of the example."""
    from mkdocs.structure.files import File  # noqa: PLC0415 - mkdocs is needed to build the site alone

    for name, markdown in site.added().items():
        files.append(File.generated(config, name, content=markdown))
    given = config["extra"].get("example")
    for name, content in example.shown(Path(given) if given else None).items():
        files.append(File.generated(config, f"example/{name}", content=content))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """A page with the blocks it takes from other files."""
    return site.expanded(markdown)


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """A page whose blocks of a console give their commands alone to who copies them."""
    before, *parts = html.split(HIGHLIGHTED)
    consoles = [block.content for block in blocks(page.markdown) if block.language == CONSOLE]
    for console, part in zip(consoles, parts, strict=True):
        copied = escape("\n".join(command for command, _ in commands(console)))
        before += f'{HIGHLIGHTED[:-1]} data-copy="{copied}">{part}'
    return before
