"""20 iterations of the ICP of each library on the same clouds: interleaved, CPU time, one thread, ratios to the core.

Only the registration is timed: clouds are converted before, and libraries that can keep an index over the target do.
"+ index" builds the index in the call: the core's cells, small_gicp's cloud and tree, KISS-ICP's voxel map, and
Open3D's tree, which cannot be kept. So compare rows with "+ index" with each other, and rows without. "+ table" is a
lasting target that was registered with before. The rows of cKDTree are its nearest-neighbour queries alone.
The pairing differs (one-to-one in the core and the NumPy reference, many-to-one in the others) and KISS-ICP uses
robust weights; clouds, guess, largest distance and iterations are the same. Karto's matcher (karto-scanmatcher, under
the GPL) takes scans and no clouds: its rows match one scan of the lab, from the same error of the guess, with as many
scans before it as have that number of beams; it searches, so that there are no iterations.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import time
from collections.abc import Callable
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
from evalkit_baselines.open3d_icp import open3d_missing
from evalkit_baselines.paper.icp import Icp

ITERATIONS = 20
LARGEST_M = 0.3
SOURCES = 1000
REFERENCE = "embedded"
TILES = 20_000
KISS_CELL_M, KISS_POINTS_PER_CELL, KISS_KERNEL_M = 0.12, 20, 0.1
GUESS_OFF = Pose(0.06, -0.04, 0.03)
MAX_ERROR_M = 0.05

Calls = dict[str, Callable[[], Any]]


def clouds(targets: int) -> tuple[Floats, Floats, Pose]:
    """Return ``targets`` points of the synthetic lab, 1,000 of two scans in the middle, and a guess 7 cm off."""
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
    middle, generator = len(scans) // 2, np.random.default_rng(0)
    source = np.concatenate(scans[middle : middle + 2])
    others = np.concatenate(scans[:middle] + scans[middle + 2 :])
    source = source[np.sort(generator.permutation(len(source))[:SOURCES])]
    target = others[np.sort(generator.permutation(len(others))[:targets])]
    return target, poses[middle].inverse().transform(source), poses[middle] @ GUESS_OFF


def core_methods(precision: Precision, name: str, target: Floats, source: Floats, guess: Pose) -> Calls:
    """Return the compiled core, with a kept index and with an index built in the call."""
    module = load_core(precision)
    icp = module.Icp(
        epsilon=0.0, max_iterations=ITERATIONS, error=0, error_before=False, one_to_one=True,
        max_correspondence=LARGEST_M, min_pairs=3,
    )  # fmt: skip
    to, points, row = to_real(target, module), to_real(source, module), (guess.x, guess.y, guess.theta)
    index = module.Index(to)
    lasting = module.Index(to, table=TILES)
    return {
        name: lambda: icp.register(index, points, row),
        f"{name} + table": lambda: icp.register(lasting, points, row),
        f"{name} + index": lambda: icp.register(module.Index(to), points, row),
    }


def reference_methods(target: Floats, source: Floats, guess: Pose) -> Calls:
    """Return the NumPy reference with a kept tree, and the queries alone of as many iterations, from the guess."""
    twin = Icp(epsilon=0.0, max_iterations=ITERATIONS, max_correspondence_m=LARGEST_M)
    fixed, moving = Cloud(target), Cloud(source)
    tree, placed = cKDTree(target), guess.transform(source)

    def queries() -> None:
        for _ in range(ITERATIONS):
            tree.query(placed, distance_upper_bound=LARGEST_M)

    return {"paper (NumPy)": lambda: twin.register(fixed, moving, guess), "cKDTree, queries": queries}


def small_gicp_methods(target: Floats, source: Floats, guess: Pose) -> Calls:
    """Return small_gicp's point-to-point with a kept tree (19 iterations of 20), and with a tree built in the call."""
    import small_gicp

    space = planar3d.points_3d(target)
    fixed, moving = small_gicp.PointCloud(space), small_gicp.PointCloud(planar3d.points_3d(source))
    tree = small_gicp.KdTree(fixed, num_threads=1)

    def align(cloud: Any, index: Any) -> Any:
        return small_gicp.align(
            cloud, moving, index, init_T_target_source=planar3d.matrix_4x4(guess), registration_type="ICP",
            max_correspondence_distance=LARGEST_M, num_threads=1, max_iterations=ITERATIONS, rotation_epsilon=0.0,
            translation_epsilon=0.0,
        )  # fmt: skip

    def rebuilt() -> Any:
        cloud = small_gicp.PointCloud(space)
        return align(cloud, small_gicp.KdTree(cloud, num_threads=1))

    return {"small_gicp": lambda: align(fixed, tree), "small_gicp + index": rebuilt}


