"""A SLAM with evalkit's line protocol: ``exec:python3 slam.py``. The method of ``../c/slam.c``; needs only NumPy.

ICP against the last keyframe, and a loop closed where the robot is back at its start.
"""

import json
import math
import sys

import numpy as np
from icp import register, rotate

MAX_POINTS, KEYFRAME_M, KEYFRAME_RAD, LOOP_M, MIN_SHARE = 400, 0.3, 0.3, 3.0, 0.7
NEAR_M = {"name": "near_m", "default": 0.5, "unit": "m", "meaning": "close the loop this near to the start; 0: never"}
HELLO = {"protocol": 1, "kind": "slam", "summary": "the SLAM of slam.c in Python, over a pipe", "parameters": [NEAR_M]}


class Slam:
    """Poses (3,): x, y, theta of ``start_from_base``, corrected."""

    def __init__(self, near_m):
        self.near_m, self.closed = near_m, 0  # closed: the frame that closed the last loop
        self.stamps, self.poses, self.path, self.closures, self.odom = [], [], [], [], None

    def update(self, frame):
        """Return the pose of a scan."""
        points, pose, away, path = read_points(frame), np.zeros(3), np.zeros(3), 0.0
        if self.poses:
            last, keyframe, step = self.poses[-1], self.poses[self.number], np.zeros(3)
            if self.odom and frame["odom_from_base"]:
                step = between(self.odom, frame["odom_from_base"])
            elif len(self.poses) > 1:
                step = between(self.poses[-2], last)  # constant velocity
            away, _ = match(self.keyframe, points, between(keyframe, compose(last, step)))
            pose = compose(keyframe, away)
            path = self.path[-1] + math.hypot(*(pose - last)[:2])
        else:
            self.first = self.keyframe = points
            self.number = 0
        self.stamps.append(frame["stamp_ns"])
        self.poses.append(pose)
        self.path.append(path)
        self.odom = frame["odom_from_base"]
        if path - self.path[self.closed] > LOOP_M and math.hypot(*pose[:2]) < self.near_m:
            self.close_loop(points)
        if not len(self.keyframe) or math.hypot(*away[:2]) > KEYFRAME_M or abs(away[2]) > KEYFRAME_RAD:
            self.keyframe, self.number = points, len(self.poses) - 1
        return self.poses[-1].tolist()

    def close_loop(self, points):
        """Match the last frame with the first, and spread the correction over the path since the last closed loop."""
        old, begin = self.poses[-1], self.path[self.closed]
        found, share = match(self.first, points, old)
        fits = share >= MIN_SHARE
        closure = {"stamp_ns": self.stamps[-1], "other_stamp_ns": self.stamps[0], "pose": found.tolist()}
        self.closures.append({**closure, "accepted": fits, "reason": "fits" if fits else "few pairs"})
        correction = compose(found, between(old, np.zeros(3)))
        for i in range(self.closed, len(self.poses) if fits else 0):
            part = (self.path[i] - begin) / (self.path[-1] - begin)
            self.poses[i] = compose(part * correction, self.poses[i])
        self.closed = len(self.poses) - 1 if fits else self.closed


def read_points(frame):
    """Return the hits (N, 2), each moved back to the first beam by its share of the motion within the scan."""
    beams, hits = len(frame["ranges"]), []
    for i in range(0, beams, 1 + (beams - 1) // MAX_POINTS):
        r, angle = frame["ranges"][i], frame["angles"][i]
        if isinstance(r, (int, float)):
            hit = compose(frame["base_from_sensor"], [r * math.cos(angle), r * math.sin(angle), 0.0])
            hits.append(compose(i / beams * np.array(frame["start_from_end"] or [0.0] * 3), hit)[:2])
    return np.reshape(hits, (-1, 2))


def match(target, source, guess):
    """Return ``target_from_source``, and the share of the source's points with a pair."""
    found = register(target, source, list(guess), max_correspondence_m=0.3, max_iterations=20)
    return np.array(found["pose"]), found["inliers"] / max(len(source), 1)


def compose(a, b):
    """Return ``a_from_c`` of ``a_from_b`` and ``b_from_c``."""
    return np.array([*(rotate(np.array([b[:2]]), a[2])[0] + a[:2]), a[2] + b[2]])


def between(a, b):
    """Return ``a_from_b`` of ``c_from_a`` and ``c_from_b``."""
    return compose([0.0, 0.0, -a[2]], [b[0] - a[0], b[1] - a[1], b[2]])


def main():
    """Answer every line of standard input with a line, until the end of the input."""
    slam = None
    for line in sys.stdin:
        question = json.loads(line)
        part = slice(question.get("from", 0), question.get("from", 0) + question.get("count", 0))
        answer = {"failed": f"unknown question {question['ask']}"}
        if question["ask"] == "hello":
            answer = HELLO
        elif question["ask"] == "create":
            slam, answer = Slam(**question["parameters"]), {}
        elif question["ask"] == "update":
            answer = {"pose": slam.update(question)}
        elif question["ask"] == "trajectory":
            answer = {"poses": np.ravel(slam.poses[part]).tolist()}
        elif question["ask"] == "loop_closures":
            answer = {"loop_closures": slam.closures[part]}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
