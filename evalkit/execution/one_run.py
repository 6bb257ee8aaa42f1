"""Execute one run in this process: ``python -m evalkit.execution.one_run FOLDER``.

Reads the request from the folder and writes the outcome to it. The answer for every scan is on disk before the next
scan begins, so that nothing computed is lost if the process dies.
"""

from __future__ import annotations

import gc
import json
import math
import os
import struct
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np

from evalkit.core.errors import BackendFailed, DataMissing, EvalkitError, MachineFault, NotInstalled, StoreError, plain
from evalkit.core.odometry_estimate import OdometryEstimate, StageEstimate
from evalkit.core.path_correction import PathCorrection
from evalkit.core.run_result import NO_STEPS, STEP, RunResult
from evalkit.core.run_status import Cause
from evalkit.core.scan import Frame
from evalkit.core.timing import CallTiming
from evalkit.execution.conditions import WaitingMeter, measure_own_threads
from evalkit.execution.parent import end_with_parent
from evalkit.execution.supervisor import MACHINE_FAULT_CODE
from evalkit.io.output_files import write_bytes, write_text
from evalkit.odometry import frontend
from evalkit.odometry.corrections import read_corrections, read_remarks
from evalkit.odometry.path_corrections import PathRecorder
from evalkit.odometry.run_odometry import run_odometry
from evalkit.plugins import registry
from evalkit.plugins.nuisance import perturb_parameters
from evalkit.plugins.parameters import MAP, NUISANCE, Value
from evalkit.plugins.protocols import Odometry, Sequence, Slam
from evalkit.plugins.specs import BackendSpec, MapSpec, SlamSpec
from evalkit.plugins.stored_frames import FramesFile, StoredFrames
from evalkit.results.final_files import PATHS, format_final, format_paths

WARM_UP_SCANS = 5
"""Number of scans that a separate instance of the back end processes before the timed run; not part of any number."""

MIN_ANSWERED = 0.95
"""Smallest share of scans with an answer; a run with fewer has failed."""

REQUEST, STARTED, OUTCOME, STEPS = "request.json", "started.json", "outcome.json", "steps.bin"
NOT_REPORTED = -1
"""Value of ``accepted``, ``converged`` and ``corrected`` in a ``STEP`` record where the odometry does not report it."""

_STEP_FORMAT = struct.Struct(
    "=" + "".join({"i8": "q", "f8": "d", "i4": "i", "i1": "b"}[STEP[name].str[1:]] for name in STEP.names or ())
)
"""Packs a record of dtype ``STEP`` in a quarter of the time that NumPy takes."""

NOT_IN_OUTCOME = ("steps", "provenance", "final", "loop_closures", "path_corrections")
"""Fields of a result that are no part of the outcome: they have files of their own, or the parent knows them."""


@dataclass(frozen=True)
class Request:
    """What to run: only names and parameters pass from the parent process to this one.

    ``core``: to pin to. ``frames``: the file with the frames of the data set, None where it is to be read. ``plug_in``:
    "module:SPEC" of a registered back end, "" where the installed packages are to be searched.
    """

    backend: str
    backend_parameters: dict[str, Value]
    dataset: str
    dataset_parameters: dict[str, Value]
    core: int | None = None
    frames: FramesFile | None = None
    plug_in: str = ""

    @classmethod
    def of(cls, values: dict[str, Any]) -> Request:
        """The request of its JSON values; a back end may change the working directory before the frames are read."""
        frames = values.get("frames")
        if frames is not None:
            frames = FramesFile(**{**frames, "path": str(Path(frames["path"]).absolute())})
        return cls(**{**values, "frames": frames})


class ScanPlace:
    """Which scan a back end has in hand, for the reason of a run that fails there."""

    def __init__(self) -> None:
        self._part, self._number, self._stamp_ns = "", 0, 0
        self.answered = 0

    def follow(self, frames: Iterable[Frame], part: str = "") -> Iterator[Frame]:
        """Yield the frames; ``part``: of the run, "" if it is the timed one."""
        self._part, self.answered, waiting = part, 0, iter(frames)
        while (frame := next(waiting, None)) is not None:
            self._number, self._stamp_ns = self.answered + 1, frame.scan.stamp_ns
            yield frame
            self.answered, self._number = self._number, 0  # while the next one is read, none is in hand

    def __str__(self) -> str:
        part = f" of {self._part}" if self._part else ""
        return f"at scan {self._number}{part} (stamp {self._stamp_ns} ns)" if self._number else ""


def main() -> int:
    """Execute the request in the folder named on the command line; write the outcome to ``outcome.json``."""
    end_with_parent()
    folder = Path(sys.argv[1]).resolve()  # a back end may change the working directory
    request = Request.of(json.loads((folder / REQUEST).read_text(encoding="utf-8")))
    if request.core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {request.core})
    result = execute_request(request, folder)
    outcome = {name: value for name, value in asdict(result).items() if name not in NOT_IN_OUTCOME}
    try:
        _write_json(folder / OUTCOME, outcome)
    except StoreError as error:
        if MachineFault.of(OUTCOME, error) is None:
            raise
        return MACHINE_FAULT_CODE
    return 0


