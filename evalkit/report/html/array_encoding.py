"""Encode arrays as short texts within a page: whole steps of a unit, differences, deflate, base64."""

from __future__ import annotations

import zlib
from base64 import b64decode, b64encode

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evalkit.core.se2 import Floats

Steps = NDArray[np.int32]

NONE = -(2**31)
"""The code of a missing number."""


def quantise(values: ArrayLike, unit: ArrayLike) -> Steps:
    """Return the values in whole units; ``NONE`` where not finite or beyond 2**31 - 1 units."""
    steps = np.round(np.asarray(values, dtype=np.float64) / np.asarray(unit))
    there = np.abs(np.where(np.isfinite(steps), steps, np.inf)) < 2.0**31
    return np.where(there, steps, NONE).astype(np.int32)


def dequantise(steps: Steps, unit: ArrayLike) -> Floats:
    """Return the values of ``quantise``, nan where missing."""
    return np.where(steps == NONE, np.nan, steps.astype(np.float64) * np.asarray(unit))


def pack_array(steps: Steps) -> str:
    """Return the text of an array (N,) or (N, K) with smooth columns; equal arrays give equal texts.

    Each row's difference from the row before (modulo 2**32), its sign in the lowest bit, all lowest bytes first, then
    the next ones; zlib (RFC 1950) and base64.
    """
    apart = np.diff(steps.astype(np.int64), axis=0, prepend=np.zeros_like(steps[:1], dtype=np.int64)).astype(np.int32)
    folded = ((apart << 1) ^ (apart >> 31)).astype("<u4")
    planes = np.ascontiguousarray(folded).view(np.uint8).reshape(-1, 4).T.tobytes()
    return b64encode(zlib.compress(planes, 9)).decode()


def unpack_array(text: str, shape: tuple[int, ...]) -> Steps:
    """Return the array of ``pack_array``, decoded as the page does."""
    planes = np.frombuffer(zlib.decompress(b64decode(text)), dtype=np.uint8)
    folded = np.ascontiguousarray(planes.reshape(4, -1).T).view("<u4").reshape(shape).astype(np.int64)
    apart = (folded >> 1) ^ -(folded & 1)
    return np.cumsum(apart, axis=0).astype(np.int32)
