"""The sequential part of a sticking valve."""

from __future__ import annotations

import numpy as np
from numba import njit

from trueplant.arrays import Array


@njit(cache=True)
def follow(op: Array, band: float) -> Array:
    """Position (N,) that takes OP's value whenever it is farther than `band` from it, and stays otherwise."""
    out = np.empty(op.size)
    at = op[0]
    for k in range(op.size):
        if abs(op[k] - at) > band:
            at = op[k]
        out[k] = at
    return out
