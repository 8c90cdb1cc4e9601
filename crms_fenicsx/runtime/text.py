"""Numbers as one line of text shows them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crms_fenicsx.runtime.arrays import Array


def span(values: Sequence[float] | Array) -> str:
    """From the least value to the largest; NaN are left out.

    >>> span([3.0, 1.0])
    '1 to 3'
    """
    known = np.asarray(values, dtype=np.float64).ravel()
    known = known[np.isfinite(known)]
    if len(known) == 0:
        return "none"
    low, high = f"{known.min():.4g}", f"{known.max():.4g}"
    return low if low == high else f"{low} to {high}"


def counted(n: int, what: str) -> str:
    """How many there are of something.

    >>> counted(2, "cell")
    '2 cells'
    """
    return f"{n} {what}{'' if n == 1 else 's'}"