def open3d_methods(target: Floats, source: Floats, guess: Pose) -> Calls:
    """Return Open3D's legacy point-to-point, which builds its tree in every call."""
    import open3d

    open3d.utility.set_max_threads(1)
    methods = open3d.pipelines.registration
    fixed, moving = (
        open3d.geometry.PointCloud(open3d.utility.Vector3dVector(planar3d.points_3d(points)))
        for points in (target, source)
    )
    estimation, initial = methods.TransformationEstimationPointToPoint(), planar3d.matrix_4x4(guess)
    stop = methods.ICPConvergenceCriteria(0.0, 0.0, ITERATIONS)
    return {
        "Open3D + index": lambda: methods.registration_icp(moving, fixed, LARGEST_M, initial, estimation, stop),
    }


def kiss_icp_methods(target: Floats, source: Floats, guess: Pose) -> Calls:
    """Return KISS-ICP's align_points_to_map with its map (20 points per cell of 12 cm) kept, and built in the call."""
    from kiss_icp.mapping import VoxelHashMap
    from kiss_icp.pybind import kiss_icp_pybind

    space = planar3d.points_3d(target)

    def make_map() -> Any:
        made = VoxelHashMap(KISS_CELL_M, 1e3, KISS_POINTS_PER_CELL)
        made.add_points(space)
        return made

    voxels = make_map()
    registration = kiss_icp_pybind._Registration(
        max_num_iterations=ITERATIONS, convergence_criterion=0.0, max_num_threads=1
    )
    points = kiss_icp_pybind._Vector3dVector(planar3d.points_3d(source))
    initial = planar3d.matrix_4x4(guess)

    def align(over: Any) -> Any:
        return registration._align_points_to_map(
            points=points,
            voxel_map=over._internal_map,
            initial_guess=initial,
            max_correspondance_distance=LARGEST_M,
            kernel=KISS_KERNEL_M,
        )

    return {"KISS-ICP": lambda: align(voxels), "KISS-ICP + index": lambda: align(make_map())}


def karto_methods(targets: int) -> Calls:
    """Return Karto's correlative matcher on scans of the lab with at least ``targets`` beams."""
    import karto_scanmatcher as karto

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
        if beams >= targets:
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
    return {"Karto, its own scans": lambda: matcher.match_scan(last, kept, True, True)}


def methods(target: Floats, source: Floats, guess: Pose) -> Calls:
    """Return all installed methods; the core is first, because the others are compared with it."""
    calls = core_methods("double", REFERENCE, target, source, guess)
    calls |= core_methods("float", "embedded-f32", target, source, guess)
    calls |= reference_methods(target, source, guess)
    if importlib.util.find_spec("small_gicp"):
        calls |= small_gicp_methods(target, source, guess)
    if not open3d_missing():
        calls |= open3d_methods(target, source, guess)
    if importlib.util.find_spec("kiss_icp"):
        calls |= kiss_icp_methods(target, source, guess)
    if importlib.util.find_spec("karto_scanmatcher"):
        calls |= karto_methods(len(target))
    return calls


def measure_ns(calls: Calls, rounds: int) -> dict[str, Floats]:
    """Return the CPU time (rounds,) of each call, in alternating order; three warm-up rounds are not counted."""
    times: dict[str, list[int]] = {name: [] for name in calls}
    for round_ in range(rounds + 3):
        for name in list(calls) if round_ % 2 else reversed(calls):
            start = time.process_time_ns()
            calls[name]()
            times[name].append(time.process_time_ns() - start)
    return {name: np.array(taken[3:], dtype=np.float64) for name, taken in times.items()}


def main() -> None:
    """Print the median CPU time of each method and its ratio to the core, paired round by round, with quartiles."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--rounds", type=int, default=40)
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
        target, source, guess = clouds(targets)
        times = measure_ns(methods(target, source, guess), arguments.rounds)
        print(f"{ITERATIONS} iterations, {len(source)} points against {len(target)}, {arguments.rounds} rounds")
        print(f"{'':22} {'CPU ms':>8} {'x ' + REFERENCE:>12} {'quartiles':>14}")
        for name, taken in times.items():
            low, ratio, high = np.percentile(taken / times[REFERENCE], [25, 50, 75])
            print(f"{name:22} {np.median(taken) / 1e6:8.2f} {ratio:12.2f} {low:7.2f}-{high:.2f}")
            series.append(BenchmarkSeries(f"{name}, {targets} points", "ms", tuple((taken / 1e6).tolist())))
    print(benchmark.write_benchmark("registration", series, ran_on))


if __name__ == "__main__":
    main()
