"""Skewed mu: the worst performance over the whole uncertainty, not that at which both grow together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trueplant.arrays import Array
from trueplant.errors import UsageError
from trueplant.robust import levels
from trueplant.robust.blocks import Block, Structure
from trueplant.robust.mu import mu


def worst_gain(N: ArrayLike, blocks: Sequence[Block], fixed: int) -> tuple[Array, Array]:
    """Bounds (n_s,) of the size of the rest while the first `fixed` blocks of Delta take their worst of size 1 or less.

    The m for which mu of N with the rows of the remaining blocks divided by m is 1; infinite where mu of the fixed
    blocks alone reaches 1. With N of generalised_plant: the largest |wP S| over the plants in the set
    (Skogestad and Postlethwaite 2005, section 8.10.3). Raises UsageError.
    """
    matrices = np.asarray(N, dtype=np.complex128)
    if matrices.ndim != 3:
        raise UsageError(f"the worst gain needs matrices (n_s, n_z, n_w), not an array of shape {matrices.shape}")
    Structure.of(blocks, matrices.shape[1:])
    if not 0 < fixed < len(blocks):
        raise UsageError(f"of {len(blocks)} blocks between 1 and {len(blocks) - 1} can be fixed, not {fixed}")
    n_z, n_w = Structure(tuple(blocks[:fixed])).shape
    inner = mu(matrices[:, :n_z, :n_w], blocks[:fixed])
    rest = mu(matrices[:, n_z:, n_w:], blocks[fixed:])

    def solved(side: str) -> Array:
        """Bisection and secants in log m, all frequencies at once."""
        value = np.full(len(matrices), np.inf)
        pending = np.flatnonzero(getattr(inner, side) < 1)
        if pending.size == 0:
            return value

        def excess(m: Array, which: NDArray[np.intp]) -> Array:
            scaled = matrices[which].copy()
            scaled[:, n_z:] /= m[:, None, None]
            return np.asarray(np.log(np.maximum(getattr(mu(scaled, blocks), side), 1e-300)))

        low = np.maximum(getattr(rest, side)[pending], 1e-12 * np.max(np.abs(matrices[pending]), axis=(1, 2)))
        low = np.maximum(low, 1e-300)
        high, f_low = 2 * low, np.maximum(excess(low, pending), 0.0)
        f_high = excess(high, pending)
        while np.any(f_high > 0):
            up = f_high > 0
            low[up], f_low[up] = high[up], f_high[up]
            high[up] *= 4
            f_high[up] = excess(high[up], pending[up])
        a, b = np.log(low), np.log(high)
        for turn in range(60):
            share = np.clip(f_low / np.maximum(f_low - f_high, 1e-300), *levels.SECANT) if turn % 3 else 0.5
            middle = a + share * (b - a)
            f = excess(np.exp(middle), pending)
            a, f_low = np.where(f > 0, middle, a), np.where(f > 0, f, f_low)
            b, f_high = np.where(f > 0, b, middle), np.where(f > 0, f_high, f)
            if np.max(b - a) < levels.WORST_GAIN:
                break
        value[pending] = np.exp(b if side == "upper" else a)
        return value

    return solved("lower"), solved("upper")
