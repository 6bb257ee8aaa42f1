"""One run in this process.

``python -m evalkit.execution.worker FOLDER`` reads the request there and leaves its answer there.

Every scan's answer is on disk before the next scan begins, so whatever ends this process, nothing computed is lost.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from evalkit.core import belief
from evalkit.core.errors import BackendFailed, BadData, DataMissing, EvalkitError, NotInstalled, plain
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, Status
from evalkit.core.scan import Frame
from evalkit.core.timing import Timing, timed
from evalkit.execution import parent_watch
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.protocols import DatasetSpec, NoAnswer, Odometry, Sequence, Value

WARM_UP_SCANS = 5
"""Scans shown to a back end of its own before the clock starts; their cost is in no number."""

MIN_ANSWERED = 0.95
"""Who leaves out more of the scans than this share has not followed the sequence: the run has failed."""


@dataclass(frozen=True)
class Request:
    """What to run, by name; nothing but names and parameters crosses the process border."""

    backend: str
    backend_parameters: dict[str, Value]
    dataset: str
    dataset_parameters: dict[str, Value]
    core: int | None = None


@dataclass(frozen=True)
class Outcome:
    """How a run ended, as the worker itself saw it."""

    status: Status
    reason: str
    expected: int
    peak_memory_bytes: int
    warm_up_scans: int
    notes: dict[str, int]


class Residuals:
    """The last scan's matches, as the front end or the odometry itself tells of them."""

    def __init__(self) -> None:
        self.row: dict[str, float] = {}
        self.clear()

    def clear(self) -> None:
        """Forgets the last scan."""
        nothing = {
            "error": np.nan,
            "iterations": 0,
            "inliers": 0,
            "accepted": belief.UNTOLD,
            "converged": belief.UNTOLD,
        }
        self.row = {f"{stage}_{name}": value for stage in ("s2s", "s2m") for name, value in nothing.items()}
        belief.heard()
        belief.heard_of_stages()

    def hear(self, stage: frontend.Stage, match: Match, accepted: bool) -> None:
        """Takes in one stage's answer."""
        self.row[f"{stage}_error"] = match.error
        self.row[f"{stage}_iterations"] = match.iterations
        self.row[f"{stage}_inliers"] = match.inliers
        self.row[f"{stage}_accepted"] = accepted
        self.row[f"{stage}_converged"] = bool(match.converged)

    def ask(self) -> None:
        """Takes in what an odometry has told of its answer by itself."""
        told = belief.heard()
        if told != belief.UNTOLD:
            self.row["s2m_accepted"] = told
        for stage, registered in belief.heard_of_stages().items():
            self.row.update({f"{stage}_{name}": value for name, value in registered._asdict().items()})


def main() -> int:
    """Runs the request of the folder named on the command line; the outcome is in ``outcome.json``."""
    parent_watch.end_with_parent()
    folder = Path(sys.argv[1]).resolve()  # a back end may change the working directory
    request = Request(**json.loads((folder / "request.json").read_text(encoding="utf-8")))
    if request.core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {request.core})
    _leave(folder / "outcome.json", asdict(perform(request, folder)))
    return 0


def perform(request: Request, folder: Path) -> Outcome:
    """Runs the back end over the sequence, appending one ``STEP`` record per scan to ``steps.bin``."""
    notes: dict[str, int] = {}
    expected = warm = 0
    status: Status = "complete"
    reason = ""
    try:
        spec = registry.backend(request.backend)
        if why := spec.missing():
            raise NotInstalled(request.backend, "not installed", why)
        _leave(folder / "begun.json", {"reading": True})
        dataset = registry.dataset(request.dataset)
        sequence: Sequence = dataset.make(**request.dataset_parameters)
        if spec.kind == "map":
            spec.make(**request.backend_parameters)  # one that cannot be read has failed
            return Outcome(status, plain(reason), expected, _peak_memory_bytes(), warm, notes)
        expected = len(sequence)
        begun = {"expected": expected, "every": _every(dataset, request)}
        _leave(folder / "begun.json", begun)  # for a back end that ends this process in its warm-up
        warm = _warm_up(frontend.odometry(spec, request.backend_parameters), sequence)
        residuals = Residuals()
        method = frontend.odometry(spec, request.backend_parameters, residuals.hear)
        _leave(folder / "begun.json", begun | {"warm_up_scans": warm})
        with (folder / "steps.bin").open("ab", buffering=0) as file:
            follow(method, sequence, request, residuals, file)
        notes = dict(sequence.notes())
    except NotInstalled as error:
        status, reason = "not-installed", str(error)
    except DataMissing as error:
        status, reason = "data-missing", str(error)
    except EvalkitError as error:
        status, reason = "failed", str(error)
    except MemoryError as error:
        traceback.print_exc()
        status, reason = "out-of-memory", f"the system gave no more memory: {error or 'MemoryError'}"
    except Exception as error:  # noqa: BLE001 - whatever a third party's code raises is a result to report
        traceback.print_exc()
        status, reason = "failed", f"{type(error).__name__}: {error}"
    return Outcome(status, plain(reason), expected, _peak_memory_bytes(), warm, notes)


