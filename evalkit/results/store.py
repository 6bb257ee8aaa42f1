"""The results folder of an experiment: one folder per run, found by the key of its RunSpec.

runs/<key>/  request.json  started.json  steps.bin  outcome.json  output.txt    written by the process of the run
             final.npy  loop_closures.json                     of a SLAM: corrected poses at the stamps of steps.bin
             path_corrections.npy                              of a SLAM: its path before and after each correction
             result.json                                       how the run went: cause, cost, provenance
             scores.json  grid.npz  errors.npy  final_errors.npy  fit.npy  its evaluation
trajectories/<key>.tum   maps/<key>.pgm  maps/<key>.yaml       for other tools; <key>.final.tum: corrected poses
attempts/<key>.json      processes that started the run and did not reach its end

result.json and scores.json hold checksums of their values and of the binary files beside them, checked on every read.
"""

from __future__ import annotations

import errno
import hashlib
import json
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, fields
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np
from filelock import FileLock, Timeout
from numpy.typing import NDArray

from evalkit.config.experiment import RunSpec
from evalkit.core.errors import StoreError
from evalkit.core.grid import OccupancyGrid
from evalkit.core.map_start import MapStart
from evalkit.core.pose import Pose
from evalkit.core.run_result import DISTURBED, STEP, FinalAlignment, LostTrack, RunConditions, RunResult, Score, Scores
from evalkit.core.run_status import Cause
from evalkit.io import map_server, untrusted_io
from evalkit.io.output_files import as_store_error, create_folder, write_bytes
from evalkit.io.tum import format_tum
from evalkit.results.final_files import CLOSURES, FINAL, PATHS, format_final, format_paths, parse_final, parse_paths
from evalkit.results.seal import FILES, read_sealed, read_vouched, seal

LOCK = ".writer.lock"
STEPS = "steps.bin"
RESULT = "result.json"
SCORES = "scores.json"
GRID, ERRORS, FINAL_ERRORS, FIT = "grid.npz", "errors.npy", "final_errors.npy", "fit.npy"

_IN_FILES = ("steps", "final", "loop_closures", "path_corrections")
_RESULT_FIELDS = tuple(field.name for field in fields(RunResult) if field.name not in _IN_FILES)


