"""The contract that every shipped plug-in must meet."""

import inspect
import itertools
import math
from importlib.metadata import entry_points

import numpy as np
import pytest

from evalkit.core.pose import Pose
from evalkit.core.scan import Scan
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter, resolve_parameters
from evalkit.plugins.specs import BackendSpec, DatasetSpec, MapperSpec
from evalkit_datasets.worlds import synthetic

pytestmark = pytest.mark.slow(40)

SHIPPED = ("evalkit_baselines", "evalkit_datasets")


def shipped(kind):
    """Return the names shipped with evalkit; third-party plug-ins have tests of their own."""
    found = entry_points(group=f"evalkit.{kind}")
    return sorted(point.name for point in found if point.value.startswith(SHIPPED))


BACKENDS, MAPPERS, DATASETS = (shipped(kind) for kind in ("backends", "mappers", "datasets"))
SYNTHETIC = [name for name in DATASETS if registry.dataset(name).seeded]


def sequence(name, **parameters):
    spec = registry.dataset(name)
    return spec.make(**resolve_parameters(name, spec.parameters, parameters))


@pytest.mark.parametrize("name", ["carmen", "clouds", "columns", "rosbag"])
def test_a_reader_has_the_defaults_that_its_spec_declares(name):
    """An object made by its class is the one made by its name; no parameter is missing on either side."""
    spec = registry.dataset(name)
    declared = {one.name: one.default for one in spec.parameters if one.name != "path"}
    accepted = {one.name: one.default for one in inspect.signature(spec.make).parameters.values()}
    assert accepted == {"path": inspect.Parameter.empty, "how": "", **declared}


@pytest.fixture(scope="module")
def drive():
    """2 m of the room in 21 noise-free scans, with ground truth; only the wheels have errors, up to 10 cm."""
    return sequence(
        "room",
        laps=0.09,
        rate_hz=5.0,
        speed_mps=0.8,
        noise_m=0.0,
        dropout=0.0,
        odometry_scale=0.1,
        gyro_bias_dps=2.0,
        seed=1,
    )


def make_backend(name):
    spec = registry.backend(name)
    if why := spec.missing():
        pytest.skip(why)
    return frontend.make_odometry(spec, frontend.complete_parameters(name, spec, {}))


def run_poses(name, sequence):
    method = make_backend(name)
    return np.array([method.update(frame).pose.row for frame in sequence.frames()])


def relative_to_start(sequence):
    poses = sequence.truth().trajectory
    return poses.moved(Pose.of(poses.poses[0]).inverse()).poses


def compute_max_error_m(poses, true):
    return np.linalg.norm(poses[:, :2] - true[:, :2], axis=1).max()


@pytest.fixture(scope="module")
def wheels_m(drive):
    return compute_max_error_m(run_poses("wheel-odometry", drive), relative_to_start(drive))


# --- back ends


@pytest.mark.parametrize("name", BACKENDS)
def test_a_back_end_starts_at_the_identity_follows_the_drive_and_is_repeatable(name, drive, wheels_m):
    poses = run_poses(name, drive)
    assert poses[0].tolist() == [0.0, 0.0, 0.0]
    assert np.array_equal(poses, run_poses(name, drive))
    if registry.backend(name).role != "baseline":
        assert compute_max_error_m(poses, relative_to_start(drive)) < min(0.05, wheels_m)


def test_the_baseline_can_be_beaten(wheels_m):
    assert wheels_m > 0.05
    assert [name for name in BACKENDS if registry.backend(name).role == "baseline"] == ["wheel-odometry"]


@pytest.mark.parametrize("name", BACKENDS)
def test_a_back_end_does_not_write_into_its_arguments(name):
    method = make_backend(name)
    frame, later = itertools.islice(sequence("room", laps=0.02).frames(), 2)
    before = frame.scan.ranges.copy(), frame.scan.angles.copy()
    method.update(frame)
    method.update(later)
    assert not frame.scan.ranges.flags.writeable
    assert np.array_equal(frame.scan.ranges, before[0], equal_nan=True)
    assert np.array_equal(frame.scan.angles, before[1])


@pytest.mark.parametrize("name", BACKENDS)
def test_two_instances_share_no_state(name, drive):
    frames = list(itertools.islice(drive.frames(), 12))
    frames, others = frames[:6], frames[6:]
    alone, one, other = make_backend(name), make_backend(name), make_backend(name)
    expected = [alone.update(frame).pose for frame in frames]
    for index, frame in enumerate(frames):
        assert one.update(frame).pose == expected[index]
        other.update(others[index])