def _every(dataset: DatasetSpec, request: Request) -> int:
    """The sequence holds one in so many of the sensor's scans."""
    return int(request.dataset_parameters.get(dataset.thinned_by, 1))


def _leave(path: Path, content: dict[str, Any]) -> None:
    partial = path.with_name(path.name + ".part")
    partial.write_text(json.dumps(content), encoding="utf-8")
    partial.replace(path)


def _warm_up(method: Odometry, sequence: Sequence) -> int:
    """How many scans a back end of its own saw: imports, first allocations and thread pools are paid here."""
    seen = 0
    for frame in sequence.frames():
        with contextlib.suppress(NoAnswer):
            method.update(frame)
        seen += 1
        if seen == WARM_UP_SCANS:
            break
    return seen


def follow(method: Odometry, sequence: Sequence, request: Request, residuals: Residuals, steps: BinaryIO) -> None:
    """Writes a ``STEP`` record for every scan the back end answers; BackendFailed where it leaves out too many.

    A record's ``harness_ns`` is what the harness took around the scan before.
    """
    around = asked = unanswered = 0
    why = ""
    for frame in _in_order(sequence, request.dataset):
        begun = time.perf_counter_ns()
        asked += 1
        residuals.clear()
        try:
            pose, timing = timed(lambda frame=frame: method.update(frame))  # type: ignore[misc]
        except NoAnswer as reason:
            unanswered, why = unanswered + 1, str(reason)
            continue
        residuals.ask()
        steps.write(_record(frame, pose, timing, residuals, around))
        around = time.perf_counter_ns() - begun - timing.wall_ns
    if unanswered > (1.0 - MIN_ANSWERED) * asked:
        what = f"no answer for {unanswered} of {asked} scans"
        raise BackendFailed(request.backend, what, f"why the last time: {why}")


def _in_order(sequence: Sequence, dataset: str) -> Iterator[Frame]:
    """The frames; BadData where their stamps do not increase."""
    last_ns: int | None = None
    for index, frame in enumerate(sequence.frames()):
        if last_ns is not None and frame.scan.stamp_ns <= last_ns:
            found = f"stamp {frame.scan.stamp_ns} ns is not later than the one before, {last_ns} ns"
            raise BadData(dataset, f"scan {index + 1}", found, "give the scans in the order of time")
        last_ns = frame.scan.stamp_ns
        yield frame


def _record(frame: Frame, pose: object, timing: Timing, residuals: Residuals, around_ns: int) -> bytes:
    if not isinstance(pose, Pose):
        raise TypeError(f"update() answered a {type(pose).__name__}, expected an evalkit.Pose")
    if not np.isfinite(pose.row).all():  # a Pose of a third party's own making need not have been checked
        raise ValueError(f"update() answered a pose that is not finite: ({pose.x}, {pose.y}, {pose.theta})")
    record = np.zeros((), dtype=STEP)
    record["stamp_ns"] = frame.scan.stamp_ns
    record["x"], record["y"], record["theta"] = pose.x, pose.y, pose.theta
    record["wall_ns"], record["cpu_ns"], record["conversion_ns"] = timing.wall_ns, timing.cpu_ns, timing.conversion_ns
    record["harness_ns"], record["device_ns"] = around_ns, timing.device_ns
    for name, value in residuals.row.items():
        record[name] = value
    return record.tobytes()


def _peak_memory_bytes() -> int:
    """The resident set at its highest. Linux's ru_maxrss would not do: it starts at what the parent process held."""
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
