"""The planted faults of ``odometry.c``; names and list were written before any of them was examined."""

from __future__ import annotations

from fault import Fault

FAULTS = tuple(
    Fault(*row)
    for row in (
        (401, "the first answer is the wheels' pose", "rule first"),
        (402, "the pose of the last beam is returned", "rule first-beam"),
        (403, "the mounting of the lidar is not used", "rule mounting"),
        (404, "the sweep is not deskewed", "rule first-beam|deskew"),
        (405, "the wheel odometry is not used", "rule follows|wheel|prior"),
        (406, "missing wheel odometry is read", "rule (without-odometry|odometry-gap|alive)"),
        (407, "all instances are one", "rule (fresh|deterministic|first)"),
        (408, "a scan leaks 64 bytes", "rule memory"),
        (409, "nan is a wall", "rule values|invalid"),
        (410, "no return is a wall", "rule (values|no-hits)|no return"),
        (411, "the angles of the beams are not read", "trajectory|angle|rule radians"),
        (412, "stamps have 32 bits", "rule stamps"),
        (413, "every fifth scan is skipped", "rule first-beam|skipped"),
        (414, "the heading is in degrees", "degrees"),
        (415, "the answer is the inverse", "inverse|base_from_start"),
        (416, "missing wheel odometry is the origin", "rule (odometry-gap|without-odometry)"),
        (417, "the answer depends on the clock", "rule (later|deterministic|process)"),
        (418, "only 200 beams are used", "trajectory|beams"),
        (419, "without wheel odometry the answer is nan", "rule (without-odometry|odometry-gap)"),
        (420, "an instance leaks", "rule memory"),
        (421, "the ranges are written to", "rule (read-only|bounds)"),
        (422, "the answer depends on the process number", "rule process"),
        (423, "the angles are in the reverse order", "rule (radians|follows|moves)"),
        (424, "ranges are rounded to 5 cm", "trajectory|round|cut to 0.05 m"),
        (425, "the time between beams is not used", "rule first-beam|deskew"),
        (426, "the turn within a scan has the wrong sign", "rule first-beam|trajectory"),
        (427, "ranges beyond 5 m are not used", "trajectory|range"),
        (428, "answers are one scan late", "rule first-beam|late"),
        (429, "the answer is in millimetres", "millimetres|1000 times"),
    )
)
