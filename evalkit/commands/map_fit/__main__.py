"""Run the calibration of the fit to a map: ``python -m evalkit.commands.map_fit``."""

from evalkit.commands.map_fit.command import app
from evalkit.terminal.entry_point import run

if __name__ == "__main__":
    run(app)
