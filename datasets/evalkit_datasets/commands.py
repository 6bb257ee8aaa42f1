"""The commands that the data sets bring: ``evalkit inspect`` and ``evalkit datasets``."""

from evalkit.terminal.command_spec import CommandSpec

INSPECT = CommandSpec(
    "Inspect a recording: its contents, its defects, and the command that runs it.",
    "Start",
    "evalkit_datasets.inspection.command:inspect",
)
DATASETS = CommandSpec("List, download and generate recordings.", "Reference", "evalkit_datasets.command:app")
