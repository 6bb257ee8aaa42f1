"""20 iterations of the ICP of each library on the same clouds: interleaved, CPU time, one thread, ratios to the core.

31 scans in turn, in each round the same for all methods, each from a guess 7 cm and 1.7 degrees off. In a round every
method registers one scan ("in turn": others have filled the caches) or all 31 ("in a row"). Only the registration is
timed: clouds are converted before, and libraries that can keep an index over the target do. "+ index"
builds the index in the call: the core's cells, small_gicp's cloud and tree, KISS-ICP's voxel map, and Open3D's tree,
which it always builds; "Open3D, less its tree" is the same call less the time of building that tree alone. So compare
rows with "+ index" with each other, and rows without. "+ table" is a lasting target: each scan was registered with it
before. The rows of cKDTree are its nearest-neighbour queries alone.
The pairing differs (one-to-one in the core and the NumPy reference, many-to-one in the others) and KISS-ICP uses
robust weights; clouds, guesses, largest distance and iterations are the same. Karto's matcher (karto-scanmatcher, under
the GPL) takes scans and no clouds: its rows match one scan of the lab, from the same error of the guess, with as many
scans before it as have that number of beams; it searches, so that there are no iterations.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from evalkit import Cloud, Pose
from evalkit.commands.diff import benchmark
from evalkit.commands.diff.benchmark import BenchmarkSeries
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.execution.environment import SINGLE_THREAD
from evalkit.odometry import planar3d
from evalkit.plugins import registry
from evalkit_baselines.embedded.compiled import Precision, compiled_missing, load_core, to_real
from evalkit_baselines.paper.icp import Icp

ITERATIONS = 20
LARGEST_M = 0.3
SOURCES = 1000
SCANS = 31
REFERENCE = "embedded"
TILES = 60_000
KISS_CELL_M, KISS_POINTS_PER_CELL, KISS_KERNEL_M = 0.12, 20, 0.1
GUESS_OFF = Pose(0.06, -0.04, 0.03)
MAX_ERROR_M = 0.05

Calls = dict[str, Callable[[int], Any]]
"""By name, what registers the scan of this number."""

TREE, LESS_TREE = "Open3D's tree alone", "Open3D, less its tree"


@dataclass(frozen=True)
class Questions:
    """A target (N, 2) in the world, and SCANS sources (SOURCES, 2) in the frames of their scans with their guesses."""

    target: Floats
    sources: list[Floats]
    guesses: list[Pose]


def questions(targets: int) -> Questions:
    """Return ``targets`` points of a drive through the lab and 31 pairs of scans along it, which are not among them."""
    lab = registry.dataset("lab")
    sequence = lab.make(**{p.name: p.default for p in lab.parameters} | {"laps": 0.3})
    truth = sequence.truth().trajectory
    if truth is None:
        raise ValueError("lab: no true trajectory")
    scans, poses = [], []
    for frame in sequence.frames():
        scan = frame.scan.deskewed(frame.base_from_sensor, frame.start_from_end)
        poses.append(Pose.of(truth.at([frame.scan.stamp_ns])[0]))
        scans.append((poses[-1] @ frame.base_from_sensor).transform(scan.points()))
    generator = np.random.default_rng(0)
    asked = np.linspace(0, len(scans) - 2, SCANS).astype(int)
    others = np.concatenate([scan for k, scan in enumerate(scans) if k not in asked and k - 1 not in asked])
    sources = []
    for first in asked:
        both = np.concatenate(scans[first : first + 2])
        chosen = both[np.sort(generator.permutation(len(both))[:SOURCES])]
        sources.append(poses[first].inverse().transform(chosen))
    target = others[np.sort(generator.permutation(len(others))[:targets])]
    return Questions(target, sources, [poses[first] @ GUESS_OFF for first in asked])


def core_methods(precision: Precision, name: str, asked: Questions) -> Calls:
    """Return the compiled core: with a kept index, with a kept table, and with an index built in the call."""
    module = load_core(precision)
    icp = module.Icp(
        epsilon=0.0, max_iterations=ITERATIONS, error=0, error_before=False, one_to_one=True,
        max_correspondence=LARGEST_M, min_pairs=3,
    )  # fmt: skip
    to, points = to_real(asked.target, module), [to_real(source, module) for source in asked.sources]
    rows = [(guess.x, guess.y, guess.theta) for guess in asked.guesses]
    index = module.Index(to)
    lasting = module.Index(to, table=TILES)
    return {
        name: lambda k: icp.register(index, points[k], rows[k]),
        f"{name} + table": lambda k: icp.register(lasting, points[k], rows[k]),
        f"{name} + index": lambda k: icp.register(module.Index(to), points[k], rows[k]),
    }


def reference_methods(asked: Questions) -> Calls:
    """Return the NumPy reference with a kept tree, and the queries alone of as many iterations, from the guess."""
    twin = Icp(epsilon=0.0, max_iterations=ITERATIONS, max_correspondence_m=LARGEST_M)
    fixed, moving = Cloud(asked.target), [Cloud(source) for source in asked.sources]
    tree = cKDTree(asked.target)
    placed = [guess.transform(source) for guess, source in zip(asked.guesses, asked.sources, strict=True)]

    def queries(k: int) -> None:
        for _ in range(ITERATIONS):
            tree.query(placed[k], distance_upper_bound=LARGEST_M)

    return {
        "paper (NumPy)": lambda k: twin.register(fixed, moving[k], asked.guesses[k]),
        "cKDTree, queries": queries,
    }


def small_gicp_methods(asked: Questions) -> Calls:
    """Return small_gicp's point-to-point with a kept tree (19 iterations of 20), and with a tree built in the call."""
    import small_gicp

    space = planar3d.points_3d(asked.target)
    fixed = small_gicp.PointCloud(space)
    moving = [small_gicp.PointCloud(planar3d.points_3d(source)) for source in asked.sources]
    initial = [planar3d.matrix_4x4(guess) for guess in asked.guesses]
    tree = small_gicp.KdTree(fixed, num_threads=1)

    def align(cloud: Any, index: Any, k: int) -> Any:
        return small_gicp.align(
            cloud, moving[k], index, init_T_target_source=initial[k], registration_type="ICP",
            max_correspondence_distance=LARGEST_M, num_threads=1, max_iterations=ITERATIONS, rotation_epsilon=0.0,
            translation_epsilon=0.0,
        )  # fmt: skip

    def rebuilt(k: int) -> Any:
        cloud = small_gicp.PointCloud(space)
        return align(cloud, small_gicp.KdTree(cloud, num_threads=1), k)

    return {"small_gicp": lambda k: align(fixed, tree, k), "small_gicp + index": rebuilt}


