"""Run the calibration: ``python -m evalkit.commands.calibration``."""

from evalkit.commands.calibration.command import app
from evalkit.terminal.entry_point import run

if __name__ == "__main__":
    run(app)
