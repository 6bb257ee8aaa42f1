"""Hooks of MkDocs: add the generated pages and the example report to the site."""

from __future__ import annotations

import sys
from html import escape
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # MkDocs loads this file alone, outside its package

from evalkit_docs import example, site
from evalkit_docs.blocks import CONSOLE, find_blocks, find_commands

HIGHLIGHTED = f'<div class="language-{CONSOLE} highlight">'


def on_files(files: Any, config: Any) -> Any:
    """Return the files of the site with the generated pages and the files of the example."""
    from mkdocs.structure.files import File  # noqa: PLC0415 - only needed to build the site

    for name, markdown in site.write_pages().items():
        files.append(File.generated(config, name, content=markdown))
    results = config["extra"].get("example")
    for name, content in example.load_files(Path(results) if results else None).items():
        files.append(File.generated(config, f"example/{name}", content=content))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return a page with the blocks that it includes from other files."""
    return site.include_blocks(markdown)


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """Return a page whose console blocks copy their commands without the output."""
    before, *parts = html.split(HIGHLIGHTED)
    consoles = [block.content for block in find_blocks(page.markdown) if block.language == CONSOLE]
    for console, part in zip(consoles, parts, strict=True):
        copied = escape("\n".join(command for command, _ in find_commands(console)))
        before += f'{HIGHLIGHTED[:-1]} data-copy="{copied}">{part}'
    return before
