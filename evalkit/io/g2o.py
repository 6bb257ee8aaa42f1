"""Read and write pose graphs of the plane in g2o format, and read TORO's, which g2o grew from.

==========  =========================================  ==================================================
line        g2o                                        TORO
==========  =========================================  ==================================================
pose        ``VERTEX_SE2 id x y theta``                ``VERTEX2 id x y theta``
edge        ``EDGE_SE2 i j x y theta`` and             ``EDGE2 i j x y theta`` and
            I11 I12 I13 I22 I23 I33                    I11 I12 I22 I33 I13 I23: another order
fixed pose  ``FIX id ...``                             none
==========  =========================================  ==================================================

Metres, radians; i and j are the numbers of the poses, and the motion is ``i_from_j``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints, freeze
from evalkit.core.errors import BadData, brief
from evalkit.core.pose import MAX_COORDINATE_M
from evalkit.core.pose_graph import PoseGraph
from evalkit.core.se2 import Floats
from evalkit.io.text_lines import iter_lines, parse_numbers

POSE, EDGE = ("VERTEX_SE2", "VERTEX2"), ("EDGE_SE2", "EDGE2")
POSE_LAYOUT = "id x y theta"
EDGE_LAYOUT = "i j x y theta and six numbers of the information matrix"
REMEDY = "give a planar pose graph in g2o format"

_G2O_ORDER = (0, 1, 2, 1, 3, 4, 2, 4, 5)
"""Place of each element of the information matrix (row by row) among the six numbers of a line."""
_TORO_ORDER = (0, 1, 4, 1, 2, 5, 4, 5, 3)

MAX_INFORMATION = 1e15
MAX_ID = 2**62


@dataclass(frozen=True, eq=False)
class G2oFile:
    """A pose graph, the numbers ``ids`` (N,) of its poses, the rows that are ``fixed``, and defects by name.

    ``chained``: poses that the file does not give; they are chained from others along the edges, in order of the file.
    """

    graph: PoseGraph
    ids: Ints
    fixed: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    chained: int = 0

    def __post_init__(self) -> None:
        freeze(self, "ids", self.ids, (len(self.graph),), np.int64)
        freeze(self, "fixed", self.fixed, (None,), np.int64)


@dataclass
class _Lines:
    """The contents of a file so far: poses by number, edges, fixed numbers."""

    poses: dict[int, list[float]] = field(default_factory=dict)
    pairs: list[tuple[int, int]] = field(default_factory=list)
    motions: list[list[float]] = field(default_factory=list)
    information: list[list[float]] = field(default_factory=list)
    fixed: list[int] = field(default_factory=list)


def read_g2o(path: Path) -> G2oFile:
    """Return the pose graph of a file, plain or gzip; poses in the order of the file, then those without a line.

    Raises DataMissing if there is no such file and BadData, with the line, for one that is not a planar pose graph: an
    unknown kind of line (3D, landmarks), a number that is not finite, a pose given twice, an edge from a pose to
    itself, an information matrix with a negative eigenvalue, a part of the graph without a pose to chain from.
    """
    found = _Lines()
    for number, line in enumerate(iter_lines(path, "a planar pose graph in g2o format"), start=1):
        words = line.split(b"#", 1)[0].decode("utf-8", "replace").split()
        if words:
            _read_line(path, number, words, found)
    if not found.pairs and not found.poses:
        raise BadData(str(path), "", "no pose and no edge in it", REMEDY)
    rows, chained = _all_poses(path, found)
    place = {node: row for row, node in enumerate(rows)}
    for node in found.fixed:
        if node not in place:
            raise BadData(str(path), "", f"FIX names pose {node}, which is not in the file", "remove the line")
    pairs = np.array([(place[i], place[j]) for i, j in found.pairs], dtype=np.int64).reshape(-1, 2)
    information = np.array(found.information).reshape(-1, 3, 3)
    _check_information(path, found, information)
    graph = PoseGraph(
        np.array(list(rows.values())).reshape(-1, 3), pairs[:, 0], pairs[:, 1], np.array(found.motions), information
    )
    fixed = np.array([place[node] for node in found.fixed], dtype=np.int64)
    return G2oFile(graph, np.array(list(rows), dtype=np.int64), fixed, chained)


def format_g2o(graph: PoseGraph, ids: Iterable[int] | None = None, fixed: Sequence[int] = (0,)) -> str:
    """Return a pose graph as g2o text; ``ids``: numbers of the poses, by default their rows; ``fixed``: fixed rows."""
    names = list(range(len(graph))) if ids is None else [int(each) for each in ids]
    lines = [f"VERTEX_SE2 {name} {_join(row)}" for name, row in zip(names, graph.poses.tolist(), strict=True)]
    lines += [f"FIX {names[row]}" for row in fixed if row < len(names)]
    upper = graph.information[:, *np.triu_indices(3)].tolist()
    edges = zip(graph.first.tolist(), graph.second.tolist(), graph.first_from_second.tolist(), upper, strict=True)
    lines += [f"EDGE_SE2 {names[i]} {names[j]} {_join(motion)} {_join(matrix)}" for i, j, motion, matrix in edges]
    return "\n".join(lines) + "\n"


def _read_line(path: Path, line: int, words: list[str], found: _Lines) -> None:
    kind, place = words[0], f"line {line}"
    if kind in POSE:
        (node,) = _ids(path, line, words[1:2] or [""])
        pose = _numbers(path, line, words[2:], 3, POSE_LAYOUT)
        if node in found.poses:
            raise BadData(str(path), place, f"pose {node} is given a second time", "remove one of them")
        found.poses[node] = pose
    elif kind in EDGE:
        i, j = _ids(path, line, [*words[1:3], "", ""][:2])
        values = _numbers(path, line, words[3:], 9, EDGE_LAYOUT)
        if i == j:
            raise BadData(str(path), place, f"an edge from pose {i} to itself", "remove it")
        order = _G2O_ORDER if kind == EDGE[0] else _TORO_ORDER
        if not max(map(abs, values[3:])) <= MAX_INFORMATION:
            raise BadData(str(path), place, f"information above {MAX_INFORMATION:g}", REMEDY)
        found.pairs.append((i, j))
        found.motions.append(values[:3])
        found.information.append([values[3 + at] for at in order])
    elif kind == "FIX":
        found.fixed += _ids(path, line, words[1:] or [""])
    else:
        raise BadData(
            str(path), place, f"a line of kind {brief(kind)}", f"{REMEDY}: {', '.join((*POSE, *EDGE, 'FIX'))}"
        )


def _ids(path: Path, line: int, words: list[str]) -> list[int]:
    values = []
    for word in words:
        if not (word.isascii() and word.removeprefix("-").isdigit() and len(word) < 20 and abs(int(word)) <= MAX_ID):
            found = f"{brief(word)} is not the number of a pose"
            raise BadData(str(path), f"line {line}", found, f"expected '{POSE_LAYOUT}' or '{EDGE_LAYOUT}'")
        values.append(int(word))
    return values


def _numbers(path: Path, line: int, words: list[str], wanted: int, layout: str) -> list[float]:
    if len(words) != wanted:
        found = f"{len(words)} numbers after the pose numbers, not {wanted}"
        raise BadData(str(path), f"line {line}", found, f"expected '{layout}'")
    values = parse_numbers(path, line, words, layout)
    if not np.isfinite(values).all() or max(map(abs, values[:2])) > MAX_COORDINATE_M:
        found = f"a value is not finite or a length above {MAX_COORDINATE_M:g} m"
        raise BadData(str(path), f"line {line}", found, f"expected '{layout}'")
    values[2] = float(se2.wrap(values[2]))
    return values


def _check_information(path: Path, found: _Lines, information: Floats) -> None:
    if not len(information):
        return
    smallest, largest = np.linalg.eigvalsh(information)[:, [0, -1]].T
    bad = np.flatnonzero((smallest < -1e-9 * np.abs(largest)) | (largest <= 0.0))
    if len(bad):
        i, j = found.pairs[bad[0]]
        what = f"an information matrix that is not positive: eigenvalues {smallest[bad[0]]:g} to {largest[bad[0]]:g}"
        raise BadData(str(path), f"edge {i} {j}", what, "EDGE_SE2 lists I11 I12 I13 I22 I23 I33, EDGE2 another order")


def _all_poses(path: Path, found: _Lines) -> tuple[dict[int, list[float]], int]:
    """Return all poses by number, with those that have no line chained along edges, and the number of these.

    A file without any pose starts at the first pose of its first edge, which is the identity.
    """
    rows = dict(found.poses)
    missing = [node for node in dict.fromkeys(n for pair in found.pairs for n in pair) if node not in rows]
    if not missing:
        return rows, 0
    neighbours: dict[int, list[tuple[int, Floats]]] = {}
    for (i, j), motion in zip(found.pairs, found.motions, strict=True):
        neighbours.setdefault(i, []).append((j, np.array(motion)))
        neighbours.setdefault(j, []).append((i, se2.inverse(motion)))
    if not rows:
        rows[missing[0]] = [0.0, 0.0, 0.0]
    queue = list(rows)
    for node in queue:  # grows while it is read: breadth first
        for other, step in neighbours.get(node, ()):
            if other not in rows:
                rows[other] = se2.compose(rows[node], step).tolist()
                queue.append(other)
    lost = next((node for node in missing if node not in rows), None)
    if lost is not None:
        raise BadData(str(path), "", f"no edge connects pose {lost} with a given pose", "add a VERTEX_SE2 line for it")
    return rows, len(missing)


def _join(row: list[float]) -> str:
    return " ".join(f"{value:.12g}" for value in row)