class Store:
    """One experiment's results folder. Raises StoreError where a file cannot be written."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in ("", "runs", "trajectories", "maps"):
            create_folder(folder / name, folder)
        with as_store_error(folder), TemporaryFile(dir=folder / "runs"):  # can it be written?
            pass

    @classmethod
    def existing(cls, folder: Path) -> Store:
        """A store for reading only: creates nothing, so the folder may be an archive."""
        store = cls.__new__(cls)
        store.folder = folder
        return store

    @contextmanager
    def writer_lock(self) -> Iterator[None]:
        """Lock the folder against other writers. Raises StoreError if another process holds the lock, or none can."""
        path = self.folder / LOCK
        lock = FileLock(path)
        try:
            if path.is_symlink():
                raise FileExistsError(errno.EEXIST, "it is a symbolic link")
            lock.acquire(timeout=0)
        except Timeout as error:
            what = "another evalkit writes to this folder"
            raise StoreError(str(self.folder), what, "wait for it or name another folder") from error
        except (OSError, NotImplementedError) as error:  # a folder of this name, or a file system without locks
            remedy = "remove it, or name a folder on a local disk"
            raise StoreError(str(path), f"cannot be locked ({error})", remedy) from error
        try:
            yield
        finally:
            lock.release()

    def write(self, path: Path, content: bytes | str) -> None:
        """Write a file whole or not at all; no symbolic link below the results folder is followed."""
        write_bytes(path, content if isinstance(content, bytes) else content.encode(), self.folder)

    def run_folder(self, key: str) -> Path:
        """The folder of a run."""
        return self.folder / "runs" / key

    def create_run_folder(self, key: str) -> Path:
        """Create an empty folder for a run; deletes an existing one."""
        folder = self.run_folder(key)
        create_folder(folder.parent, self.folder)  # raises where a link would lead out of the results folder
        with as_store_error(folder):
            shutil.rmtree(folder, ignore_errors=True)
            if folder.is_symlink():
                folder.unlink()
            folder.mkdir()
        return folder

    @contextmanager
    def begin(self, key: str, attempts: Sequence[str]) -> Iterator[Path]:
        """Mark a run as started and create its folder. The mark stays only if this process dies in the block.

        ``attempts``: names of the processes that have started the run so far, with this one.
        """
        self.write(self._attempts_file(key), json.dumps(list(attempts)))
        try:
            yield self.create_run_folder(key)
        finally:
            self.clear_attempts(key)

    def attempts(self, key: str) -> tuple[str, ...]:
        """Names of the processes that started a run and died before its end."""
        try:
            content = untrusted_io.parse_json(untrusted_io.read_bytes(self._attempts_file(key)))
        except (OSError, ValueError):
            return ()
        return tuple(str(name) for name in content) if isinstance(content, list) else ()

    def clear_attempts(self, key: str) -> None:
        """Delete the list of processes that died: the run has ended or is quarantined."""
        file = self._attempts_file(key)
        with as_store_error(file):
            file.unlink(missing_ok=True)

    def _attempts_file(self, key: str) -> Path:
        return self.folder / "attempts" / f"{key}.json"

    def is_finished(self, key: str) -> bool:
        """Return whether a run has ended and its result is stored."""
        return (self.run_folder(key) / RESULT).is_file()

    def count_outdated(self, keys: Iterable[str]) -> int:
        """Return how many of the runs without a result have one under another digest: of other code or settings."""
        missing = [key.rpartition("-")[0] for key in keys if not self.is_finished(key)]
        if not missing or not (runs := self.folder / "runs").is_dir():
            return 0
        stored = {path.name.rpartition("-")[0] for path in runs.iterdir() if self.is_finished(path.name)}
        return sum(name in stored for name in missing)

    def is_newer_than_report(self, keys: Iterable[str]) -> bool:
        """Return whether the folder holds a report, and one of these runs ended or was scored after it."""
        try:
            written = (self.folder / "results.json").stat().st_mtime_ns
        except OSError:
            return False
        files = (self.run_folder(key) / name for key in keys for name in (RESULT, SCORES))
        return any(file.stat().st_mtime_ns > written for file in files if file.is_file())

    def save_result(self, spec: RunSpec, result: RunResult) -> None:
        """Write how a run went and its trajectory for other tools; ``RESULT``, written last, marks it as complete."""
        folder = self.run_folder(spec.key)
        steps = result.steps.tobytes()
        self.write(folder / STEPS, steps)  # again: durable, and without times where they do not count
        files = {STEPS: steps}
        text = format_tum(result.estimate, f"evalkit: {spec.method.label} on {spec.sequence.label}")
        self.write(self.folder / "trajectories" / f"{spec.key}.tum", text)
        if result.final is not None:
            files |= format_final(result.final, result.loop_closures)
            text = format_tum(result.final, f"evalkit: {spec.method.label} on {spec.sequence.label}, corrected poses")
            self.write(self.folder / "trajectories" / f"{spec.key}.final.tum", text)
        if result.path_corrections:
            files[PATHS] = format_paths(result.path_corrections, result.steps["stamp_ns"])
        for name in files.keys() - {STEPS}:
            self.write(folder / name, files[name])
        record: dict[str, Any] = {
            "method": spec.method.label, "sequence": spec.sequence.label, "seed": spec.seed, "status": result.status,
            "dataset_parameters": spec.dataset_parameters, "answered": len(result.steps),
            **{name: getattr(result, name) for name in _RESULT_FIELDS},
        }  # fmt: skip
        if result.conditions is not None:
            record["conditions"] = result.conditions.as_dict()
        if result.start is not None:
            record["start"] = result.start.as_dict()
        self.write(folder / RESULT, seal(record, files))
        self.clear_attempts(spec.key)

    def load_result(self, key: str) -> RunResult | None:
        """The stored result of a run; None where it is absent or damaged."""
        try:
            return self.read_result(key)
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            return None

    def read_result(self, key: str) -> RunResult:
        """The stored result of a run.

        Raises OSError, ValueError (with the name of a damaged file), TypeError, KeyError or AttributeError.
        """
        folder = self.run_folder(key)
        record = read_sealed(folder / RESULT)
        record = {"remarks": (), "paths_left_out": "", **record}  # not in results of earlier versions
        values: dict[str, Any] = {name: record[name] for name in _RESULT_FIELDS}
        values["remarks"] = tuple(map(str, values["remarks"]))
        values["cause"] = Cause(record["cause"])
        if (conditions := values["conditions"]) is not None:
            values["conditions"] = RunConditions(**{k: v for k, v in conditions.items() if k != DISTURBED})
        if values["start"] is not None:
            values["start"] = MapStart.of(values["start"])
        steps = whole_records(read_vouched(folder / STEPS, record))
        if (sound := count_sound(steps)) < len(steps):
            raise ValueError(f"{STEPS}: the stamp of record {sound} is not after the last one, or its pose not finite")
        if FINAL in record[FILES]:
            files = {name: read_vouched(folder / name, record) for name in (FINAL, CLOSURES)}
            values["final"], values["loop_closures"] = parse_final(files, steps["stamp_ns"])
        if PATHS in record[FILES]:
            values["path_corrections"] = parse_paths(read_vouched(folder / PATHS, record), steps["stamp_ns"])
        return RunResult(steps, **values)

    def save_scores(self, key: str, scores: Scores, fingerprint: str) -> None:
        """Write the scores of a run, and its map for map_server. ``fingerprint``: the scoring code and the mapper.

        ``SCORES``, written last, marks the others as complete.
        """
        folder = self.run_folder(key)
        grid = scores.grid
        create_folder(folder, self.folder)  # raises where it is a link: nothing elsewhere is removed
        with as_store_error(folder):
            of_map = (self.folder / "maps" / f"{key}{ending}" for ending in (".pgm", ".yaml"))
            for path in (*(folder / name for name in (SCORES, GRID, ERRORS, FINAL_ERRORS, FIT)), *of_map):
                path.unlink(missing_ok=True)
        files: dict[str, bytes] = {}
        if grid is not None:
            frame, body = [grid.resolution_m, grid.origin_x, grid.origin_y], BytesIO()
            np.savez_compressed(body, log_odds=grid.log_odds, observed=grid.observed, frame=frame)
            files[GRID] = body.getvalue()
            map_server.write_map(self.folder / "maps" / key, grid, self.folder, scores.map_from_start)
        final = scores.final
        final_errors = final.errors_m if final else None
        for name, array in ((ERRORS, scores.errors_m), (FINAL_ERRORS, final_errors), (FIT, scores.fit)):
            if array is not None:
                body = BytesIO()
                np.save(body, array)
                files[name] = body.getvalue()
        for name, raw in files.items():
            self.write(folder / name, raw)
        content = {
            "fingerprint": fingerprint,
            "world_from_start": scores.world_from_start.row.tolist(),
            "alignment": scores.alignment,
            "lost_at_s": scores.lost.at_s if scores.lost else None,
            "lost_reason": scores.lost.reason if scores.lost else "",
            "recovered_at_s": scores.lost.recovered_at_s if scores.lost else None,
            "final_world_from_start": final.world_from_start.row.tolist() if final else None,
            "final_alignment": final.alignment if final else "",
            "scores": {name: asdict(score) for name, score in scores.by_metric.items()},
        }
        self.write(folder / SCORES, seal(content, files))

    def load_scores(self, key: str, fingerprint: str = "") -> Scores | None:
        """The stored scores of a run; None where they are absent, damaged, or of another ``fingerprint`` (if given)."""
        folder = self.run_folder(key)
        try:
            content = read_sealed(folder / SCORES)
            if fingerprint and content["fingerprint"] != fingerprint:
                return None
            names = (GRID, ERRORS, FINAL_ERRORS, FIT)
            files = {name: read_vouched(folder / name, content) for name in names if name in content[FILES]}
            return Scores(
                {name: Score(**score) for name, score in content["scores"].items()},
                Pose.of(content["world_from_start"]),
                content["alignment"],
                _parse_grid(files[GRID]) if GRID in files else None,
                untrusted_io.parse_floats(files[ERRORS], 1) if ERRORS in files else None,
                parse_lost(content),
                _parse_alignment(content, files) if content["final_world_from_start"] is not None else None,
                untrusted_io.parse_floats(files[FIT], 2) if FIT in files else None,
            )
        except (OSError, ValueError, TypeError, KeyError, AttributeError, OverflowError):
            return None

    def load_score_values(self, key: str) -> dict[str, float | None]:
        """The values of a run's scores by metric; empty where there are none."""
        try:
            content = read_sealed(self.run_folder(key) / SCORES)
            return {name: score["value"] for name, score in content["scores"].items()}
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            return {}

    def discard_scores(self, key: str) -> None:
        """Delete the scores of a run, so that it is scored again."""
        create_folder(self.run_folder(key), self.folder)
        with as_store_error(self.run_folder(key)):
            (self.run_folder(key) / SCORES).unlink(missing_ok=True)


