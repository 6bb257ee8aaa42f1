"""The commands about recordings, one folder each: ``evalkit inspect`` and ``evalkit datasets``.

They use the readers and the catalogue, which ``evalkit`` does not know; so they are here, and registered in
``pyproject.toml`` as those of any other package are. The other commands are in ``evalkit/commands/``.
"""

from evalkit.terminal.command_spec import CommandSpec

INSPECT = CommandSpec(
    "Inspect a recording: its contents, its defects, and the command that runs it.",
    "Start",
    "evalkit_datasets.commands.inspect.command:inspect",
)
DATASETS = CommandSpec(
    "List, download and generate recordings.", "Reference", "evalkit_datasets.commands.datasets.command:app"
)
