"""Difference between the poses of the compiled core and of the NumPy reference over a drive."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from typing import Any

import numpy as np

from evalkit.core import se2
from evalkit.core.se2 import Floats
from evalkit.odometry import frontend
from evalkit.odometry.run_odometry import estimate_poses
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value
from evalkit.plugins.specs import FIRST_STAGE


def compare_poses(
    backends: tuple[str, str],
    parameters: Mapping[str, Value],
    dataset: str,
    sequence: Mapping[str, Value],
    scans: int,
) -> dict[str, Any]:
    """Largest distance (m) and angle (rad) between the poses of two back ends over the first scans, and their number.

    Both get the same parameters; a parameter that only one of them has keeps its default.
    """
    one, other = (_poses(name, parameters, dataset, sequence, scans) for name in backends)
    difference = se2.between(one, other)
    return {
        "apart_m": float(np.linalg.norm(difference[:, :2], axis=1).max()),
        "apart_rad": float(np.abs(difference[:, 2]).max()),
        "scans": len(one),
    }


def _poses(
    name: str, parameters: Mapping[str, Value], dataset: str, sequence: Mapping[str, Value], scans: int
) -> Floats:
    spec = registry.backend(name)
    known = {parameter.name for parameter in frontend.settable_parameters(spec)}
    own = {key: value for key, value in parameters.items() if key in known or key.startswith(FIRST_STAGE)}
    odometry = frontend.make_odometry(spec, frontend.complete_parameters(name, spec, own))
    frames = islice(registry.dataset(dataset).make(**sequence).frames(), scans)
    return estimate_poses(odometry, frames)