def open3d_methods(asked: Questions) -> Calls:
    """Return Open3D's legacy point-to-point, which builds its tree in every call, and building this tree alone."""
    import open3d

    open3d.utility.set_max_threads(1)
    methods = open3d.pipelines.registration
    fixed, *moving = (
        open3d.geometry.PointCloud(open3d.utility.Vector3dVector(planar3d.points_3d(points)))
        for points in (asked.target, *asked.sources)
    )
    initial = [planar3d.matrix_4x4(guess) for guess in asked.guesses]
    estimation = methods.TransformationEstimationPointToPoint()
    stop = methods.ICPConvergenceCriteria(0.0, 0.0, ITERATIONS)
    return {
        "Open3D + index": lambda k: methods.registration_icp(moving[k], fixed, LARGEST_M, initial[k], estimation, stop),
        TREE: lambda _: open3d.geometry.KDTreeFlann(fixed),
    }


def kiss_icp_methods(asked: Questions) -> Calls:
    """Return KISS-ICP's align_points_to_map with its map (20 points per cell of 12 cm) kept, and built in the call."""
    from kiss_icp.mapping import VoxelHashMap
    from kiss_icp.pybind import kiss_icp_pybind

    space = planar3d.points_3d(asked.target)

    def make_map() -> Any:
        made = VoxelHashMap(KISS_CELL_M, 1e3, KISS_POINTS_PER_CELL)
        made.add_points(space)
        return made

    voxels = make_map()
    registration = kiss_icp_pybind._Registration(
        max_num_iterations=ITERATIONS, convergence_criterion=0.0, max_num_threads=1
    )
    points = [kiss_icp_pybind._Vector3dVector(planar3d.points_3d(source)) for source in asked.sources]
    initial = [planar3d.matrix_4x4(guess) for guess in asked.guesses]

    def align(over: Any, k: int) -> Any:
        return registration._align_points_to_map(
            points=points[k],
            voxel_map=over._internal_map,
            initial_guess=initial[k],
            max_correspondance_distance=LARGEST_M,
            kernel=KISS_KERNEL_M,
        )

    return {"KISS-ICP": lambda k: align(voxels, k), "KISS-ICP + index": lambda k: align(make_map(), k)}


