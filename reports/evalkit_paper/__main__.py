"""Reproduce the paper: ``python -m evalkit_paper FILE``."""

import typer

from evalkit.terminal.entry_point import run
from evalkit_paper.command import paper

if __name__ == "__main__":
    run(lambda: typer.run(paper))
