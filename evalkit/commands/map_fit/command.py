"""Learn how likely a position in a known map is wrong from the fit of its scan, and check it on other worlds.

Run it as ``python -m evalkit.commands.map_fit reports/map-fit.toml``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from evalkit.commands.map_fit import reliability
from evalkit.commands.map_fit.drives import FAULTS, measure_drive
from evalkit.commands.map_fit.reliability import Drive
from evalkit.config.experiment import Experiment
from evalkit.config.experiment_file import load_experiment
from evalkit.core.errors import BadExperiment
from evalkit.execution import environment
from evalkit.execution.task import make_task
from evalkit.io.output_files import format_json, write_texts
from evalkit.plugins import registry
from evalkit.terminal import options
from evalkit.terminal.console import out, print_json
from evalkit.terminal.options import Json, Out
from evalkit.terminal.shown_tasks import run_shown_tasks

app = typer.Typer(help="Calibrate the fit to a known map.", no_args_is_help=True, add_completion=False)

MIN_WORLDS = 3
"""Each world is predicted from the others: with fewer these say too little."""


@app.command()
def calibrate(
    file: Annotated[Path, typer.Argument(help="Experiment with trackers and simulated worlds (TOML).")],
    folder: Out = None,
    jobs: options.Jobs = None,
    as_json: Json = False,
) -> None:
    """Track a robot through simulated drives with faults, and learn how likely a position is wrong from the fit.

    The probabilities of each world are checked with what the other worlds taught.
    """
    experiment = load_experiment(file)
    folder = folder or Path("reports") / "build" / "map-fit"
    drives = _drive_all(experiment, folder, jobs)
    content = {
        **environment.describe_origin("evalkit.commands.map_fit"),
        **reliability.summarize(drives),
    }
    texts = {
        "fit_calibration.json": format_json(content) + "\n",
        "map-fit.md": reliability.format_markdown(content),
    }
    write_texts(folder, texts)
    if as_json:
        print_json(content)
    else:
        out.print(texts["map-fit.md"])


def _drive_all(experiment: Experiment, folder: Path, jobs: int | None) -> list[Drive]:
    """Make every drive: each world and seed with each tracker and fault."""
    worlds = {sequence.dataset for sequence in experiment.sequences}
    if len(worlds) < MIN_WORLDS:
        what = f"has {len(worlds)} worlds; each is checked with what the others taught: name {MIN_WORLDS} or more"
        raise BadExperiment(experiment.name, "sequence", what)
    tasks = {}
    for sequence in experiment.sequences:
        if None in sequence.seeds:
            raise BadExperiment(experiment.name, sequence.label, "is a recording; name simulated worlds")
        for method in experiment.methods:
            for fault in FAULTS:
                for seed in sequence.seeds:
                    task = make_task(
                        f"{sequence.label} {method.label} {fault} {seed}", measure_drive, sequence.dataset,
                        sequence.parameters_with_seed(seed), method.backend, dict(method.parameters), fault, seed or 0,
                    )  # fmt: skip
                    plug_ins = (("datasets", sequence.dataset), ("backends", method.backend))
                    modules = [registry.plug_in_of(kind, name).module for kind, name in plug_ins]
                    tasks[sequence.dataset, method.label, fault, seed, sequence.label] = task.depending_on(*modules)
    results = run_shown_tasks(list(tasks.values()), folder, jobs, "drives")
    return [Drive(world, method, fault, results[task.name]) for (world, method, fault, *_), task in tasks.items()]
