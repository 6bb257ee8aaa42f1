"""Optimise a pose graph in g2o format: ``python -m evalkit_baselines.slam GRAPH.g2o [OPTIMISED.g2o]``."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from evalkit.core.errors import BadData, EvalkitError
from evalkit.io.g2o import format_g2o, read_g2o
from evalkit.io.output_files import write_named_file
from evalkit_baselines.slam.pose_graph import free_nodes, optimise, start_from_linear_angles


def main(words: list[str] | None = None) -> None:
    """Print the chi-square before and after, and write the optimised graph where a path is given."""
    parser = argparse.ArgumentParser("evalkit_baselines.slam", description=__doc__)
    parser.add_argument("graph", type=Path)
    parser.add_argument("optimised", type=Path, nargs="?")
    arguments = parser.parse_args(words)
    try:
        file = read_g2o(arguments.graph)
        if set(file.fixed.tolist()) - {0}:
            what = f"it fixes the poses {', '.join(map(str, file.ids[file.fixed][:5]))}"
            raise BadData(str(arguments.graph), "", what, "fix its first pose, which this solver fixes")
        before = float(file.graph.chi_squares().sum())
        solution = optimise(start_from_linear_angles(file.graph))
        if arguments.optimised is not None:
            write_named_file(arguments.optimised, format_g2o(solution.graph, file.ids))
    except EvalkitError as error:
        parser.error(str(error))
    ended = "converged" if solution.converged else "not converged"
    if apart := len(file.graph) - 1 - len(free_nodes(file.graph)):
        ended += f"; {apart} of {len(file.graph)} poses did not move: no edges connect them with the first one"
    sys.stdout.write(
        f"{arguments.graph}: chi-square {before:.8g} before, {solution.chi_square:.8g} after "
        f"{solution.iterations} iterations from linear angles, {ended}\n"
    )


if __name__ == "__main__":
    main()