def karto_methods(asked: Questions) -> Calls:
    """Return Karto's correlative matcher on scans of the lab with at least as many beams as the target has points."""
    karto: Any = importlib.import_module("karto_scanmatcher")

    lab = registry.dataset("lab")
    sequence = lab.make(**{p.name: p.default for p in lab.parameters})
    truth = sequence.truth().trajectory
    if truth is None:
        raise ValueError("lab: no true trajectory")

    def describe_scan(number: int, frame: Frame, at: Pose) -> Any:
        scan, limit = frame.scan, frame.scan.range_max_m
        order = slice(None, None, 1 if scan.angles[-1] > scan.angles[0] else -1)  # Karto's are counter-clockwise
        angles, ranges = scan.angles[order], scan.ranges[order]
        step = (angles[-1] - angles[0]) / (len(angles) - 1)
        sensor = karto.LaserScanConfig(angles[0], angles[-1], step, scan.range_min_m, limit + 2.0, limit, "lidar")
        found = np.where(np.isfinite(ranges), ranges, limit + 1.0).tolist()  # beyond the limit: not used
        pose = karto.Pose2(*(at @ frame.base_from_sensor).row)
        return karto.LocalizedRangeScan(sensor, found, pose, pose, number, scan.stamp_ns * 1e-9)

    kept, beams = [], 0
    for number, frame in enumerate(sequence.frames()):
        world_from_base = Pose.of(truth.at([frame.scan.stamp_ns])[0])
        if beams >= len(asked.target):
            break
        kept.append(describe_scan(number, frame, world_from_base))
        beams += len(frame.scan.ranges)
    last = describe_scan(number, frame, world_from_base @ GUESS_OFF)
    config = karto.ScanMatcherConfig()
    config.search_size, config.range_threshold = 2.0 * LARGEST_M, frame.scan.range_max_m
    matcher = karto.Wrapper(config)
    found, expected = matcher.match_scan(last, kept, True, True).best_pose, world_from_base @ frame.base_from_sensor
    if np.hypot(found.x - expected.x, found.y - expected.y) > MAX_ERROR_M:
        raise ValueError("Karto does not find the pose: its time would mean nothing")
    return {"Karto, its own scans": lambda _: matcher.match_scan(last, kept, True, True)}


PEERS: dict[str, Callable[[Questions], Calls]] = {
    "small_gicp": small_gicp_methods,
    "open3d": open3d_methods,
    "kiss_icp": kiss_icp_methods,
    "karto_scanmatcher": karto_methods,
}
"""By module, the methods of other libraries."""


def methods(asked: Questions) -> tuple[Calls, dict[str, str]]:
    """Return all methods that answer here, the core first, and why a peer is absent: by its module."""
    calls = core_methods("double", REFERENCE, asked)
    calls |= core_methods("float", "embedded-f32", asked)
    calls |= reference_methods(asked)
    absent = {}
    for module, make in PEERS.items():
        try:
            if importlib.util.find_spec(module) is None:
                absent[module] = "not installed"
                continue
            made = make(asked)
            for call in made.values():
                call(0)
        except Exception as error:  # noqa: BLE001 - a broken peer takes away its own rows only
            absent[module] = f"broken: {type(error).__name__}: {error}"
        else:
            calls |= made
    return calls, absent


def warm_up(calls: Calls) -> None:
    """Register each scan three times with each method: a table is filled at the third search."""
    for call in calls.values():
        for k in list(range(SCANS)) * 3:
            call(k)


def measure_ns(calls: Calls, rounds: int, in_a_row: int = 1) -> dict[str, Floats]:
    """Return the CPU times (rounds * in_a_row,) of each method, which take turns in alternating order."""
    times: dict[str, list[int]] = {name: [] for name in calls}
    for round_ in range(rounds):
        scans = [(round_ * in_a_row + k) % SCANS for k in range(in_a_row)]
        for name in list(calls) if round_ % 2 else reversed(calls):
            call = calls[name]
            for scan in scans:
                start = time.process_time_ns()
                call(scan)
                times[name].append(time.process_time_ns() - start)
    taken = {name: np.array(one, dtype=np.float64) for name, one in times.items()}
    if TREE in taken:
        taken[LESS_TREE] = taken["Open3D + index"] - taken[TREE]
    return taken


def main() -> None:
    """Print the median CPU time of each method and its ratio to the core, paired round by round, with quartiles."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--rounds", type=int, default=2, help="of all scans in turn, and as many in a row")
    parser.add_argument("--targets", type=int, nargs="+", default=[5000, 50_000])
    arguments = parser.parse_args()
    if why := compiled_missing():
        parser.error(why)
    ran_on = benchmark.describe_environment()
    series = []
    os.environ.update(SINGLE_THREAD)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    for targets in arguments.targets:
        asked = questions(targets)
        calls, absent = methods(asked)
        warm_up(calls)
        print(f"{ITERATIONS} iterations, {SCANS} scans of {SOURCES} points against {len(asked.target)} points")
        for way, rounds, in_a_row in (("in turn", arguments.rounds * SCANS, 1), ("in a row", arguments.rounds, SCANS)):
            times = measure_ns(calls, rounds, in_a_row)
            print(f"{way:22} {'CPU ms':>8} {'x ' + REFERENCE:>12} {'quartiles':>14}")
            for name, taken in times.items():
                low, ratio, high = np.percentile(taken / times[REFERENCE], [25, 50, 75])
                print(f"{name:22} {np.median(taken) / 1e6:8.3f} {ratio:12.2f} {low:7.2f}-{high:.2f}")
                series.append(BenchmarkSeries(f"{name}, {targets} points, {way}", "ms", tuple((taken / 1e6).tolist())))
        for module, why in absent.items():
            print(f"{module}: {why}")
            ran_on[f"absent peer {module}"] = why
    print(benchmark.write_benchmark("registration", series, ran_on))


if __name__ == "__main__":
    main()
