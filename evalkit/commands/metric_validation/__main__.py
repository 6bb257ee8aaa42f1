"""Run the validation of the metrics: ``python -m evalkit.commands.metric_validation``."""

from evalkit.commands.metric_validation.command import app
from evalkit.terminal.entry_point import run

if __name__ == "__main__":
    run(app)
