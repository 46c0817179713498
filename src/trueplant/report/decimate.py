"""Long records are drawn with fewer points, without losing their extremes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trueplant.arrays import Array
from trueplant.report import levels


def min_max(t: Array, x: Array, limit: int) -> tuple[Array, Array]:
    """The lowest and the highest sample of each of `limit`/2 stretches, in order of time.

    t and x (N,); at most `limit` samples come back. A stretch that holds no number stays a gap (NaN).
    """
    if t.size <= limit:
        return t, x
    width = -(-t.size // (limit // 2))
    rows = -(-t.size // width)
    padded = np.full(rows * width, np.nan)
    padded[: x.size] = x
    blocks = padded.reshape(rows, width)
    missing = np.isnan(blocks)
    lowest = np.where(missing, np.inf, blocks).argmin(axis=1)
    highest = np.where(missing, -np.inf, blocks).argmax(axis=1)
    kept = np.sort(np.column_stack([lowest, highest]), axis=1) + width * np.arange(rows)[:, None]
    index = np.unique(kept)
    return t[index], x[index]


def compact(x: Array) -> NDArray[np.floating]:
    """In single precision where that cannot be seen (rounding below 1e-5 of the range), else as it is."""
    with np.errstate(over="ignore"):
        single = x.astype(np.float32)
    finite = np.isfinite(x) & np.isfinite(single)
    if not np.array_equal(finite, np.isfinite(x)):
        return x
    if not finite.any():
        return single
    error = np.abs(single[finite] - x[finite]).max()
    return single if error <= 1e-5 * np.ptp(x[finite]) else x


def merged(spans: list[tuple[float, float]], gap: float) -> list[tuple[float, float]]:
    """`spans` in order of time; those nearer to each other than `gap` become one."""
    joined: list[tuple[float, float]] = []
    for low, high in sorted(spans):
        if joined and low - joined[-1][1] <= gap:
            joined[-1] = (joined[-1][0], max(joined[-1][1], high))
        else:
            joined.append((low, high))
    return joined


def at_rest(lines: Sequence[Array]) -> int:
    """Samples until all that is drawn has come to rest, and a little more."""
    last = 2
    for y in lines:
        known = y[np.isfinite(y)]
        away = np.flatnonzero(np.abs(known - known[-1]) > levels.AT_REST * np.ptp(known))
        last = max(last, int(away[-1]) if away.size else 2)
    return min(int(levels.BEYOND_REST * last) + 2, max((len(y) for y in lines), default=0))
