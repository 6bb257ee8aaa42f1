"""Karto's scan matcher with evalkit's line protocol: ``exec:python3 karto.py``.

Needs ``pip install karto-scanmatcher`` (Linux, Python 3.8 to 3.11). That package is under the GPL: it runs in this
process only. As in slam_toolbox, a scan is matched with the last scans that were kept, from the wheels' motion, and
kept after 0.5 m or 0.5 rad. Karto knows no motion within a scan: it is not undone. Beams must be evenly spaced.
"""

import json
import math
import sys
import time
from collections import deque

import karto_scanmatcher as karto

HELLO = {
    "protocol": 1,
    "kind": "odometry",
    "summary": "Karto's correlative scan matcher (karto-scanmatcher), from wheel odometry",
    "parameters": [
        {"name": "search_m", "default": 0.5, "unit": "m", "meaning": "side of the square that is searched"},
        {"name": "smear_m", "default": 0.03, "unit": "m", "meaning": "standard deviation of a point"},
        {"name": "max_range_m", "default": 12.0, "unit": "m", "meaning": "longest range used"},
        {"name": "scans", "default": 10, "unit": "", "meaning": "number of kept scans to match with"},
        {"name": "keep_m", "default": 0.5, "unit": "m", "meaning": "keep a scan after this distance"},
        {"name": "keep_rad", "default": 0.5, "unit": "rad", "meaning": "or after this turn"},
    ],
}


class Odometry:
    """The matcher, the kept scans and the last poses of base and wheels (x, y, theta)."""

    def __init__(self, search_m, smear_m, max_range_m, scans, keep_m, keep_rad):
        config = karto.ScanMatcherConfig()
        config.search_size, config.smear_deviation, config.range_threshold = search_m, smear_m, max_range_m
        self.matcher = karto.Wrapper(config)
        self.max_range_m, self.keep_m, self.keep_rad = max_range_m, keep_m, keep_rad
        self.kept = deque(maxlen=scans)
        self.count = 0
        self.base = self.wheels = self.last_kept = None

    def update(self, question):
        """Return the pose of the base at the first beam."""
        wheels, mounting = question["odom_from_base"], question["base_from_sensor"]
        if self.base is None:
            self.base = [0.0, 0.0, 0.0]
        elif wheels is not None and self.wheels is not None:
            self.base = compose(self.base, compose(inverse(self.wheels), wheels))
        self.wheels = wheels
        scan = self.scan(question, compose(self.base, mounting))
        if self.kept and scan is not None:
            found = self.matcher.match_scan(scan, list(self.kept), True, True).best_pose
            self.base = compose([found.x, found.y, found.yaw], inverse(mounting))
        if scan is not None and self.is_far():
            self.kept.append(self.scan(question, compose(self.base, mounting)))
            self.last_kept = self.base
        return self.base

    def is_far(self):
        """Return whether the base moved far enough to keep this scan."""
        if self.last_kept is None:
            return True
        x, y, theta = compose(inverse(self.last_kept), self.base)
        return math.hypot(x, y) >= self.keep_m or abs(theta) >= self.keep_rad

    def scan(self, question, world_from_sensor):
        """Return Karto's form of a scan, counter-clockwise; None without returns."""
        angles, ranges = question["angles"], question["ranges"]
        if len(angles) < 2 or not any(isinstance(each, float) for each in ranges):
            return None
        if angles[-1] < angles[0]:
            angles, ranges = angles[::-1], ranges[::-1]
        step = (angles[-1] - angles[0]) / (len(angles) - 1)
        none = self.max_range_m + 10.0  # beyond the threshold: not used
        metres = [each if isinstance(each, (int, float)) else none for each in ranges]
        limits = question["range_min_m"], max(question["range_max_m"], none + 1.0)
        sensor = karto.LaserScanConfig(angles[0], angles[-1], step, *limits, self.max_range_m, "lidar")
        pose = karto.Pose2(*world_from_sensor)
        self.count += 1
        return karto.LocalizedRangeScan(sensor, metres, pose, pose, self.count, question["stamp_ns"] * 1e-9)


def compose(a, b):
    """Return a_from_c of a_from_b and b_from_c."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return [a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], math.remainder(a[2] + b[2], 2.0 * math.pi)]


def inverse(a):
    """Return b_from_a."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return [-c * a[0] - s * a[1], s * a[0] - c * a[1], -a[2]]


def main():
    """Answer every line of standard input with a line, until the end of the input."""
    odometry = None
    for line in sys.stdin:
        question = json.loads(line)
        if question["ask"] == "hello":
            answer = HELLO
        elif question["ask"] == "create":
            odometry = Odometry(**question["parameters"])
            answer = {}
        elif question["ask"] == "update":
            begun = time.perf_counter_ns()
            answer = {"pose": odometry.update(question)}
            answer["elapsed_ns"] = time.perf_counter_ns() - begun
        else:
            answer = {"failed": f"unknown question {question['ask']}"}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
