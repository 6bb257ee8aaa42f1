"""The core's ICP as a Registration."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from evalkit.core.match import Iteration, Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.timing import Cost, Stopwatch
from evalkit.plugins.parameters import Parameter
from evalkit_baselines.embedded.compiled import Precision, load_core, to_real
from evalkit_baselines.embedded.normals import MAX_NEIGHBOURS
from evalkit_baselines.paper import icp
from evalkit_baselines.paper.association import CloudCache

ERRORS = ("mean", "mean-squared", "rmse")  # in the order of ek_error_measure

TRACE = "record every iteration with its pairs (costs more than the registration)"

PARAMETERS: tuple[Parameter, ...] = tuple(
    replace(p, meaning=TRACE)
    if p.name == "trace"
    else replace(p, high=MAX_NEIGHBOURS)
    if p.name == "line_neighbours"
    else p
    for p in icp.PARAMETERS
)
"""The parameters of the NumPy ICP."""


class CompiledIcp:
    """A Registration; parameters as in ``PARAMETERS``.

    The indices of recent targets are kept, found by the identity of their (frozen) clouds. ``history`` is empty without
    ``trace``. Raises ValueError with the core's message for a coordinate beyond 1,000 km.
    """

    def __init__(self, precision: Precision, **parameters: Any) -> None:
        self._core = load_core(precision)
        self._icp = make_icp(self._core, parameters)
        self._min_pairs = parameters["min_pairs"]
        self._squared = parameters["error"] == "mean-squared"
        self._trace = parameters["trace"]
        self._neighbours = parameters["line_neighbours"] if parameters["metric"] == "line" else 0
        self._recent: CloudCache[Any] = CloudCache()

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``; with too few pairs the guess, not converged, with error nan."""
        if not len(target) or not len(source):
            return Match.not_converged(guess)
        conversion = Stopwatch()
        index = self._recent.get(target, lambda cloud: self._index(cloud, conversion))
        with conversion:
            points = to_real(source.points, self._core)
            origin = None if source.origin is None else (source.origin[0], source.origin[1])
        row, converged, iterations, error, inliers, history = self._icp.register(
            index, points, (guess.x, guess.y, guess.theta), self._trace, origin=origin
        )
        with conversion:
            trace = tuple(self._iteration(*one) for one in history)
            answer = guess if inliers < self._min_pairs else Pose(*row)  # bit-identical, in single precision too
        return Match(answer, converged, iterations, error, inliers, trace, Cost(conversion.cpu_ns))

    def _index(self, target: Cloud, conversion: Stopwatch) -> Any:
        with conversion:
            points = to_real(target.points, self._core)
            support = target.support
            if support is not None:  # the core has 32 bits, and counts no more than this
                support = np.minimum(support, icp.MAX_SUPPORT).astype(np.uint32)
            seen_from = None if target.seen_from is None else to_real(target.seen_from, self._core)
        return self._core.Index(points, self._neighbours, support=support, seen_from=seen_from, noisy=target.noisy)

    def _iteration(self, error: float, inliers: int, row: tuple[float, float, float], pairs: Any) -> Iteration:
        return Iteration(math.sqrt(error) if self._squared else error, inliers, Pose(*row), pairs)


def make_icp(module: Any, parameters: dict[str, Any]) -> Any:
    """Make the core's ICP from complete parameters; raises ValueError where it rejects one."""
    return module.Icp(
        epsilon=parameters["epsilon"],
        max_iterations=parameters["max_iterations"],
        error=ERRORS.index(parameters["error"]),
        error_before=parameters["error_at"] == "before",
        one_to_one=parameters["one_to_one"],
        max_correspondence=parameters["max_correspondence_m"],
        min_pairs=parameters["min_pairs"],
        lines=parameters.get("metric") == "line",
        cauchy=parameters.get("cauchy_m", 0.0),
        share_noise=parameters.get("share_noise", False),
    )
