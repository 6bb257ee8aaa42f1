"""Array types, and the check that frozen dataclasses run on their arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


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
