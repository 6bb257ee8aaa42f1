"""Export each run's errors as the result file of evo: a zip that ``evo_res`` opens and compares."""

from __future__ import annotations

import io
import json
import zipfile

import numpy as np

from evalkit.commands.export.latex import Files
from evalkit.commands.export.results import ExportSelection
from evalkit.core.se2 import Floats, Stamps
from evalkit.io.tum import format_tum
from evalkit.results.run_record import RunRecord

TITLE = "APE w.r.t. translation part (m)\n(aligned by evalkit)"
MEMBER_TIME = (1980, 1, 1, 0, 0, 0)
"""Time of every file in an archive: equal runs give equal bytes."""


def format_evo(results: ExportSelection) -> Files:
    """Yield ``<run>.zip`` of every run with a ground-truth trajectory.

    It holds the distance to the ground truth (m) of every scan that has one, after the alignment of the report, the
    statistics of evo over them, and the estimated trajectory.
    """
    for run in results.runs:
        errors = run.scores.errors_m
        if errors is not None and np.isfinite(errors).any():
            yield f"{run.key}.zip", _archive(run, np.asarray(errors, dtype=np.float64))


def _archive(run: RunRecord, errors: Floats) -> bytes:
    known = np.isfinite(errors)
    stamps: Stamps = run.result.steps["stamp_ns"][known]
    seconds = stamps * 1e-9
    arrays = {"error_array": errors[known], "timestamps": seconds, "seconds_from_start": (stamps - stamps[0]) * 1e-9}
    info = {"title": TITLE, "label": "APE (m)", "ref_name": "ground truth", "est_name": f"{run.method}, {run.sequence}"}
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in (("info.json", json.dumps(info)), ("stats.json", json.dumps(_statistics(errors[known])))):
            archive.writestr(zipfile.ZipInfo(name, MEMBER_TIME), text)
        for name, values in arrays.items():
            member = io.BytesIO()
            np.save(member, values)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", MEMBER_TIME), member.getvalue())
        estimate = run.result.estimate.moved(run.scores.world_from_start, "world")
        archive.writestr(zipfile.ZipInfo("estimate.tum", MEMBER_TIME), format_tum(estimate))
    return content.getvalue()


def _statistics(errors: Floats) -> dict[str, float]:
    squared = errors**2
    values = {
        "rmse": np.sqrt(squared.mean()), "mean": errors.mean(), "median": np.median(errors), "std": errors.std(),
        "min": errors.min(), "max": errors.max(), "sse": squared.sum(),
    }  # fmt: skip
    return {name: float(value) for name, value in values.items()}
