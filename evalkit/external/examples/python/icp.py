"""Point-to-point ICP with evalkit's line protocol: ``exec:python3 icp.py``. Needs only NumPy, not evalkit."""

import json
import math
import sys
import time

import numpy as np

HELLO = {
    "protocol": 1,
    "kind": "registration",
    "summary": "point-to-point ICP in Python, over a pipe",
    "parameters": [
        {"name": "max_correspondence_m", "default": 0.5, "unit": "m", "meaning": "largest distance of a pair"},
        {"name": "max_iterations", "default": 40, "unit": "", "meaning": "largest number of iterations"},
    ],
}


def main():
    """Answer every line of standard input with a line, until the end of the input."""
    settings = {}
    for line in sys.stdin:
        question = json.loads(line)
        if question["ask"] == "hello":
            answer = HELLO
        elif question["ask"] == "create":
            settings = question["parameters"]
            answer = {}
        elif question["ask"] == "register":
            begun = time.perf_counter_ns()
            answer = register(question["target"], question["source"], question["guess"], **settings)
            answer["elapsed_ns"] = time.perf_counter_ns() - begun
        else:
            answer = {"failed": f"unknown question {question['ask']}"}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


def register(target, source, guess, max_correspondence_m, max_iterations):
    """Return the match of flat lists of points x0, y0, x1, y1, ..."""
    q, p = np.reshape(target, (-1, 2)), np.reshape(source, (-1, 2))
    x, y, theta = guess
    none = {"pose": guess, "converged": False, "iterations": 0, "error_m": None, "inliers": 0}
    if not len(p) or not len(q):
        return none
    for iteration in range(1, max_iterations + 1):
        moved = rotate(p, theta) + np.array([x, y])
        squared = np.square(moved[:, None, 0] - q[:, 0]) + np.square(moved[:, None, 1] - q[:, 1])
        nearest = squared.argmin(axis=1)
        distance = np.sqrt(squared[np.arange(len(p)), nearest])
        near = distance <= max_correspondence_m
        pairs = int(near.sum())
        if pairs < 3:
            return {**none, "iterations": iteration, "inliers": pairs}
        step = best_motion(moved[near], q[nearest[near]])
        (x, y), theta = rotate(np.array([[x, y]]), step[2])[0] + step[:2], theta + step[2]
        converged = math.hypot(step[0], step[1]) + abs(step[2]) < 1e-5
        if converged:
            break
    return {
        "pose": [float(x), float(y), float(theta)],
        "converged": converged,
        "iterations": iteration,
        "error_m": float(distance[near].mean()),
        "inliers": pairs,
    }


def best_motion(source, target):
    """Return x, y, theta of the least-squares motion for pairs of rows (N, 2)."""
    from_centre, to_centre = source.mean(axis=0), target.mean(axis=0)
    k = (source - from_centre).T @ (target - to_centre)
    theta = math.atan2(k[0, 1] - k[1, 0], k[0, 0] + k[1, 1])
    x, y = to_centre - rotate(from_centre[None], theta)[0]
    return float(x), float(y), theta


def rotate(points, theta):
    """Return the points (N, 2), rotated about the origin."""
    c, s = math.cos(theta), math.sin(theta)
    return points @ np.array([[c, s], [-s, c]])


if __name__ == "__main__":
    main()
