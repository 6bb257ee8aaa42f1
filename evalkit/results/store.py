"""Results on disk: one folder a run, written as it goes, found again by its key.

runs/<key>/  request.json  steps.bin  outcome.json  output.txt     what the run left behind
             made.json  run.json                                   when, on what and under which limits; how it ended
             scores.json  grid.npz  errors.npy                     what the scoring made of it
trajectories/<key>.tum   maps/<key>.pgm  maps/<key>.yaml           for other tools
tries/<key>.json             who was lost while the run was made, until it has ended
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout
from numpy.typing import NDArray

from evalkit.config.experiment import RunSpec
from evalkit.core.errors import StoreError
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, Cause, RunResult, Score, Scores
from evalkit.io import untrusted_io
from evalkit.io.tum import format_tum

LOCK = ".writer.lock"
STEPS = "steps.bin"
RESULT = "result.json"
SCORES = "scores.json"

_RESULT_FIELDS = tuple(field.name for field in fields(RunResult) if field.name != "steps")

REMEDY = "free some space or name another folder with --out"


class Store:
    """One experiment's results folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        with reported(folder):
            for name in ("runs", "trajectories", "maps"):
                (folder / name).mkdir(parents=True, exist_ok=True)
            probe = folder / "runs" / f".writable-{os.getpid()}"
            probe.write_text("", encoding="utf-8")
            probe.unlink(missing_ok=True)

    @classmethod
    def existing(cls, folder: Path) -> Store:
        """A folder that is only read: nothing is made in it, so it may be an archive."""
        store = cls.__new__(cls)
        store.folder = folder
        return store

    @contextmanager
    def writer(self) -> Iterator[None]:
        """While it lasts nobody else makes runs in this folder; StoreError where somebody does already."""
        lock = FileLock(self.folder / LOCK)
        try:
            with lock.acquire(timeout=0):
                yield
        except Timeout as error:
            what = "another evalkit makes runs in this folder"
            raise StoreError(str(self.folder), what, "wait for it or name another folder with --out") from error

    def run_folder(self, key: str) -> Path:
        """Where a run keeps its files."""
        return self.folder / "runs" / key

    def fresh(self, key: str) -> Path:
        """An empty folder for a run about to start."""
        folder = self.run_folder(key)
        with reported(folder):
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        return folder

    def write_text(self, path: Path, text: str) -> None:
        """Writes a file whole or not at all."""
        self.write_bytes(path, text.encode())

    def write_bytes(self, path: Path, content: bytes) -> None:
        """Writes a file whole or not at all."""
        partial = path.with_name(path.name + ".part")
        with reported(path):
            path.parent.mkdir(parents=True, exist_ok=True)  # a back end may have removed it
            partial.write_bytes(content)
            partial.replace(path)

    def save_result(self, spec: RunSpec, result: RunResult) -> None:
        """Write how a run went, and its trajectory for other tools."""
        folder = self.run_folder(spec.key)
        steps = folder / STEPS
        if not steps.exists() or read_steps(steps).tobytes() != result.steps.tobytes():  # removed, or times left out
            self.write_bytes(steps, result.steps.tobytes())
        record = {
            "method": spec.method.label, "sequence": spec.sequence.label, "seed": spec.seed, "status": result.status,
            "answered": len(result.steps), **{name: getattr(result, name) for name in _RESULT_FIELDS},
        }  # fmt: skip
        self.write_text(folder / RESULT, json.dumps(record, indent=1))
        text = format_tum(result.estimate, f"evalkit: {spec.method.label} on {spec.sequence.label}")
        self.write_text(self.folder / "trajectories" / f"{spec.key}.tum", text)

    def load_result(self, key: str) -> RunResult | None:
        """The result of a stored run; None where there is none, or where it is damaged: it is run again."""
        folder = self.run_folder(key)
        try:
            record = untrusted_io.parse_json((folder / RESULT).read_bytes())
            steps = read_steps(folder / STEPS)
            if record["answered"] != len(steps):
                return None
            values = {name: record[name] for name in _RESULT_FIELDS} | {"cause": Cause(record["cause"])}
            return RunResult(steps, **values)
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            return None

    def forget(self, key: str, *names: str) -> None:
        """Removes files of a run ("run.json", "scores.json"): it is made or scored again."""
        with reported(self.run_folder(key)):
            for name in names:
                (self.run_folder(key) / name).unlink(missing_ok=True)

    def tries(self, key: str) -> list[str]:
        """Who was lost while the run was made, and has not told how it ended."""
        try:
            content = untrusted_io.parse_json(self._tries(key).read_bytes())
        except (OSError, ValueError):
            return []
        return [str(who) for who in content] if isinstance(content, list) else []

    def note_tries(self, key: str, who: list[str]) -> None:
        """Keeps who has tried a run, up to the one that does now."""
        self.write_text(self._tries(key), json.dumps(who))

    def forget_tries(self, key: str) -> None:
        """The run has ended by itself, or is given up."""
        with reported(self._tries(key)):
            self._tries(key).unlink(missing_ok=True)

    def _tries(self, key: str) -> Path:
        return self.folder / "tries" / f"{key}.json"

    def save_scores(self, key: str, scores: Scores, fingerprint: str) -> None:
        """Write the scores of a run, and its map for map_server. ``fingerprint``: the scoring code and the mapper."""
        folder = self.run_folder(key)
        grid = scores.grid
        with reported(folder):
            for name in (SCORES, "grid.npz", "errors.npy"):  # SCORES is removed first and written last: it vouches
                (folder / name).unlink(missing_ok=True)
            if grid is not None:
                np.savez_compressed(folder / "grid.npz", log_odds=grid.log_odds, observed=grid.observed,
                                    frame=[grid.resolution_m, grid.origin_x, grid.origin_y])  # fmt: skip
                self.write_map(self.folder / "maps" / key, grid)
            else:  # remove the map of an earlier run
                for ending in (".pgm", ".yaml"):
                    (self.folder / "maps" / f"{key}{ending}").unlink(missing_ok=True)
            if scores.errors_m is not None:
                np.save(folder / "errors.npy", scores.errors_m)
        content = {
            "fingerprint": fingerprint,
            "world_from_start": scores.world_from_start.row.tolist(),
            "alignment": scores.alignment,
            "scores": {name: asdict(score) for name, score in scores.by_metric.items()},
        }
        self.write_text(folder / SCORES, json.dumps(content, indent=1))

    def scored_by(self, key: str) -> str | None:
        """The fingerprint of the stored scores of a run; None where there are none."""
        return self._scores(key).get("fingerprint")

    def score_values(self, key: str) -> dict[str, float | None]:
        """The values of a run's scores; empty where there are none."""
        return {name: score["value"] for name, score in self._scores(key).get("scores", {}).items()}

    def _scores(self, key: str) -> dict[str, Any]:
        try:
            content = untrusted_io.parse_json((self.run_folder(key) / SCORES).read_bytes())
        except (OSError, ValueError):
            return {}
        return content if isinstance(content, dict) else {}

    def load_scores(self, key: str) -> Scores | None:
        """The scores of a stored run; None where there are none, or where they are damaged."""
        folder = self.run_folder(key)
        try:
            content = untrusted_io.parse_json((folder / SCORES).read_bytes())
            return Scores(
                {name: Score(**score) for name, score in content["scores"].items()},
                Pose.of(content["world_from_start"]),
                content["alignment"],
                _load_grid(folder / "grid.npz"),
                untrusted_io.read_array(folder / "errors.npy") if (folder / "errors.npy").exists() else None,
            )
        except (OSError, ValueError, TypeError, KeyError, AttributeError, OverflowError):
            return None

    def write_map(self, stem: Path, grid: OccupancyGrid) -> None:
        """A map_server map: PGM (row 0 on top; 254 free, 0 occupied, 205 unknown) and YAML with every digit."""
        pixels = np.full(grid.shape, 205, dtype=np.uint8)
        pixels[grid.free()], pixels[grid.occupied()] = 254, 0
        rows, columns = grid.shape
        size, x, y = (float(value) for value in (grid.resolution_m, grid.origin_x, grid.origin_y))  # no numpy in repr
        self.write_bytes(
            stem.with_name(stem.name + ".pgm"), b"P5\n%d %d\n255\n" % (columns, rows) + pixels[::-1].tobytes()
        )
        self.write_text(
            stem.with_name(stem.name + ".yaml"),
            f"image: {stem.name}.pgm\nmode: trinary\nresolution: {size!r}\n"
            f"origin: [{x!r}, {y!r}, 0.0]\nnegate: 0\n"
            "occupied_thresh: 0.65\nfree_thresh: 0.196\n",
        )