def whole_records(content: bytes) -> NDArray[np.void]:
    """The complete records in the bytes written so far (N,), without a last one that is cut short."""
    return np.frombuffer(content[: len(content) // STEP.itemsize * STEP.itemsize], dtype=STEP)


def count_sound(steps: NDArray[np.void]) -> int:
    """The number of records at the beginning whose stamps increase and whose poses are finite."""
    wrong = ~(np.isfinite(steps["x"]) & np.isfinite(steps["y"]) & np.isfinite(steps["theta"]))
    wrong[1:] |= steps["stamp_ns"][1:] <= steps["stamp_ns"][:-1]
    return int(wrong.argmax()) if wrong.any() else len(steps)


def hash_answers(result: RunResult) -> str:
    """SHA-256 of the stamps and poses of a run: equal hashes mean that two runs agree to the last bit."""
    hashed = hashlib.sha256(result.steps["stamp_ns"].astype("<i8").tobytes())
    for name in ("x", "y", "theta"):
        hashed.update(result.steps[name].astype("<f8").tobytes())
    return hashed.hexdigest()


def parse_lost(content: Mapping[str, Any]) -> LostTrack | None:
    """Return where a run lost the track, from its stored scores; None if it held it."""
    if content["lost_at_s"] is None:
        return None
    return LostTrack(content["lost_at_s"], content["lost_reason"], content["recovered_at_s"])


def _parse_alignment(content: dict[str, Any], files: dict[str, bytes]) -> FinalAlignment:
    errors = untrusted_io.parse_floats(files[FINAL_ERRORS], 1) if FINAL_ERRORS in files else None
    return FinalAlignment(Pose.of(content["final_world_from_start"]), content["final_alignment"], errors)


def _parse_grid(raw: bytes) -> OccupancyGrid:
    stored = untrusted_io.read_arrays(BytesIO(raw))
    resolution_m, origin_x, origin_y = stored["frame"].tolist()
    return OccupancyGrid(stored["log_odds"], stored["observed"], resolution_m, origin_x, origin_y)
