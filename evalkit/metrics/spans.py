"""Errors of distances in the estimate against distances measured with a tape: they show a stretched map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from evalkit.core import se2
from evalkit.core.measured_distances import Span, SpanEnd
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.consistency import collect_hits
from evalkit.metrics.metric import Evidence, MatchedPoses, make_metrics, make_score
from evalkit.metrics.relations import MAX_GAP_S
from evalkit.metrics.trajectory import can_interpolate, rms

REACH_M = 0.3
ASIDE_M = 0.15
MIN_HITS = 10
"""Position of a wall: the median of at least ten hits within 0.3 m along the tape and 0.15 m beside it."""

_NO_TAPE = "no distance was measured with a tape"


@dataclass(frozen=True, eq=False)
class SpanLengths:
    """Distances in the estimate (K,), measured by tape (K,), and standard deviations of the tape (K,), in metres."""

    estimated_m: Floats
    measured_m: Floats
    sigma_m: Floats


def measure_spans(spans: tuple[Span, ...], world_from_base: Trajectory, points: Floats) -> SpanLengths:
    """Return the spans that the estimate covers; ``points`` (N, 2): the mapped hits, for spans that end at a wall."""
    lengths = [(_measure_length(span, world_from_base, points), span.metres, span.sigma_m) for span in spans]
    rows = np.array([row for row in lengths if row[0] is not None], dtype=np.float64).reshape(-1, 3)
    return SpanLengths(rows[:, 0], rows[:, 1], rows[:, 2])


def fit_stretch(lengths: SpanLengths) -> float:
    """Return the weighted least-squares scale of the estimated distances relative to the measured ones, minus 1."""
    weights = lengths.sigma_m**-2.0
    scale = np.sum(weights * lengths.measured_m * lengths.estimated_m) / np.sum(weights * lengths.measured_m**2)
    return float(scale - 1.0)


def _measure_length(span: Span, world_from_base: Trajectory, points: Floats) -> float | None:
    ends = [_locate_point(place, world_from_base) for place in (span.first, span.second)]
    if ends[0] is None or ends[1] is None:
        return None
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    if length == 0.0:  # both ends coincide in the estimate
        return 0.0
    before = _measure_to_wall(span.first, ends[0], along / length, points)
    beyond = _measure_to_wall(span.second, ends[1], along / length, points)
    return None if before is None or beyond is None else length + beyond - before


def _locate_point(place: SpanEnd, world_from_base: Trajectory) -> Floats | None:
    if place.stamp_ns is None:
        return np.array([place.x, place.y])
    if not can_interpolate(world_from_base.stamps_ns, [place.stamp_ns], MAX_GAP_S)[0]:
        return None
    return np.asarray(se2.transform(world_from_base.at([place.stamp_ns])[0], [[place.x, place.y]])[0])


def _measure_to_wall(place: SpanEnd, end: Floats, direction: Floats, points: Floats) -> float | None:
    """Return the distance from an end along the tape to the wall (m): 0 at the robot, None without a wall."""
    if place.stamp_ns is not None:
        return 0.0
    offsets = points - end
    along = offsets @ direction
    beside = offsets @ np.array([-direction[1], direction[0]])
    near = along[(np.abs(along) <= REACH_M) & (np.abs(beside) <= ASIDE_M)]
    return float(np.median(near)) if len(near) >= MIN_HITS else None


def _make_score_function(measure: Callable[[SpanLengths], float]) -> Callable[[Evidence], Score]:
    def compute(evidence: Evidence) -> Score:
        spans = evidence.truth.spans
        if not spans:
            return Score(None, reason=_NO_TAPE)
        lengths = _measure_spans(evidence)
        if len(lengths.measured_m) == 0:
            return Score(None, reason=f"the estimate covers none of {len(spans)} measured distances")
        return make_score(measure(lengths), len(lengths.measured_m))

    return compute


def _find_worst_sigmas(lengths: SpanLengths) -> float:
    return float(np.max(np.abs(lengths.estimated_m - lengths.measured_m) / lengths.sigma_m))


def _score_covered(evidence: Evidence) -> Score:
    spans = evidence.truth.spans
    if not spans:
        return Score(None, reason=_NO_TAPE)
    return make_score(100.0 * len(_measure_spans(evidence).measured_m) / len(spans), len(spans))


def _measure_spans(evidence: Evidence) -> SpanLengths:
    estimate = evidence.run.estimate
    if isinstance(evidence.matched, MatchedPoses):
        estimate = estimate.moved(evidence.matched.world_from_start, "world")
    return measure_spans(evidence.truth.spans, estimate, collect_hits(evidence.mapped))


METRICS = make_metrics(
    "spans",
    {
        "span_rmse_m": _make_score_function(lambda lengths: rms(lengths.estimated_m - lengths.measured_m)),
        "span_stretch_percent": _make_score_function(lambda lengths: 100.0 * fit_stretch(lengths)),
        "span_worst_sigmas": _make_score_function(_find_worst_sigmas),
        "span_answered_percent": _score_covered,
    },
    REACH_M=REACH_M,
)
