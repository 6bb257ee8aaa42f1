"""The comparison of the tutorial, run for every build: the report and the maps that the site shows."""

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
    ("compare", "drive", "--backends", "paper,wheel-odometry", "--out", "results"),
)
"""The commands of the tutorial; a test compares them with the page."""

EDGE = 12
"""Width of the border around the observed cells, in cells."""


def load_files(results: Path | None) -> dict[str, bytes]:
    """Return the files of a comparison that the site shows, by name; without results, run the tutorial's."""
    if results is not None:
        return render_maps(results) | load_report(results)
    with tempfile.TemporaryDirectory(prefix="evalkit-example-") as folder:
        return load_files(run_tutorial(Path(folder)))


def run_tutorial(folder: Path) -> Path:
    """Run the commands of the tutorial in an empty folder; return the results folder.

    Raises RuntimeError with the error output of a command that fails.
    """
    for words in COMMANDS:
        command = [sys.executable, "-c", "from evalkit.cli import main; main()", *words]
        ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if ended.returncode:
            raise RuntimeError(f"evalkit {' '.join(words)}: exit code {ended.returncode}: {ended.stderr}")
    return folder / "results"


def render_maps(results: Path) -> dict[str, bytes]:
    """Return the map of each method as a PNG, by file name, cropped to the observed cells."""
    runs = json.loads((results / "results.json").read_text(encoding="utf-8"))["runs"]
    return {f"map-{run['method']}.png": _render_map(results / "maps" / f"{run['key']}.pgm") for run in runs}


def load_report(results: Path) -> dict[str, bytes]:
    """Return the files of the report and the files that its page links to, by file name."""
    files = [*results.glob("*.*"), *results.glob("trajectories/*"), *results.glob("maps/*")]
    return {f"report/{file.relative_to(results).as_posix()}": file.read_bytes() for file in files if file.is_file()}


def _render_map(file: Path) -> bytes:
    with Image.open(file) as opened:
        grey = opened.convert("L")
    unobserved = int(np.asarray(grey)[0, 0])
    box = grey.point(lambda value: 0 if value == unobserved else 255).getbbox()
    image = ImageOps.expand(grey.crop(box) if box else grey, border=EDGE, fill=unobserved)
    content = io.BytesIO()
    image.resize((3 * image.width, 3 * image.height), Image.Resampling.NEAREST).save(content, "PNG", optimize=True)
    return content.getvalue()
