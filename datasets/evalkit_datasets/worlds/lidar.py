"""A model of the RPLIDAR A2M8: times and directions of its beams, and the errors of its ranges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.se2 import Floats, Stamps


@dataclass(frozen=True)
class LidarModel:
    """A lidar that rotates clockwise and samples at a constant rate; the defaults are the paper's RPLIDAR A2M8.

    8,000 samples per second at 5 to 15 revolutions per second give the paper's 1,600 to 533 beams. The range limits are
    those of the datasheet; ``noise_m``, the standard deviation of a range, is the paper's; ``dropout``, the share of
    beams without an answer, is assumed.
    """

    rate_hz: float = 10.0
    noise_m: float = 0.0483
    dropout: float = 0.01
    samples_per_s: int = 8000
    range_min_m: float = 0.15
    range_max_m: float = 12.0

    def __post_init__(self) -> None:
        if not 0.0 < self.rate_hz < self.samples_per_s:
            raise ValueError(f"rate_hz: expected more than 0 and less than {self.samples_per_s}, got {self.rate_hz}")
        if not self.noise_m >= 0.0:
            raise ValueError(f"noise_m: negative: {self.noise_m}")
        if not 0.0 <= self.dropout <= 1.0:
            raise ValueError(f"dropout: expected a share within [0, 1], got {self.dropout}")

    @property
    def beams(self) -> int:
        """Number of complete samples per revolution."""
        return int(self.samples_per_s / self.rate_hz + 1e-9)

    @property
    def time_increment_ns(self) -> int:
        """Nanoseconds between two beams."""
        return round(1e9 / self.samples_per_s)

    def angles(self) -> Floats:
        """Return the angles (B,) of a revolution in the sensor frame (rad), in firing order: clockwise from pi."""
        step = 2.0 * np.pi * self.rate_hz / self.samples_per_s
        return np.asarray(np.pi - step * np.arange(self.beams), dtype=np.float64)

    def stamps(self, duration_ns: int) -> Stamps:
        """Return the times (N,) of the first beams of all revolutions that end between 0 and a duration."""
        last_beam_ns = (self.beams - 1) * self.time_increment_ns
        count = int((duration_ns - last_beam_ns) * 1e-9 * self.rate_hz) + 1 if duration_ns >= last_beam_ns else 0
        return np.round(np.arange(count) * (1e9 / self.rate_hz)).astype(np.int64)

    def beam_stamps(self, stamps_ns: ArrayLike) -> Stamps:
        """Return the times (N, B) of all beams of revolutions that begin at times (N,)."""
        begins = np.asarray(stamps_ns, dtype=np.int64)
        return np.asarray(begins[:, None] + self.time_increment_ns * np.arange(self.beams))

    def add_errors(self, ranges: ArrayLike, noise: np.random.Generator, dropouts: np.random.Generator) -> Floats:
        """Return measured from true distances: with noise, ``inf`` beyond the range, ``nan`` if too near or dropped."""
        true = np.asarray(ranges, dtype=np.float64)
        measured = true + self.noise_m * noise.standard_normal(true.shape)
        measured[measured > self.range_max_m] = np.inf
        measured[measured < self.range_min_m] = np.nan
        measured[dropouts.random(true.shape) < self.dropout] = np.nan
        return measured
