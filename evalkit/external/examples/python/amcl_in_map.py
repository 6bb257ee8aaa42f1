"""Nav2's AMCL in a known map, with evalkit's line protocol: ``exec:python3 amcl_in_map.py``.

Needs ``pip install amcl numpy`` (not on Windows; GPL: it runs in this process only) and a map of ROS map_server (YAML
and binary PGM). ``evalkit compare drive.bag --map floor.yaml`` gives it the map and the start, as the parameters
``map`` and ``start_*``. It needs wheel odometry: in a gap of it the last pose is repeated. Particles are drawn from a
generator without a seed: two runs differ a little.
"""

import json
import math
import re
import sys
import time
from pathlib import Path

import amcl
import numpy as np

MAX_PIXELS = 100_000_000
HELLO = {
    "protocol": 1,
    "kind": "odometry",
    "summary": "Nav2's AMCL in a known map (amcl), from wheel odometry",
    "parameters": [
        {"name": "map", "default": "", "unit": "", "meaning": "YAML file of map_server; evalkit fills it in"},
        {"name": "start_x_m", "default": 0.0, "unit": "m", "meaning": "x of the base at its first scan, in the map"},
        {"name": "start_y_m", "default": 0.0, "unit": "m", "meaning": "y of it"},
        {"name": "start_deg", "default": 0.0, "unit": "deg", "meaning": "its heading"},
        {"name": "min_particles", "default": 100, "unit": "", "meaning": "smallest number of particles"},
        {"name": "max_particles", "default": 500, "unit": "", "meaning": "largest number of particles"},
        {"name": "beams", "default": 60, "unit": "", "meaning": "number of beams used"},
        {"name": "sigma_m", "default": 0.2, "unit": "m", "meaning": "standard deviation of a hit"},
        {"name": "start_sigma_m", "default": 0.1, "unit": "m", "meaning": "standard deviation of the start"},
        {"name": "start_sigma_rad", "default": 0.05, "unit": "rad", "meaning": "standard deviation of its angle"},
    ],
}


class Localisation:
    """The filter, and the start as x, y, theta in the map (m, m, rad)."""

    def __init__(self, grid, start, min_particles, max_particles, beams, sigma_m, start_sigma_m, start_sigma_rad):
        motion = amcl.MotionParameters(0.2, 0.2, 0.2, 0.2, 0.2)  # these and the next are Nav2's defaults
        laser = amcl.LaserParameters(
            z_hit=0.5, z_short=0.05, z_max=0.05, z_rand=0.5, sigma_hit=sigma_m, lambda_short=0.1, chi_outlier=0.0,
            max_beams=beams,
        )  # fmt: skip
        self.filter = amcl.AMCL(min_particles, max_particles, 0.001, 0.1, motion, laser, "differential")
        self.filter.set_map(grid)
        spread = amcl.Matrix3D()
        for axis, sigma in enumerate((start_sigma_m, start_sigma_m, start_sigma_rad)):
            spread.set(axis, axis, sigma**2)
        self.filter.set_initial_pose(amcl.Vector3D(*start), spread)
        self.start, self.answer, self.first = start, [0.0, 0.0, 0.0], True

    def update(self, question):
        """Return start_from_base."""
        wheels = question["odom_from_base"]
        if wheels is None:
            return self.answer
        self.filter.set_laser_pose(amcl.Vector3D(*question["base_from_sensor"]))
        longest = question["range_max_m"]
        beams = [
            [longest if each is None else each, angle]
            for each, angle in zip(question["ranges"], question["angles"], strict=True)
            if each != "nan"
        ]
        if beams:
            self.filter.update(amcl.create_laser_scan_from_list(beams, longest), amcl.Vector3D(*wheels))
            found = self.filter.get_pose_mean()
            self.answer = compose(inverse(self.start), [found.x, found.y, found.theta])
        if self.first:  # the first pose is the identity, whatever the particles say
            self.first, self.answer = False, [0.0, 0.0, 0.0]
        return self.answer


def read_map(path):
    """Return the grid of a map of map_server: 0 free, 100 occupied, -1 unknown; raises ValueError."""
    text = Path(path).read_text()
    fields = dict(re.findall(r"^(\w+):\s*(.+?)\s*$", text, re.MULTILINE))
    origin = [float(each) for each in fields["origin"].strip("[] ").split(",")]
    raw = (Path(path).parent / fields["image"].strip("'\"")).read_bytes()
    header = re.match(rb"P5\s+(?:#.*\n\s*)*(\d+)\s+(\d+)\s+255\s", raw)
    if not header or origin[2] != 0.0:
        raise ValueError(f"{path}: expected a binary PGM of 8 bits, and an origin that is not turned")
    width, height = int(header[1]), int(header[2])
    if width * height > min(MAX_PIXELS, len(raw) - header.end()):
        raise ValueError(f"{path}: the image has fewer pixels than {width} by {height}, or more than {MAX_PIXELS}")
    grey = np.frombuffer(raw, np.uint8, width * height, header.end()).reshape(height, width)[::-1]
    occupied = grey / 255.0 if fields.get("negate", "0") == "1" else 1.0 - grey / 255.0
    cells = np.where(occupied > float(fields["occupied_thresh"]), 100, -1)
    cells[occupied < float(fields["free_thresh"])] = 0
    return amcl.create_occupancy_grid_from_list(cells.tolist(), float(fields["resolution"]), origin[0], origin[1])


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
    localisation = None
    for line in sys.stdin:
        question = json.loads(line)
        if question["ask"] == "hello":
            answer = HELLO
        elif question["ask"] == "create":
            settings = question["parameters"]
            path = settings.pop("map")
            start = [settings.pop("start_x_m"), settings.pop("start_y_m"), math.radians(settings.pop("start_deg"))]
            try:
                localisation = Localisation(read_map(path), start, **settings)
                answer = {}
            except (OSError, KeyError, ValueError) as error:
                answer = {"failed": f"map '{path}': {error}; give a map with --map"}
        elif question["ask"] == "update":
            begun = time.perf_counter_ns()
            answer = {"pose": localisation.update(question)}
            answer["elapsed_ns"] = time.perf_counter_ns() - begun
        else:
            answer = {"failed": f"unknown question {question['ask']}"}
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
