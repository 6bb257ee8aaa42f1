"""The functions of the API: ``compare``, ``run``, ``load`` and ``register``."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from evalkit.api.pipeline import run_and_report
from evalkit.api.results import ComparisonResults
from evalkit.config.adhoc_experiment import (
    experiment_from_recording,
    format_command,
    open_recording,
    read_first_frame,
    split_names,
)
from evalkit.config.experiment import RESULTS, Experiment
from evalkit.config.experiment_file import load_experiment
from evalkit.config.forms import METHOD
from evalkit.config.toml_tables import flatten
from evalkit.core.errors import BadParameter, NotInstalled
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.run_result import RunResult
from evalkit.core.scan import Cloud, Scan
from evalkit.core.se2 import Floats
from evalkit.execution.environment import describe
from evalkit.execution.executors import LocalExecutor
from evalkit.execution.scheduler import Scheduler
from evalkit.odometry import frontend
from evalkit.plugins import defaults, registry
from evalkit.plugins.address import address_of, require_imported
from evalkit.plugins.parameters import ALIGN_TRUTH, MAP, MAP_START, NUISANCE, Value
from evalkit.plugins.specs import BackendSpec, RegistrationSpec
from evalkit.results.store import Store

MethodChoice = str | BackendSpec | type | Mapping[str, object]
"""A method: a registered name or "module:SPEC", a spec, a class with a ``register`` or ``update`` method, or a table of
an experiment file: ``{"use": ..., "label": ..., PARAMETER: value}``."""


def compare(
    recording: str | Path,
    methods: Sequence[MethodChoice] | None = None,
    ground_truth: str | Path | None = None,
    *,
    relations: str | Path | None = None,
    reader: str = "",
    map: str | Path | None = None,  # noqa: A002 - the word of the command line
    start: tuple[float, float, float] | None = None,
    align_truth: bool = False,
    nuisance: int = 0,
    out: str | Path | None = None,
    jobs: int = 1,
    resume: bool = True,
    **settings: Value,
) -> ComparisonResults:
    """Compare methods on a recording and return the results, with the report in a folder.

    ``recording``: a bag (ROS 1 or 2) or a log, or an experiment file (then the other sources are keys of that file).
    ``methods``: one of each family if not given. ``ground_truth``: a file (TUM: s, m, quaternion; frame of the base).
    ``relations``: measured relations (Kuemmerle et al. 2009). ``reader``: the data set that reads the recording,
    found by its content if not given. ``out``: the results folder; ``./evalkit-results/NAME`` if not given.
    ``map``: the map_server YAML file of a map in which the methods track the robot, from ``start`` (x m, y m, yaw deg
    in the map) or from where the first scans are found. ``align_truth``: the ground truth is in another frame than the
    map.
    ``nuisance``: further runs of each method under small perturbations, 0 or 2 to 64; a verdict takes 5. ``jobs``: runs
    at a time. ``resume``: use stored results of equal code, data and parameters.
    ``settings``: parameters of the reader, such as ``topic="/scan"``; others are what the reader finds in the
    recording and beside it (topic, ground truth, no-return code).

    Runs that fail are rows of the results. Raises BadData, BadParameter or UnknownName for wrong input.
    """
    path = Path(recording)
    keys: dict[str, Value] = {
        MAP: str(map or ""), MAP_START: _format_start(start), ALIGN_TRUTH: align_truth, NUISANCE: nuisance
    }  # fmt: skip
    keys = {name: value for name, value in keys.items() if value}
    files = {"ground_truth": ground_truth, "relations": relations}
    given = {name: str(value) for name, value in files.items() if value is not None}
    if path.suffix == ".toml":
        for name in (*given, *settings, *keys, *(["methods"] if methods is not None else [])):
            raise BadParameter(str(path), name, "an argument", "a key of the experiment file")
        return run(load_experiment(path), out, jobs=jobs, resume=resume)
    texts = {name: str(value) for name, value in settings.items()}
    experiment = _experiment_of_recording(path, _method_tables(methods), given, keys, texts, reader)
    read_first_frame(experiment)
    return run(experiment, out, jobs=jobs, resume=resume)


def run(
    experiment: Experiment | str | Path, out: str | Path | None = None, *, jobs: int = 1, resume: bool = True
) -> ComparisonResults:
    """Run an experiment (or its TOML file) and return its results, with the report in a folder.

    ``out``: the results folder; ``./evalkit-results/NAME`` if not given. See ``compare`` for the rest.
    """
    if not isinstance(jobs, int) or isinstance(jobs, bool) or jobs < 1:
        raise BadParameter("evalkit", "jobs", jobs, "a whole number from 1 on")
    if not isinstance(experiment, Experiment):
        experiment = load_experiment(Path(experiment))
    folder = Path(out) if out is not None else RESULTS / experiment.name
    scheduler = Scheduler(Store(folder), _Silent(), describe(jobs=jobs), resume)
    with _importable_by_children():
        run_and_report(scheduler, experiment, LocalExecutor(jobs))
    return load(folder)


def load(folder: str | Path) -> ComparisonResults:
    """Load the results that ``compare``, ``run`` or the command line have written.

    Raises StoreError if the folder holds no report, or one of another version.
    """
    return ComparisonResults.load(Path(folder))


def register(
    target: ArrayLike | Cloud | Scan,
    source: ArrayLike | Cloud | Scan,
    method: MethodChoice,
    guess: Pose | ArrayLike | None = None,
    **parameters: Value,
) -> Match:
    """Register one pair of clouds and return the match: its motion is ``target_from_source``.

    ``target``, ``source``: points (N, 2) in m, a Cloud, or a Scan (whose hits are taken). ``guess``: a Pose or
    (x m, y m, theta rad); the identity if not given. ``parameters``: of the method; its defaults otherwise.

    The method runs in this process. Raises NotInstalled if it cannot run here, BadParameter for a method that is no
    registration or for a wrong argument, ValueError for clouds of another shape.
    """
    table = _method_table(method)
    name = str(table["use"])
    of_table = flatten({key: value for key, value in table.items() if key not in METHOD.keys})
    spec = registry.backend(name)
    if why := spec.missing():
        raise NotInstalled(name, "cannot run here", why)
    if not isinstance(spec, RegistrationSpec):
        raise BadParameter("register", "method", name, "a registration; this one estimates whole drives (use compare)")
    complete = frontend.complete_parameters(name, spec, {**of_table, **parameters})
    _, registration = spec.make_stages(complete)
    clouds = _cloud("target", target), _cloud("source", source)
    return registration.register(*clouds, _pose(guess))


def _experiment_of_recording(
    path: Path,
    tables: list[dict[str, object]],
    given: Mapping[str, str],
    keys: Mapping[str, Value],
    settings: Mapping[str, str],
    reader: str,
) -> Experiment:
    """Return the experiment of methods on one recording, with the arguments where no command line can state them."""
    found = open_recording(path, {**settings, **given}, reader)
    names = [str(table["use"]) for table in tables]
    texts = [f"{name}={text}" for name, text in settings.items()]
    source = format_command(path, given, keys, names, texts, reader=reader)
    experiment = experiment_from_recording(found, found.choose(), tables, source, keys)
    if split_names(",".join(names)) == names and all(set(table) == {"use"} for table in tables):
        return experiment
    arguments: dict[str, object] = {
        "methods": json.loads(json.dumps(tables)), "ground_truth": given.get("ground_truth"),
        "relations": given.get("relations"), "reader": reader, MAP: keys.get(MAP),
        "start": [float(number) for number in str(keys.get(MAP_START, "")).split(",") if number],
        ALIGN_TRUTH: keys.get(ALIGN_TRUTH), NUISANCE: keys.get(NUISANCE), **settings,
    }  # fmt: skip
    return replace(experiment, arguments={name: one for name, one in arguments.items() if one})


def _cloud(name: str, points: ArrayLike | Cloud | Scan) -> Cloud:
    if isinstance(points, Cloud):
        return points
    if isinstance(points, Scan):
        return Cloud(points.points(), "sensor")
    return Cloud(_numbers("register", name, points, "points (N, 2) in m, a Cloud or a Scan"))


def _pose(guess: Pose | ArrayLike | None) -> Pose:
    if isinstance(guess, Pose):
        return guess
    if guess is None:
        return Pose()
    return Pose(*_three_numbers("register", "guess", guess, "a Pose, or x, y (m), theta (rad)"))


def _format_start(start: tuple[float, float, float] | None) -> str:
    """Return the start in a known map as text, "" where it is searched."""
    expected = "x (m), y (m), yaw (deg)"
    return "" if start is None else ",".join(map(str, _three_numbers("compare", "start", start, expected)))


def _three_numbers(owner: str, name: str, values: ArrayLike, expected: str) -> list[float]:
    """Return three finite numbers; raises BadParameter for anything else."""
    numbers = _numbers(owner, name, values, expected)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise BadParameter(owner, name, values, expected)
    row: list[float] = numbers.tolist()
    return row


def _numbers(owner: str, name: str, values: ArrayLike, expected: str) -> Floats:
    """Return an array of real numbers; raises BadParameter for text, complex numbers, and rows of unequal length."""
    try:
        found = np.asarray(values)
    except ValueError:
        found = np.array(None)
    if found.dtype.kind not in "iuf":
        raise BadParameter(owner, name, values, expected)
    return found.astype(np.float64)


def _method_tables(methods: Sequence[MethodChoice] | None) -> list[dict[str, object]]:
    """Return the methods of a comparison as tables of an experiment file; one of each family if not given."""
    if methods is None:
        return [{"use": name} for name in defaults.find_default_backends()]
    if isinstance(methods, (str, type, BackendSpec, Mapping)) or not methods:
        raise BadParameter("compare", "methods", methods, "a list of methods, such as ['paper', 'embedded']")
    tables = [_method_table(method) for method in methods]
    for table in tables:
        require_imported(address_of(str(table["use"])))
    return tables


def _method_table(method: MethodChoice) -> dict[str, object]:
    """Return a method as the table of an experiment file.

    Raises BadParameter for what is no method, and NotInstalled for an object that only this process has: a class of a
    notebook's cell or of a script.
    """
    if isinstance(method, Mapping) and "use" in method:
        return dict(method)
    if not isinstance(method, (str, type, BackendSpec)):
        expected = 'a name, a class, a spec or a table with "use"'
        raise BadParameter("evalkit", "method", method, f"{expected}; give a class itself, not an object of it")
    return {"use": address_of(method).label}


@contextmanager
def _importable_by_children() -> Iterator[None]:
    """Give the processes of the runs the import path of this one: they find modules of a notebook's folder."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(str(Path(entry or ".").resolve()) for entry in sys.path)
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before


class _Silent:
    """Progress that prints nothing."""

    def started(self, spec: object) -> None:
        """A run starts."""

    def answered(self, spec: object, scans: int) -> None:
        """A run has answered this many scans."""

    def finished(self, spec: object, result: RunResult) -> None:
        """A run has ended."""
