"""Array types, the check that frozen dataclasses run on their arrays, and the memory of large arrays."""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # malloc.h of glibc
_MAPPED_BYTES, _KEPT_BYTES = 32 << 20, 256 << 20


def freeze(
    owner: object,
    name: str,
    value: ArrayLike,
    shape: tuple[int | None, ...],
    dtype: type | np.dtype[np.void] = np.float64,
) -> None:
    """Set a field to a read-only array of ``dtype``; raises ValueError if it does not have ``shape`` (None: any)."""
    array = np.array(value, dtype=dtype)
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("N" if size is None else str(size) for size in shape)
        raise ValueError(f"{name}: expected shape ({wanted}{',' if len(shape) == 1 else ''}), got {array.shape}")
    array.flags.writeable = False
    object.__setattr__(owner, name, array)


def spread_indices(count: int, most: int) -> Ints:
    """Return at most ``most`` of the indices 0 to ``count - 1`` in order, spread evenly, first and last among them."""
    return np.linspace(0, count - 1, min(most, count)).astype(np.int64) if count > 0 else np.zeros(0, np.int64)


@cache
def keep_freed_memory() -> None:
    """Keep up to 256 MiB of freed memory in this process for its next arrays; only with glibc.

    Else the system maps and clears the pages of every array above 128 KiB anew: scoring a run takes 1.14 times as long.
    """
    if mallopt := getattr(ctypes.CDLL(None), "mallopt", None):
        mallopt(_M_MMAP_THRESHOLD, _MAPPED_BYTES)
        mallopt(_M_TRIM_THRESHOLD, _KEPT_BYTES)