def execute_request(request: Request, folder: Path) -> RunResult:
    """Run the back end over the sequence; append one ``STEP`` record per scan to ``steps.bin``.

    Writes what a SLAM corrected. Returns how the run went, without its steps and this.
    """
    notes: dict[str, int] = {}
    expected = warm = final_cpu_ns = 0
    every = 1
    cause, reason = Cause.COMPLETED, ""
    conditions = paths = None
    remarks: tuple[str, ...] = ()
    place = ScanPlace()
    try:
        spec = registry.backend(request.backend, request.plug_in)
        if why := spec.missing():
            raise NotInstalled(request.backend, "not installed", why)
        _write_json(folder / STARTED, {"reading": True})
        sequence, every = _open_data(request)
        if isinstance(spec, MapSpec):
            spec.make(**request.backend_parameters)  # raises if the file cannot be read
            return RunResult(NO_STEPS, expected, peak_memory_bytes=_peak_memory_bytes())
        expected = len(sequence)
        make, sequence, start = _prepare(request, spec, sequence, folder)
        started = {"expected": expected, "every": every, **start}
        _write_json(folder / STARTED, started)  # in case the back end kills this process in its warm-up
        rehearsal = make()
        _collect_garbage()
        _warm_up(rehearsal, sequence, place)
        warm = place.answered
        odometry = make()
        _write_json(folder / STARTED, started | {"warm_up_scans": warm})
        waiting = WaitingMeter()
        with (folder / STEPS).open("ab", buffering=0) as file:
            if isinstance(spec, SlamSpec):
                paths = PathRecorder(cast("Slam", odometry), lambda: np.fromfile(folder / STEPS, STEP))
            record_run(odometry, place.follow(sequence.frames()), request, file, paths)
        if paths is not None:
            final_cpu_ns = record_final(odometry, folder, paths.corrections)
        remarks = read_remarks(odometry)
        conditions = measure_own_threads(waiting.percent())
        notes = dict(sequence.notes())
    except Exception as error:  # noqa: BLE001 - an exception of a third party's code is a result to report
        cause, reason = cause_of(error)
        warm = warm or place.answered
        if cause in (Cause.EXCEPTION, Cause.MEMORY_ERROR) and str(place):
            reason = f"{reason}; {place}"
    return RunResult(
        NO_STEPS, expected, cause, plain(reason), _peak_memory_bytes(), warm, notes, every, conditions=conditions,
        final_cpu_ns=final_cpu_ns, remarks=remarks, paths_left_out=plain(paths.left_out) if paths else "",
    )  # fmt: skip


def find_run_parameters(request: Request) -> dict[str, Value]:
    """The parameters of the back end in this run: perturbed if the recording is."""
    if NUISANCE not in request.dataset_parameters:
        return request.backend_parameters
    known = frontend.settable_parameters(registry.backend(request.backend, request.plug_in))
    return perturb_parameters(request.backend_parameters, known, int(request.dataset_parameters[NUISANCE]))


def cause_of(error: Exception) -> tuple[Cause, str]:
    """The cause and the reason of a run that raised; prints the traceback unless it is an EvalkitError."""
    if isinstance(error, StoreError):
        error = MachineFault.of("the folder of the run", error) or error
    if isinstance(error, MachineFault):
        return Cause.MACHINE_FAULT, str(error)
    if isinstance(error, NotInstalled):
        return Cause.NOT_INSTALLED, str(error)
    if isinstance(error, DataMissing):
        return Cause.DATA_MISSING, str(error)
    if isinstance(error, EvalkitError):
        return Cause.EXCEPTION, str(error)
    traceback.print_exception(error)
    if isinstance(error, MemoryError):
        return Cause.MEMORY_ERROR, f"the system gave no more memory: {error or 'MemoryError'}"
    return Cause.EXCEPTION, f"{type(error).__name__}: {error}"


def _open_data(request: Request) -> tuple[Sequence | StoredFrames, int]:
    """The data of a run, and n where they hold one in n scans of the sensor."""
    if request.frames is not None:
        return StoredFrames(request.frames), request.frames.every
    dataset = registry.dataset(request.dataset)
    every = int(request.dataset_parameters.get(dataset.thinned_by, 1))
    return dataset.open(request.dataset_parameters), every


def _prepare(
    request: Request, spec: BackendSpec, sequence: Sequence | StoredFrames, folder: Path
) -> tuple[Callable[[], Odometry], Sequence | StoredFrames, dict[str, Any]]:
    """What makes the odometry, the data that it gets, and where it starts in a known map, if there is one."""
    values = find_run_parameters(request)
    if MAP in request.dataset_parameters and not isinstance(sequence, StoredFrames):
        from evalkit.odometry.map_localisation import localise  # noqa: PLC0415 - most runs start faster without

        localised = localise(spec, values, request.dataset_parameters, sequence, folder)
        if localised is not None:
            return localised.make, localised.sequence, {"start": localised.start.as_dict()}
    return partial(frontend.make_odometry, spec, values), sequence, {}


