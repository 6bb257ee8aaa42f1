"""Build the site: ``PYTHONPATH=docs python -m evalkit_docs.build``.

All pages are written to a folder first: those of docs/pages with the blocks they include, the generated references, and
the example. MkDocs then reads plain Markdown, without hooks. In the result, console blocks copy their commands only.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from html import escape
from pathlib import Path

from evalkit_docs import example, site
from evalkit_docs.blocks import CONSOLE, find_blocks, find_commands

CONFIG = site.PAGES.parent / "mkdocs.yml"
SOURCES = site.ROOT / "reports" / "build" / "pages"
"""The folder of the written pages: ``docs_dir`` in mkdocs.yml."""

SITE = site.ROOT / "reports" / "build" / "site"
HIGHLIGHTED = f'<div class="language-{CONSOLE} highlight">'


def main() -> int:
    """Build the site and return the exit code."""
    parser = argparse.ArgumentParser(description="Build the documentation.")
    parser.add_argument("--site", type=Path, default=SITE, help="folder of the site")
    parser.add_argument("--example", type=Path, help="results of the tutorial to show; run if not given")
    arguments = parser.parse_args()
    write_sources(SOURCES, arguments.example)
    words = ["build", "--strict", "--quiet", "--config-file", str(CONFIG), "--site-dir", str(arguments.site.resolve())]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    ended = subprocess.run([sys.executable, "-m", "mkdocs", *words], check=False, env=environment)
    if ended.returncode == 0:
        mark_commands(SOURCES, arguments.site)
    return ended.returncode


def write_sources(folder: Path, results: Path | None) -> None:
    """Write all pages and files of the site to a folder, which is replaced; ``results``: those of the tutorial."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(site.PAGES, folder)
    for page in folder.rglob("*.md"):
        page.write_text(site.include_blocks(page.read_text(encoding="utf-8")), encoding="utf-8")
    pages = {name: content.encode() for name, content in site.write_pages().items()}
    shown = {f"example/{name}": content for name, content in example.load_files(results).items()}
    for name, content in (pages | shown).items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def mark_commands(sources: Path, built: Path) -> None:
    """Let the button of every console block copy its commands without their output."""
    for page in sources.rglob("*.md"):
        html = (built / page.relative_to(sources)).with_suffix(".html")
        if html.exists():
            marked = mark_page(page.read_text(encoding="utf-8"), html.read_text(encoding="utf-8"))
            html.write_text(marked, encoding="utf-8")


def mark_page(markdown: str, html: str) -> str:
    """Return the HTML of a page whose console blocks copy their commands."""
    before, *parts = html.split(HIGHLIGHTED)
    consoles = [block.content for block in find_blocks(markdown) if block.language == CONSOLE]
    for console, part in zip(consoles, parts, strict=True):
        copied = escape("\n".join(command for command, _ in find_commands(console)))
        before += f'{HIGHLIGHTED[:-1]} data-copy="{copied}">{part}'
    return before


if __name__ == "__main__":
    sys.exit(main())
