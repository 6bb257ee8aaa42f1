"""How good a pose in a known map is: time to localise, fit of the scans, and the error that the fit predicts.

The same for all methods, from the map, the scans and the poses alone. The walls around a scan's points are lines. The
distance that the scan must move to lie on them by least squares predicts the error of the position; it is no less than
the uncertainty of that motion by the scatter of the points. ``map_fit_ratio`` states how right that is where the truth
is known. A scan in its true place must be moved by 6 to 11 mm (root mean square; simulated worlds, perfect maps in
cells of 5 cm), one displaced by 10, 30, 100 or 300 mm by 12 to 15, 32, 100 or 280 to 300 mm.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints, spread_indices
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.fit_calibration import WRONG_M, describe_calibration, load_calibration
from evalkit.metrics.metric import NO_KNOWN_MAP, Evidence, MatchedPoses, cached, make_metrics, make_score
from evalkit.metrics.neighbourhoods import build_kd_tree
from evalkit.metrics.trajectory import compute_errors_m, rms

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

NEAR_M = 0.2
"""A point within this distance of a wall lies on it."""

MIN_SHARE = 0.5
"""A scan with a smaller share of its points on walls does not fit the map: no error is predicted."""

MAX_SCANS = 100
"""At most this many scans are measured, evenly spaced."""

WITHIN = 1.73
"""95 % of the errors are below this multiple of the predicted ones: of their root mean square in a plane."""

REACH_M, SCALE_M, STEPS = 0.5, 0.1, 4
"""Pairs beyond the reach do not count; those beyond the scale count less; Gauss-Newton steps to the walls."""

CORRELATED = 3.0
"""Neighbouring points share the errors of their cells: so many count as one. Chosen on the worlds lab and office."""

OPEN_M, OPEN_RAD = 1.0, 0.35
"""Uncertainty of what the walls do not fix, as along a bare corridor."""

MAX_POINTS = 200
NORMAL_POINTS = 8


def measure_fit(points: Floats, walls: cKDTree, resolution_m: float) -> tuple[float, float]:
    """Return the predicted error of a scan's position (m), nan where it does not fit, and the share of points on walls.

    ``points`` (N, 2): in the map at the pose to judge. ``walls``: centres of the occupied cells.
    """
    centre = points.mean(axis=0) if len(points) else np.zeros(2)
    source = points[:: max(len(points) // MAX_POINTS, 1)] - centre
    share = 0.0
    moved, information, scatter = np.zeros(3), np.eye(3), 0.0
    for step in range(STEPS):
        placed = se2.transform(moved, source) + centre
        found = walls.query(placed, distance_upper_bound=REACH_M)
        distance, nearest = np.asarray(found[0]), np.asarray(found[1])
        paired = np.isfinite(distance)
        if step == 0:
            share = float(np.mean(distance <= NEAR_M)) if len(source) else 0.0
        if share < MIN_SHARE:
            return float("nan"), share
        normals = _find_normals(walls, nearest[paired])
        offset = np.einsum("ni,ni->n", placed[paired] - walls.data[nearest[paired]], normals)
        arm = placed[paired] - centre - moved[:2]
        jacobian = np.column_stack([normals, arm[:, 0] * normals[:, 1] - arm[:, 1] * normals[:, 0]])
        weight = 1.0 / (1.0 + (offset / SCALE_M) ** 2)
        information = jacobian.T @ (weight[:, None] * jacobian) + np.diag([1e-6, 1e-6, 1e-6])
        scatter = float((weight * offset**2).sum() / max(weight.sum(), 1.0))
        moved = moved - np.linalg.solve(information, jacobian.T @ (weight * offset))
    known = information / (CORRELATED * (scatter + resolution_m**2 / 12.0)) + np.diag(
        [OPEN_M**-2, OPEN_M**-2, OPEN_RAD**-2]
    )
    spread = float(np.trace(np.linalg.inv(known)[:2, :2]))
    return float(np.sqrt(max(float(moved[:2] @ moved[:2]), spread))), share


def _find_normals(walls: cKDTree, rows: Ints) -> Floats:
    """Return the unit normals (N, 2) of the lines through the walls around some of them."""
    _, around = walls.query(walls.data[rows], k=min(NORMAL_POINTS, walls.n))
    spread = walls.data[np.asarray(around).reshape(len(rows), -1)]
    spread = spread - spread.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))
    return np.asarray(vectors[:, :, 0])


@cached
def compute_fit(evidence: Evidence) -> Floats | None:
    """Return for each measured scan (K, 4): predicted and true error (m), share of points on walls, doubt.

    The doubt is the probability that the position is wrong (``fit_calibration``). nan where unknown. None without a
    known map or poses.
    """
    known, mapped = evidence.known_map, evidence.mapped
    if known is None or not mapped:
        return None
    walls = build_kd_tree(known.walls)
    true = evidence.truth.trajectory
    errors = np.full(len(evidence.run.steps), np.nan)
    if true is not None and isinstance(evidence.matched, MatchedPoses) and evidence.matched.is_in_map:
        errors = compute_errors_m(evidence.run.estimate.moved(evidence.matched.world_from_start, "world"), true)
    by_stamp = dict(zip(evidence.run.steps["stamp_ns"].tolist(), errors.tolist(), strict=True))
    rows = []
    for index in spread_indices(len(mapped), MAX_SCANS).tolist():
        scan, map_from_sensor = mapped[index]
        points = se2.transform(map_from_sensor, scan.points())
        predicted, share = measure_fit(points, walls, known.resolution_m)
        doubt = load_calibration().predict(predicted, len(points), known.resolution_m)
        rows.append((predicted, by_stamp.get(scan.stamp_ns, np.nan), share, float(doubt)))
    return np.array(rows).reshape(-1, 4)


def _with_fit(measure: Callable[[Floats], Score]) -> Callable[[Evidence], Score]:
    def compute(evidence: Evidence) -> Score:
        fit = compute_fit(evidence)
        if fit is None:
            return Score(None, reason=NO_KNOWN_MAP if evidence.known_map is None else _NO_SCANS)
        return measure(fit)

    return compute


def _score_predicted(fit: Floats) -> Score:
    predicted = fit[np.isfinite(fit[:, 0]), 0]
    return make_score(np.median(predicted), len(predicted)) if len(predicted) else Score(None, len(fit), _NO_FIT)


def _score_ratio(fit: Floats) -> Score:
    known = fit[np.isfinite(fit[:, :2]).all(axis=1)]
    if not len(known):
        return Score(None, reason=_NO_ERRORS)
    return make_score(rms(known[:, 1]) / rms(known[:, 0]), len(known))


def _score_within(fit: Floats) -> Score:
    known = fit[np.isfinite(fit[:, :2]).all(axis=1)]
    if not len(known):
        return Score(None, reason=_NO_ERRORS)
    return make_score(100.0 * np.mean(known[:, 1] <= WITHIN * known[:, 0]), len(known))


def _score_wrong(fit: Floats) -> Score:
    doubt = fit[np.isfinite(fit[:, 3]), 3]
    return make_score(100.0 * np.mean(doubt), len(doubt)) if len(doubt) else Score(None, len(fit), _OUTSIDE)


def _score_truly_wrong(fit: Floats) -> Score:
    true = fit[np.isfinite(fit[:, 1]), 1]
    return make_score(100.0 * np.mean(true > WRONG_M), len(true)) if len(true) else Score(None, reason=_NO_TRUTH)


def _score_start(measure: Callable[[Evidence], float]) -> Callable[[Evidence], Score]:
    def compute(evidence: Evidence) -> Score:
        start = evidence.run.start
        if start is None:
            return Score(None, reason=NO_KNOWN_MAP)
        return make_score(measure(evidence), start.scans) if start.searched else Score(None, reason=_GIVEN)

    return compute


_NO_SCANS = "no scan has a pose in the map"
_NO_FIT = "no scan fits the map"
_NO_ERRORS = "no scan that fits has a true position in the map"
_NO_TRUTH = "no scan has a true position in the map"
_OUTSIDE = "outside the range of the calibration: the map's cells, or too few points in the scans"
_GIVEN = "the start was given"


METRICS = make_metrics(
    "localisation",
    {
        "localised_after_s": _score_start(lambda one: one.run.start.after_s if one.run.start else np.nan),
        "localised_after_scans": _score_start(lambda one: one.run.start.scans if one.run.start else np.nan),
        "map_fit_m": _with_fit(_score_predicted),
        "map_fit_percent": _with_fit(lambda fit: make_score(100.0 * np.median(fit[:, 2]), len(fit))),
        "map_misfit_percent": _with_fit(lambda fit: make_score(100.0 * np.mean(np.isnan(fit[:, 0])), len(fit))),
        "map_fit_ratio": _with_fit(_score_ratio),
        "map_fit_within_percent": _with_fit(_score_within),
        "map_wrong_percent": _with_fit(_score_wrong),
        "map_truly_wrong_percent": _with_fit(_score_truly_wrong),
    },
    NEAR_M=NEAR_M,
    MAX_SCANS=MAX_SCANS,
    WITHIN=WITHIN,
    MIN_SHARE=100.0 * MIN_SHARE,
    WRONG_CM=100.0 * WRONG_M,
    CALIBRATION=describe_calibration(),
)
