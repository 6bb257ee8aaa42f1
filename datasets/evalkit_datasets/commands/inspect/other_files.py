"""Identify a file without scans by its content, and name the command that uses it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np

from evalkit.core.errors import brief
from evalkit.io.g2o import read_g2o
from evalkit.io.text_lines import is_number, iter_lines, iter_plain_blocks
from evalkit_datasets.parsing.columns_layout import DECIMAL_COMMA, has_decimal_comma, split_columns

EXPECTED = "a recording"
LINES, BYTES = 200, 4096
PNG = b"\x89PNG\r\n\x1a\n"
MIN_TRAJECTORY_COLUMNS = 4
READERS = (
    "give a bag (.bag, .mcap, .db3 or its folder), a CARMEN log, a text log or a folder of .pcd or .ply files; "
    "--reader NAME decides between readers, and evalkit list datasets names them, those of plug-ins too"
)
ONE_LINE = "write one line per scan, 'time range1 range2 ...', and propose its layout: evalkit inspect LOG.txt"
MIN_WORDS, MAX_ODD = 20, 4
"""Fewest columns of a line with a scan, and most texts between its numbers."""

GRAPH = (b"VERTEX_SE2", b"VERTEX2", b"EDGE_SE2", b"EDGE2", b"VERTEX_SE3:QUAT", b"EDGE_SE3:QUAT")

BY_SUFFIX = {
    ".tum": ("a trajectory", "use it with its recording: evalkit compare RECORDING --ground-truth {file}"),
    ".relations": ("relations", "use them with their recording: evalkit compare RECORDING --relations {file}"),
    ".toml": ("a TOML file", "run an experiment: evalkit compare {file}; use measured distances with their recording: "
              "evalkit compare RECORDING --spans {file}"),
    ".yaml": ("a description of a map", "compare a map: evalkit compare RECORDING --backends file:{file}"),
    ".pgm": ("the image of a map", "compare a map by its .yaml: evalkit compare RECORDING --backends file:MAP.yaml"),
}  # fmt: skip
"""What a file is and how it is used, by suffix; ``{file}`` is its path."""


def describe_other_file(path: Path) -> tuple[str, str]:
    """Return what a file without scans is, and what to do with it. Raises BadData for damaged gzip."""
    file = shlex.quote(str(path))
    if path.name == "metadata.yaml":
        return (
            "it describes a ROS 2 bag",
            f"give the folder of the bag: evalkit inspect {shlex.quote(str(path.parent))}",
        )
    if path.suffix in BY_SUFFIX:
        kind, remedy = BY_SUFFIX[path.suffix]
        return f"it is {kind}, no recording", remedy.format(file=file)
    begin = next(iter(iter_plain_blocks(path, EXPECTED)), b"")[:BYTES]
    if not begin.strip():
        return "the file is empty", "record or fetch it again"
    if b"\0" in begin or sum(byte > 0x7E for byte in begin) > len(begin) // 10:
        kind, remedy = BY_SUFFIX[".pgm"]
        image = begin.startswith(PNG)
        return (f"it is {kind}, no recording", remedy) if image else ("binary data of an unknown format", READERS)
    if begin.lstrip()[:1] in (b"{", b"["):
        return "JSON, for which there is no reader", ONE_LINE
    return _describe_text(path)


def _describe_text(path: Path) -> tuple[str, str]:
    lines = [line.split() for line in islice(iter_lines(path, EXPECTED), LINES)]
    if any(words and words[0] in GRAPH for words in lines):
        return _describe_graph(path)
    if any(map(has_decimal_comma, islice(iter_lines(path, EXPECTED), LINES))):
        what, remedy = DECIMAL_COMMA
        return what, remedy.format(file=shlex.quote(str(path)))
    rows = [split_columns(line) for line in islice(iter_lines(path, EXPECTED), LINES)]
    numeric = [words for words in rows if words and all(map(is_number, words))]
    layout = f"describe its columns in {path.name}.toml (tables [time] and [scan], see docs/pages/text-log.md)"
    if odd := _find_odd_words(rows):
        what = f"its lines hold numbers and texts such as {brief(odd[0])}"
        return what, f"write numbers alone (a time in s or ms, ranges without brackets), or {layout}"
    if len(numeric) > LINES // 4 and min(map(len, numeric)) < MIN_TRAJECTORY_COLUMNS:
        return f"text of {min(map(len, numeric))} columns of numbers: too few for a scan a line", ONE_LINE
    if len(numeric) > LINES // 4:
        what = f"text of {len(numeric[0])} columns of numbers without ranges that were recognised"
        return (
            what,
            f"{layout}; poses alone are a ground truth, as TUM: evalkit compare RECORDING --ground-truth FILE.tum",
        )
    return (
        "text in which no line begins with FLASER, ROBOTLASER1, RAWLASER1, LASER3 to LASER5, LASER_READING or ODOM",
        f"{layout}, or {READERS}",
    )


def _find_odd_words(rows: Sequence[Sequence[bytes]]) -> list[str]:
    """Return the words that are no numbers in lines with many numbers, if these are a quarter of the lines or more.

    A line that begins with a name, as those of CARMEN, is none of them.
    """
    long = (words for words in rows if len(words) >= MIN_WORDS and not words[0][:1].isalpha())
    odd = ([word for word in words if not is_number(word)] for words in long)
    few = [words for words in odd if 0 < len(words) <= MAX_ODD]
    return [word.decode(errors="replace") for words in few for word in words] if len(few) > len(rows) // 4 else []


def _describe_graph(path: Path) -> tuple[str, str]:
    """Raise BadData for a graph that is not planar."""
    file = read_g2o(path)
    graph, ranks = file.graph, np.argsort(np.argsort(file.ids))
    loops = int((np.abs(ranks[graph.second] - ranks[graph.first]) > 1).sum())
    what = (
        f"a pose graph (g2o) without scans: {len(graph):,} poses, {len(graph.first):,} edges, {loops:,} of them loops, "
        f"chi-square {graph.chi_squares().sum():.8g}"
    )
    return what, f"optimise it: python -m evalkit_baselines.slam {shlex.quote(str(path))} OPTIMISED.g2o"