# --- specs


SPECS = [
    *(("backends", name, BackendSpec) for name in BACKENDS),
    *(("mappers", name, MapperSpec) for name in MAPPERS),
    *(("datasets", name, DatasetSpec) for name in DATASETS),
]


@pytest.mark.parametrize(("kind", "name", "of"), SPECS)
def test_a_spec_describes_itself_and_every_parameter(kind, name, of):
    spec = registry.load(kind, name, of)
    assert spec.summary
    assert spec.citation
    assert spec.licence
    names = [parameter.name for parameter in spec.parameters]
    assert len(set(names)) == len(names)
    for parameter in spec.parameters:
        assert isinstance(parameter, Parameter)
        assert parameter.meaning, parameter.name
        assert parameter.check(name, parameter.default) == parameter.default
        suffixed = parameter.name.rsplit("_", 1)[-1]
        expected = {"m": "m", "deg": "deg", "hz": "Hz", "mps": "m/s", "dps": "deg/s", "s": "s"}
        assert parameter.unit == expected.get(suffixed, parameter.unit), parameter.name


def test_every_shipped_name_is_found():
    assert len(BACKENDS) >= 9
    assert MAPPERS
    assert set(SYNTHETIC) == {
        "room",
        "lab",
        "loop",
        "corridor",
        "office",
        "doors",
        "wings",
        "symmetric-office",
        "long-loop",
        "random-office",
        "random-home",
        "random-warehouse",
    }


# --- mappers


@pytest.mark.parametrize("name", MAPPERS)
def test_a_mapper_frees_the_cells_before_the_end_of_a_beam_and_occupies_its_end(name):
    spec = registry.mapper(name)
    mapper = spec.make(**resolve_parameters(name, spec.parameters, {"resolution_m": 0.1}))
    beam = Scan(0, [1.0], [0.0], 0.1, 10.0)
    mapper.update(beam, Pose(0.05, 2.05, math.pi / 2))  # up the column of cells at x = 0
    grid = mapper.grid()
    assert grid.centres(grid.occupied(0.5)).tolist() == [pytest.approx([0.05, 3.05])]
    expected = [[0.05, 2.05 + 0.1 * k] for k in range(10)]
    assert np.allclose(grid.centres(grid.free(0.5)), expected)
    assert int(grid.observed.sum()) == 11


# --- data sets


def small(name, seed):
    return sequence(name, laps=0.03, seed=seed)


def bits(sequence):
    return [
        (frame.scan.stamp_ns, frame.scan.ranges.tobytes(), frame.odom_from_base, frame.start_from_end)
        for frame in sequence.frames()
    ]


@pytest.mark.parametrize("name", SYNTHETIC)
def test_a_synthetic_sequence_is_repeatable_and_differs_with_another_seed(name):
    sequence = small(name, 3)
    first = bits(sequence)
    assert len(first) == len(sequence) > 10
    assert bits(sequence) == bits(small(name, 3)) == first
    assert bits(small(name, 4)) != first
    others, own = small(name, 4).truth().trajectory.poses, sequence.truth().trajectory.poses
    assert np.array_equal(others, own) == (
        name not in synthetic.DRAWN_WORLDS
    )  # the building and the route are drawn, too


@pytest.mark.parametrize("name", SYNTHETIC)
def test_a_synthetic_sequence_is_in_order_with_ground_truth_at_every_scan(name):
    sequence = small(name, 0)
    stamps = [frame.scan.stamp_ns for frame in sequence.frames()]
    assert (np.diff(stamps) > 0).all()
    assert sequence.truth().trajectory.stamps_ns.tolist() == stamps
    assert sequence.truth().grid.occupied().any()
    assert all(frame.odom_from_base is not None for frame in sequence.frames())


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.thorough] * (name == "backpack"))
        for name in sorted(set(DATASETS) - set(SYNTHETIC))
    ],
)
def test_a_recording_is_repeatable_and_in_order_or_reports_how_to_get_it(name):
    spec = registry.dataset(name)
    if spec.suffixes:
        assert "path" in {parameter.name for parameter in spec.parameters}
        return
    parameters = resolve_parameters(name, spec.parameters, {"limit": 20})
    if why := spec.missing(**parameters):
        assert "evalkit" in why or "EVALKIT_DATA" in why
        pytest.skip(why)
    sequence = spec.make(**parameters)
    first = bits(sequence)
    assert len(first) == len(sequence) == 20
    assert (np.diff([stamp for stamp, *_ in first]) > 0).all()
    assert bits(sequence) == first