def read_steps(path: Path) -> NDArray[np.void]:
    """The whole records of a steps file (N,); a record cut short by the process's end is left out."""
    if not path.exists():
        return np.zeros(0, dtype=STEP)
    return whole_records(path.read_bytes())


def whole_records(content: bytes) -> NDArray[np.void]:
    """The records of what was written up to now (N,); one cut short is left out."""
    return np.frombuffer(content[: len(content) // STEP.itemsize * STEP.itemsize], dtype=STEP)


def digest(run: RunResult) -> str:
    """What a run answered, as SHA-256 of its stamps and poses: two runs with one digest agree to the last bit."""
    hashed = hashlib.sha256(run.steps["stamp_ns"].astype("<i8").tobytes())
    for name in ("x", "y", "theta"):
        hashed.update(run.steps[name].astype("<f8").tobytes())
    return hashed.hexdigest()


def _load_grid(path: Path) -> OccupancyGrid | None:
    if not path.exists():
        return None
    kept = untrusted_io.read_arrays(path)
    resolution_m, origin_x, origin_y = kept["frame"].tolist()
    return OccupancyGrid(kept["log_odds"], kept["observed"], resolution_m, origin_x, origin_y)


def write_texts(folder: Path, texts: Mapping[str, str]) -> None:
    """Writes files by name into a folder, which is made; StoreError where that is not possible."""
    with reported(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")


@contextmanager
def reported(path: Path) -> Iterator[None]:
    """StoreError naming the path where the system cannot write there."""
    try:
        yield
    except OSError as error:
        raise StoreError(str(path), f"cannot be written ({error.strerror or error})", REMEDY) from error
