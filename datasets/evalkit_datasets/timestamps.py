"""Seconds written as decimal text to integer nanoseconds and back, without passing through a float."""

from __future__ import annotations

from decimal import Decimal, DecimalException

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.errors import brief
from evalkit.core.se2 import Stamps

_LIMIT = Decimal(2**63 - 1)


def stamp_ns(text: str) -> int:
    """The nanoseconds of seconds in text ("976052857.337284", "1.13486e+09"); ValueError where it is no time.

    A float holds a present-day time to a quarter of a microsecond only.

    >>> stamp_ns("976052857.337284001")
    976052857337284001
    """
    try:
        nanoseconds = Decimal(text).scaleb(9)
    except DecimalException:
        raise ValueError(f"{brief(text)} is no time in seconds") from None
    if not nanoseconds.is_finite() or abs(nanoseconds) > _LIMIT:
        raise ValueError(f"{brief(text)} is no time in seconds")
    return int(nanoseconds.to_integral_value())


def stamp_text(stamp_ns: int) -> str:
    """Seconds with nine decimals.

    >>> stamp_text(-1), stamp_text(976052857337284001)
    ('-0.000000001', '976052857.337284001')
    """
    whole, rest = divmod(abs(stamp_ns), 10**9)
    return f"{'-' if stamp_ns < 0 else ''}{whole}.{rest:09d}"


def ordered(stamps_ns: Stamps) -> tuple[Ints, int, int]:
    """Which entries to keep (K,) so that times increase, how often time went back, how many repeated a time.

    Of entries with the same time the first in the file stays.
    """
    backwards = int(np.count_nonzero(np.diff(stamps_ns) < 0))
    _, first = np.unique(stamps_ns, return_index=True)
    return np.asarray(first, dtype=np.int64), backwards, len(stamps_ns) - len(first)
