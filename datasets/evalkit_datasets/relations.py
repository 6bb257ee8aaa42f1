"""Relations of Kuemmerle et al. 2009: measured motions between pairs of times, one a line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from evalkit.core.errors import BadData
from evalkit.core.ground_truth import Relations
from evalkit.io.text_lines import iter_rows, parse_numbers
from evalkit.io.timestamps import parse_stamp_ns

LAYOUT = "t1 t2 x y z roll pitch yaw"


def read(path: Path) -> Relations:
    """The relations in the order of the file: pose of the robot at t2 in its frame at t1, m and rad.

    Lines are neither sorted nor thinned: t2 before t1 and repeated pairs are part of the published files.
    """
    first, second, motions = [], [], []
    for line, words in iter_rows(path, LAYOUT, f"a file of relations ({LAYOUT})"):
        try:
            first.append(parse_stamp_ns(words[0]))
            second.append(parse_stamp_ns(words[1]))
        except ValueError as error:
            raise BadData(str(path), f"line {line}", str(error), f"expected '{LAYOUT}'") from None
        x, y, *rest = values = parse_numbers(path, line, words[2:], LAYOUT)
        if not np.isfinite(values).all():
            raise BadData(str(path), f"line {line}", "a value is not finite", "take the relation out of the file")
        motions.append((x, y, rest[-1]))
    if not motions:
        raise BadData(str(path), "", "no relation in it", f"expected lines '{LAYOUT}'")
    return Relations(np.array(first), np.array(second), np.array(motions))