def _write_json(path: Path, content: dict[str, Any]) -> None:
    write_text(path, json.dumps(content))


def _collect_garbage() -> None:
    """Enable the collection of garbage, which the supervisor has disabled; it need not look through what is loaded."""
    if not gc.isenabled():
        gc.enable()
        gc.freeze()


def _warm_up(odometry: Odometry, sequence: Sequence | StoredFrames, place: ScanPlace) -> None:
    """Run a separate odometry over the first scans; imports, first allocations and thread pools happen here."""
    for _ in run_odometry(odometry, place.follow(islice(sequence.frames(), WARM_UP_SCANS), "the warm-up")):
        pass


def record_run(
    odometry: Odometry,
    frames: Iterable[Frame],
    request: Request,
    steps: BinaryIO,
    paths: PathRecorder | None = None,
) -> None:
    """Write a ``STEP`` record for every answered scan; raises BackendFailed where too many scans have no answer.

    A record's ``harness_ns`` is the time that the harness spent around the previous scan. ``paths`` records each
    correction of a SLAM; that time is part of no record.
    """
    scans = unanswered = around_ns = 0
    reason = ""
    begun_ns = time.perf_counter_ns()
    for step in run_odometry(odometry, frames, request.dataset):
        scans += 1
        if step.estimate is None:
            unanswered, reason = unanswered + 1, step.reason
        else:
            _append(steps, _record_step(step.frame, step.estimate, step.timing, around_ns))
            around_ns = time.perf_counter_ns() - begun_ns - step.timing.wall_ns
            if paths is not None and step.estimate.corrected:
                paths.record()
        begun_ns = time.perf_counter_ns()
    if unanswered > (1.0 - MIN_ANSWERED) * scans:
        what = f"no answer for {unanswered} of {scans} scans"
        raise BackendFailed(request.backend, what, f"reason for the last one: {reason}")


def record_final(odometry: Odometry, folder: Path, paths: list[PathCorrection]) -> int:
    """Write what a SLAM corrected beside its steps: poses, loop closures, paths before and after each correction.

    Returns the CPU time of asking for the first two in ns. Raises as ``read_corrections``.
    """
    stamps_ns = np.fromfile(folder / STEPS, STEP)["stamp_ns"]
    found = read_corrections(odometry, stamps_ns)
    files = format_final(found.trajectory, found.closures)
    if paths:
        files[PATHS] = format_paths(paths, stamps_ns)
    for name, content in files.items():
        write_bytes(folder / name, content)
    return found.cpu_ns


def _append(steps: BinaryIO, record: bytes) -> None:
    """Append a whole record, so that the next one does not begin inside it. Raises MachineFault on a full disk."""
    try:
        written = steps.write(record)
    except OSError as error:
        raise MachineFault.of(STEPS, error) or error from None
    if written != len(record):
        raise MachineFault(STEPS, "the disk is full", MachineFault.REMEDY)


def _record_step(frame: Frame, estimate: OdometryEstimate, timing: CallTiming, around_ns: int) -> bytes:
    pose, s2s, s2m = estimate.pose, estimate.stages.get("s2s"), estimate.stages.get("s2m")
    (error, *counts), flags = _list_stage(s2s)
    (map_error, *map_counts), (accepted, converged) = _list_stage(s2m)
    if not estimate.stages and estimate.accepted is not None:
        accepted = estimate.accepted
    record = (
        frame.scan.stamp_ns, pose.x, pose.y, pose.theta, timing.wall_ns, timing.cpu_ns, timing.conversion_ns, around_ns,
        timing.device_ns, timing.preparation_ns, error, *counts, map_error, *map_counts, *flags, accepted, converged,
        NOT_REPORTED if estimate.corrected is None else estimate.corrected,
    )  # fmt: skip
    try:
        return _STEP_FORMAT.pack(*record)
    except struct.error:  # a boolean of NumPy, or a float for an integer
        return np.array(record, dtype=STEP).tobytes()


def _list_stage(stage: StageEstimate | None) -> tuple[tuple[float, int, int], tuple[int, int]]:
    """Return error, iterations and inliers of a stage, and whether it accepted and converged."""
    if stage is None:
        return (math.nan, 0, 0), (NOT_REPORTED, NOT_REPORTED)
    return (stage.residual_m, stage.iterations, stage.inliers), (stage.accepted, stage.converged)


def _peak_memory_bytes() -> int:
    """The largest resident set. Not ru_maxrss on Linux, which starts at the value of the parent process."""
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    import resource  # noqa: PLC0415 - not on every system; only a run needs it

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


if __name__ == "__main__":
    sys.exit(main())
