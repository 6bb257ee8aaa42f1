"""Convert between integer nanoseconds and seconds as decimal text, without floating point; put stamps in order."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal, DecimalException

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.errors import brief
from evalkit.core.se2 import Stamps

MAX_NS = 2**62 - 1
"""The largest time: 146 years. The difference of two times fits into 64 bits."""


def parse_stamp_ns(text: str) -> int:
    """Return the nanoseconds of a time in seconds ("976052857.337284", "1.13486e+09").

    Raises ValueError if the text is not a time. A float would resolve a present-day time to 0.25 us only.

    >>> parse_stamp_ns("976052857.337284001")
    976052857337284001
    """
    try:
        nanoseconds = Decimal(text).scaleb(9)
    except DecimalException:
        raise ValueError(f"{brief(text)} is not a time in seconds") from None
    if not nanoseconds.is_finite() or abs(nanoseconds) > MAX_NS:
        raise ValueError(f"{brief(text)} is not a time in seconds")
    return int(nanoseconds.to_integral_value())


def format_stamp(stamp_ns: int) -> str:
    """Return a time in seconds with nine decimals.

    >>> format_stamp(-1), format_stamp(976052857337284001)
    ('-0.000000001', '976052857.337284001')
    """
    whole, rest = divmod(abs(stamp_ns), 10**9)
    return f"{'-' if stamp_ns < 0 else ''}{whole}.{rest:09d}"


@dataclass(frozen=True, eq=False)
class StampOrder:
    """Indices ``keep`` (K,) that make stamps strictly increasing, and counts of steps back and of repeated stamps."""

    keep: Ints
    backwards: int
    repeated: int


def order_stamps(stamps_ns: Stamps) -> StampOrder:
    """Return the order of stamps (N,) by time; of entries with equal stamps the first is kept."""
    backwards = int(np.count_nonzero(np.diff(stamps_ns) < 0))
    _, first = np.unique(stamps_ns, return_index=True)
    return StampOrder(np.asarray(first, dtype=np.int64), backwards, len(stamps_ns) - len(first))
