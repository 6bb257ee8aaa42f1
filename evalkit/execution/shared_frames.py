"""Read the data of an experiment once for all methods: their frames are in a file while runs need them.

Without it every run reads the recording, or simulates the drive, again. The file is written by a scoring process, which
runs no back end, and every run checks that it is unchanged. A run without a file reads the data itself: where they are
too large, where methods need the ground truth, or where they cannot be read, so that the run tells why.
"""

from __future__ import annotations

import hashlib
import json
import os
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from evalkit.config.experiment import RunSpec
from evalkit.core.errors import MachineFault
from evalkit.execution.subprocesses import WorkerPool
from evalkit.execution.task_time_limit import time_limit
from evalkit.io.output_files import create_folder
from evalkit.plugins import registry
from evalkit.plugins.kept_sequence import KeptSequence
from evalkit.plugins.parameters import MAP, RESERVED, Value
from evalkit.plugins.protocols import Sequence
from evalkit.plugins.stored_frames import FramesFile, write_frames

FOLDER = ".frames"
"""In the results folder, while an experiment runs."""

SUFFIX = ".frames"

ParameterItems = tuple[tuple[str, Value], ...]


@dataclass
class _Shared:
    """The frames of one sequence: runs that still need them, and their file once ``is_tried``."""

    runs: int = 0
    is_tried: bool = False
    file: FramesFile | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)


class SharedFrames:
    """Files with the frames of runs, below the results folder: written for the first run, deleted after the last.

    ``scoring``: the processes that read the data. ``limit_s``: for reading one sequence. A context manager that leaves
    no file behind.
    """

    def __init__(self, folder: Path, specs: Iterable[RunSpec], scoring: WorkerPool, limit_s: float) -> None:
        self._folder, self._scoring, self._limit_s = folder, scoring, limit_s
        self._shared: dict[str, _Shared] = {}
        for spec in specs:
            self._shared.setdefault(_name(spec), _Shared()).runs += 1

    def __enter__(self) -> SharedFrames:
        self._clear()
        return self

    def __exit__(self, *_: object) -> None:
        self._clear()

    @contextmanager
    def of_run(self, spec: RunSpec, core: int | None) -> Iterator[FramesFile | None]:
        """The file with the frames of a run for the time of the block, None where the run reads its data itself.

        ``core``: where they are read if they have not been.
        """
        shared = self._shared[_name(spec)]
        with shared.lock:
            if not shared.is_tried:
                shared.is_tried, shared.file = True, self._write(spec, core)
        try:
            yield shared.file
        finally:
            with shared.lock:
                shared.runs -= 1
                if shared.file is not None and not shared.runs:
                    Path(shared.file.path).unlink(missing_ok=True)

    def _write(self, spec: RunSpec, core: int | None) -> FramesFile | None:
        if MAP in spec.dataset_parameters:  # the start is searched with the ground truth
            return None
        path, parameters = self._folder / FOLDER / f"{_name(spec)}{SUFFIX}", tuple(spec.dataset_parameters.items())
        try:
            return self._scoring.run(
                write_frames_file, self._folder, path, spec.sequence.dataset, parameters, core, self._limit_s
            )
        except (BrokenProcessPool, MachineFault):
            return None

    def _clear(self) -> None:
        """Delete the files, also those of a killed process, and nothing else: a user may have a folder of this name."""
        place = self._folder / FOLDER
        with suppress(OSError):
            for file in () if place.is_symlink() else place.glob(f"*{SUFFIX}*"):
                file.unlink()
            place.rmdir()


def write_frames_file(
    folder: Path, path: Path, dataset: str, parameters: ParameterItems, core: int | None, limit_s: float
) -> FramesFile | None:
    """Write the frames of a sequence to a file below a results folder, on a core; None where that is not possible.

    Ends its process, one of the scoring pool, after ``limit_s``.
    """
    if core is not None:
        os.sched_setaffinity(0, {core})
    try:
        create_folder(path.parent, folder)
        with time_limit(path.with_suffix(f"{SUFFIX}.limit"), limit_s):
            sha256 = write_frames(open_kept(folder, dataset, parameters), path, folder)
            every = int(dict(parameters).get(registry.dataset(dataset).thinned_by, 1))
    except Exception:  # noqa: BLE001 - code of a third party, or a full disk: the run meets it again, and reports it
        return None
    return None if sha256 is None else FramesFile(str(path), sha256, every)


@lru_cache(maxsize=1)
def open_kept(folder: Path, dataset: str, parameters: ParameterItems) -> KeptSequence:
    """The data of a run, kept for the next one: successive runs are of different methods on the same data.

    ``folder``: of the results; another experiment reads the data again, which may have changed in between.
    """
    own = tuple((name, value) for name, value in parameters if name not in RESERVED)
    return KeptSequence(registry.dataset(dataset).perturb(_open_unperturbed(folder, dataset, own), dict(parameters)))


@lru_cache(maxsize=1)
def _open_unperturbed(_folder: Path, dataset: str, parameters: ParameterItems) -> Sequence:
    """The data of all perturbed repetitions."""
    return registry.dataset(dataset).make(**dict(parameters))


def _name(spec: RunSpec) -> str:
    """Name of the file with the frames of a run, the same for all methods."""
    data = [spec.sequence.dataset, spec.dataset_parameters]
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()[:16]
