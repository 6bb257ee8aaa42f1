"""``python -m evalkit_paper FILE``: reproduce the paper's tables, figures and claims."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from evalkit.terminal.console import out
from evalkit.terminal.entry_point import run
from evalkit.terminal.options import Jobs


def paper(
    file: Annotated[Path, typer.Argument(help="The chapters and their settings (*.toml).", show_default=False)],
    folder: Annotated[
        Path | None, typer.Option("--out", "-o", help="Results folder.", show_default="reports/build/NAME")
    ] = None,
    workers: Jobs = None,
) -> None:
    """Reproduce the paper: compare every table, figure and claim with a measurement. Finished parts are kept."""
    from evalkit_paper.build import build_page  # noqa: PLC0415 - loads matplotlib

    out.print(str(build_page(file, folder, workers)))


if __name__ == "__main__":
    run(lambda: typer.run(paper))
