"""A historian that compresses: the swinging door, and what it gives back when asked for every sample."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)
def _stored(t, y, deviation):
    """Where the swinging door keeps a sample: the last one before no line stays within the deviation of all since."""
    kept = np.zeros(y.size, dtype=np.bool_)
    kept[0] = kept[-1] = True
    at, low, high = 0, -np.inf, np.inf
    for k in range(1, y.size):
        span = t[k] - t[at]
        low = max(low, (y[k] - deviation - y[at]) / span)
        high = min(high, (y[k] + deviation - y[at]) / span)
        if low > high:
            at = k - 1
            kept[at] = True
            span = t[k] - t[at]
            low, high = (y[k] - deviation - y[at]) / span, (y[k] + deviation - y[at]) / span
    return kept


def swinging_door(y: Array, deviation: float) -> Array:
    """y (N,) as a historian with this compression deviation gives it back, straight lines between what it stored.

    The swinging door of Bristol (1990): a snapshot is stored as soon as no straight line from the last stored one
    passes within `deviation` of every snapshot since. Deviation 0 keeps y where no three samples lie on one line.
    """
    t = np.arange(y.size, dtype=float)
    kept = _stored(t, np.ascontiguousarray(y, dtype=float), float(deviation))
    return np.interp(t, t[kept], y[kept])
