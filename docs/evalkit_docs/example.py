"""The tutorial's own comparison, made anew for every build: the report and the maps that the site shows."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

COMMANDS = (
    ("datasets", "example", "drive"),
    ("compare", "drive", "--reference", "drive.tum", "--backends", "paper,wheel-odometry", "--out", "results"),
)
"""What the tutorial types; a test holds them against it."""

EDGE = 12
"""Cells left around what was seen."""


def shown(results: Path | None) -> dict[str, bytes]:
    """What the site shows of a comparison, by the file's name: of the tutorial's own where no results are given."""
    if results is not None:
        return pictures(results) | report(results)
    with tempfile.TemporaryDirectory(prefix="evalkit-example-") as folder:
        return shown(made(Path(folder)))


def made(folder: Path) -> Path:
    """The results folder of the tutorial, made in an empty folder.

    RuntimeError with the program's own words where a command fails.
    """
    for words in COMMANDS:
        command = [sys.executable, "-c", "from evalkit.cli import main; main()", *words]
        ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if ended.returncode:
            raise RuntimeError(f"evalkit {' '.join(words)}: exit code {ended.returncode}: {ended.stderr}")
    return folder / "results"


def pictures(results: Path) -> dict[str, bytes]:
    """The map of each method as a PNG, by the file's name, cut to what was seen."""
    trials = json.loads((results / "results.json").read_text(encoding="utf-8"))["trials"]
    return {f"map-{trial['method']}.png": _map(results / "maps" / f"{trial['key']}.pgm") for trial in trials}


def report(results: Path) -> dict[str, bytes]:
    """The report, with all that its page leads to, by the file's name."""
    files = [*results.glob("*.*"), *results.glob("trajectories/*"), *results.glob("maps/*")]
    return {f"report/{file.relative_to(results).as_posix()}": file.read_bytes() for file in files if file.is_file()}


def _map(file: Path) -> bytes:
    with Image.open(file) as opened:
        grey = opened.convert("L")
    unseen = int(np.asarray(grey)[0, 0])
    seen = grey.point(lambda value: 0 if value == unseen else 255).getbbox()
    picture = ImageOps.expand(grey.crop(seen) if seen else grey, border=EDGE, fill=unseen)
    whole = io.BytesIO()
    picture.resize((3 * picture.width, 3 * picture.height), Image.Resampling.NEAREST).save(whole, "PNG", optimize=True)
    return whole.getvalue()
