"""The matchers on fields: fields with known values, gradients that are derivatives, and motions known in advance."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from evalkit.core.errors import BadParameter
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.plugins.parameters import resolve_parameters
from evalkit_baselines import distance_field, likelihood_field, ndt
from evalkit_baselines.distance_field import DistanceField, DistanceFieldMatcher
from evalkit_baselines.likelihood_field import LikelihoodField
from evalkit_baselines.ndt import NormalCells

METHODS = {"distance-field": distance_field.SPEC, "likelihood-field": likelihood_field.SPEC, "ndt": ndt.SPEC}
PLACE = Pose(1.3, -2.1, 0.35)  # the walls are parallel to no grid
TRUTH = PLACE @ Pose(0.06, -0.04, np.radians(2.0))


def matcher(method, **parameters):
    spec = METHODS[method]
    return spec.make(**resolve_parameters(method, spec.parameters, parameters))


def room(step_m=0.01):
    """Return points on the walls of an L-shaped room, one every ``step_m``."""
    corners = np.array([[-4.0, -3.0], [4.0, -3.0], [4.0, 1.0], [0.0, 1.0], [0.0, 4.0], [-4.0, 4.0]])
    sides = np.roll(corners, -1, axis=0) - corners
    counts = np.round(np.linalg.norm(sides, axis=1) / step_m).astype(int)
    return np.concatenate([c + s * np.arange(n)[:, None] / n for c, s, n in zip(corners, sides, counts, strict=True)])


def corridor():
    """Return points on two walls along x, 2 m apart; nothing at their ends."""
    along = np.arange(-8.0, 8.0, 0.01)
    return np.concatenate([np.stack([along, np.full_like(along, side)], axis=1) for side in (-1.0, 1.0)])


def see(points, target_from_source, every=7):
    """Return every n-th point as a scan at a pose sees it."""
    return Cloud(target_from_source.inverse().transform(points[::every]))


def error(found, truth=TRUTH):
    left = truth.inverse() @ found
    return np.hypot(left.x, left.y), np.degrees(abs(left.theta))


@pytest.mark.parametrize("method", METHODS)
def test_a_known_motion_without_noise_is_found(method):
    target = PLACE.transform(room())
    match = matcher(method).register(Cloud(target), see(target, TRUTH), PLACE)
    metres, degrees = error(match.target_from_source)
    assert match.converged
    assert match.inliers == len(target[::7])
    assert metres < 3e-3
    assert degrees < 0.05


@pytest.mark.parametrize("method", METHODS)
def test_a_third_of_the_points_on_nothing_does_not_move_the_answer(method):
    target = PLACE.transform(room())
    people = PLACE.transform(np.random.default_rng(0).uniform([-3.0, -2.0], [-1.0, 3.0], (150, 2)))
    scan = Cloud(np.concatenate([see(target, TRUTH).points, TRUTH.inverse().transform(people)]))
    assert error(matcher(method).register(Cloud(target), scan, PLACE).target_from_source)[0] < 0.01


@pytest.mark.parametrize("method", METHODS)
def test_a_corridor_leaves_the_way_along_it_to_the_guess(method):
    target = corridor()
    guess = Pose(0.5, 0.06, np.radians(1.0))
    inner = target[np.abs(target[:, 0]) < 4.0]
    match = matcher(method).register(Cloud(target), see(inner, Pose()), guess)
    assert match.target_from_source.x == pytest.approx(0.5, abs=5e-3)
    flat = 0.01 if method == "likelihood-field" else 3e-3  # between two rows of cells that share a wall it has no slope
    assert match.target_from_source.y == pytest.approx(0.0, abs=flat)
    assert match.target_from_source.theta == pytest.approx(0.0, abs=flat / 3.0)


@pytest.mark.parametrize("method", METHODS)
def test_the_answer_moves_with_the_target(method):
    target, shift = PLACE.transform(room()), Pose(12.34, -5.67, 0.0)
    fine = {"cell_m": 0.05} if method == "distance-field" else {}  # the field moves with its cells, a little
    one = matcher(method, **fine).register(Cloud(target), see(target, TRUTH), PLACE)
    two = matcher(method, **fine).register(Cloud(shift.transform(target)), see(target, TRUTH), shift @ PLACE)
    assert error(two.target_from_source, shift @ one.target_from_source)[0] < 2e-3


@pytest.mark.parametrize("method", METHODS)
def test_no_answer_is_the_guess(method):
    far = Pose(500.0, 0.0, 0.0)
    for target, source in ((room(), np.empty((0, 2))), (np.empty((0, 2)), room()), (room(), room())):
        match = matcher(method).register(Cloud(target), Cloud(source), far)
        assert not match.converged
        assert match.target_from_source == far
        assert match.inliers == 0


@pytest.mark.parametrize("method", METHODS)
def test_the_slope_of_a_point_is_the_derivative_of_its_cost(method):
    target = PLACE.transform(room())
    evaluate = matcher(method).cost_of(Cloud(target))
    points = see(target, Pose()).points + np.random.default_rng(1).uniform(0.031, 0.1, (len(target[::7]), 2))
    slope, h = evaluate(points).slope, 1e-6
    for point in (3, 50, 111, 200):
        for axis in (0, 1):
            moved = np.zeros_like(points)
            moved[point, axis] = h
            numerical = (evaluate(points + moved).cost - evaluate(points - moved).cost) / (2.0 * h)
            assert slope[axis, point] == pytest.approx(numerical, abs=1e-4)


def test_distances_are_those_of_the_exact_transform():
    occupied = np.ones((61, 81))
    rng = np.random.default_rng(2)
    cells = np.stack([rng.integers(5, 76, 40), rng.integers(5, 56, 40)], axis=1)
    occupied[cells[:, 1], cells[:, 0]] = 0.0
    expected = np.minimum(distance_transform_edt(occupied) * 0.1, 0.8)
    distances = DistanceField((cells + 0.5) * 0.1, cell_m=0.1, cap_m=0.8)
    rows, columns = np.mgrid[0:60, 0:80]
    found, _ = distances.read(np.stack([columns.ravel(), rows.ravel()], axis=1) * 0.1 + 0.05 + 1e-9)
    assert found == pytest.approx(expected[:60, :80].ravel(), abs=1e-6)


def test_the_distance_from_one_point_is_known_and_ends_at_the_cap():
    distances = DistanceField(np.array([[2.0, 1.0]]), cell_m=0.01, cap_m=0.5)
    distance, gradient = distances.read(np.array([[2.3, 1.0], [2.0, 0.6], [2.7, 1.0], [90.0, -70.0]]))
    assert distance == pytest.approx([0.3, 0.4, 0.5, 0.5], abs=1e-4)
    assert gradient == pytest.approx(np.array([[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0]]), abs=0.02)


def test_beyond_the_cap_a_point_does_not_pull():
    evaluate = DistanceFieldMatcher(cap_m=0.3).cost_of(Cloud(room()))
    terms = evaluate(np.array([[-3.8, 0.0], [-2.0, 0.0]]))
    assert terms.near == 1
    assert terms.slope[0, 0] > 0.0
    assert terms.slope[:, 1].tolist() == [0.0, 0.0]


def test_a_target_too_large_for_its_cells_is_an_error_that_says_so():
    with pytest.raises(BadParameter, match="larger cells"):
        DistanceField(np.array([[0.0, 0.0], [1e5, 1e5]]), cell_m=0.05, cap_m=0.5)


def test_a_point_between_occupied_cells_reads_their_probability_and_none_reads_free():
    """Two occupied cells side by side, each at its centre: 0.9 at both and halfway, half of it half a cell aside."""
    occupied = LikelihoodField(np.array([[0.05, 0.05], [0.15, 0.05]]), cell_m=0.1, occupied=0.9)
    p, gradient = occupied.read(np.array([[0.05, 0.05], [0.1, 0.05], [0.1, 0.1], [5.0, 5.0]]))
    assert p == pytest.approx([0.9, 0.9, 0.45, 0.0])
    assert gradient[:, 2] == pytest.approx([0.0, -9.0])
    assert gradient[:, 3].tolist() == [0.0, 0.0]


def test_the_distribution_of_a_cell_is_the_mean_and_covariance_of_its_points():
    points = np.random.default_rng(3).normal([0.5, 0.5], [0.1, 0.02], (200, 2))
    cells = NormalCells(points, cell_m=1.0, shift_m=np.zeros(2), min_points=3, thinnest=1e-6)
    assert cells.means[:, 0] == pytest.approx(points.mean(axis=0))
    (xx, xy), (_, yy) = np.linalg.inv(np.cov(points.T, bias=True))
    assert cells.inverses[:, 0] == pytest.approx([xx, xy, yy])
    assert cells.widths[0] ** 2 == pytest.approx(np.linalg.eigvalsh(np.cov(points.T, bias=True))[0])


def test_a_wall_without_noise_is_as_thin_as_allowed_and_few_points_make_no_distribution():
    wall = np.stack([np.linspace(0.0, 0.9, 10), np.full(10, 0.5)], axis=1)
    cells = NormalCells(np.concatenate([wall, [[5.5, 5.5], [5.6, 5.5]]]), 1.0, np.zeros(2), min_points=3, thinnest=0.01)
    assert cells.means.shape == (2, 1)
    assert cells.widths[0] ** 2 == pytest.approx(0.01 * wall[:, 0].var())
    rows, cell = cells.find(np.array([[0.2, 0.9], [5.5, 5.5], [-99.0, 0.0]]))
    assert (rows.tolist(), cell.tolist()) == ([0], [0])


def test_a_kept_field_serves_its_own_cloud_only():
    """The same matcher, two targets of equal size: the answers are those of new matchers."""
    first, second = PLACE.transform(room()), (PLACE @ Pose(0.1)).transform(room())
    used = DistanceFieldMatcher()
    for target in (first, second, first):
        cloud = Cloud(target)
        expected = DistanceFieldMatcher().register(cloud, see(first, TRUTH), PLACE)
        assert used.register(cloud, see(first, TRUTH), PLACE).target_from_source == expected.target_from_source
