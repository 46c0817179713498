"""A signal of any length as few points: of each stretch of time its lowest and its highest sample.

Ten million samples are reduced in some 30 ms, too long for every step of a zoom over several signals. So the extremes
of blocks of samples are kept (the second level of a pyramid), and what shows more than a few blocks a point is made
from them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trueplant.app import levels
from trueplant.arrays import Array, BoolArray, IntArray


@dataclass(frozen=True, eq=False)
class Signal:
    """One signal of a record, and the extremes of its blocks."""

    x: NDArray[np.floating]
    """(N,) NaN where it is missing; in single precision where that cannot be seen."""
    low: NDArray[np.floating]
    """(ceil(N / levels.BLOCK),) NaN where a block holds no number."""
    high: NDArray[np.floating]
    struck: BoolArray | None = None
    """(N,) samples that are not shown."""

    @classmethod
    def of(cls, x: Array) -> Signal:
        """Of a signal (N,)."""
        own = np.ascontiguousarray(x)
        low, high = _blocks(own)
        if _single(low, high):
            return cls(own.astype(np.float32), low.astype(np.float32), high.astype(np.float32))
        return cls(own, low, high)

    def without(self, struck: BoolArray) -> Signal:
        """The same with these samples (N,) not shown. Only blocks that hold one are looked at again."""
        if not struck.any():
            return Signal(self.x, *_blocks(self.x)) if self.struck is not None else self
        low, high = (self.low.copy(), self.high.copy()) if self.struck is None else _blocks(self.x)
        padded = np.zeros(low.size * levels.BLOCK, dtype=bool)
        padded[: struck.size] = struck
        touched = np.flatnonzero(padded.reshape(-1, levels.BLOCK).any(axis=1))
        index = touched[:, None] * levels.BLOCK + np.arange(levels.BLOCK)
        known = np.minimum(index, self.x.size - 1)
        part = np.where(padded[index] | (index >= self.x.size), np.nan, self.x[known])
        low[touched], high[touched] = np.fmin.reduce(part, axis=1), np.fmax.reduce(part, axis=1)
        return Signal(self.x, low, high, struck)

    def shown(self, first: int, end: int) -> NDArray[np.floating]:
        """The samples from one to before another, NaN where they are not shown."""
        part = self.x[first:end]
        return part if self.struck is None else np.where(self.struck[first:end], np.nan, part)

    def extremes(self, edges: IntArray) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """(n,) lowest and highest sample from each edge to before the next one; (n + 1,) edges that increase."""
        if coarse(edges, self.x.size):
            at = edges[:-1] // levels.BLOCK
            return np.fmin.reduceat(self.low[: -(-edges[-1] // levels.BLOCK)], at), np.fmax.reduceat(
                self.high[: -(-edges[-1] // levels.BLOCK)], at
            )
        part = self.shown(int(edges[0]), int(edges[-1]))
        at = edges[:-1] - edges[0]
        return np.fmin.reduceat(part, at), np.fmax.reduceat(part, at)


def _single(low: NDArray[np.floating], high: NDArray[np.floating]) -> bool:
    """Is single precision enough for a signal with these extremes?"""
    known = np.isfinite(low)
    if not known.any():
        return True
    bottom, top = float(low[known].min()), float(high[known].max())
    largest = max(-bottom, top)
    return bool(
        largest < np.finfo(np.float32).max and largest * np.finfo(np.float32).eps <= levels.UNSEEN * (top - bottom)
    )


def _blocks(x: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """The lowest and the highest sample of each block."""
    whole = x.size // levels.BLOCK
    body = x[: whole * levels.BLOCK].reshape(whole, levels.BLOCK)
    low, high = np.fmin.reduce(body, axis=1), np.fmax.reduce(body, axis=1)
    if rest := x[whole * levels.BLOCK :].size:
        tail = x[-rest:]
        low, high = np.append(low, np.fmin.reduce(tail)), np.append(high, np.fmax.reduce(tail))
    return low, high


def coarse(edges: IntArray, size: int) -> bool:
    """Are these edges those of blocks, but for the end of the signal?"""
    inner = edges[:-1] % levels.BLOCK
    return bool(edges.size > 1 and not inner.any() and (edges[-1] % levels.BLOCK == 0 or edges[-1] == size))


def edges_of(t: Array, start: float, end: float, points: int) -> IntArray:
    """Indices at which the stretches of a view begin, and where the last one ends: (n + 1,) that increase strictly.

    t (N,) increases. The stretches are equally long in time, those without a sample are left out; one sample before the
    view and one after it belong to it, so that lines run to its ends. Where there are fewer samples than `points`, each
    is a stretch by itself. Those of many samples begin and end with blocks.
    """
    first = max(int(np.searchsorted(t, start)) - 1, 0)
    stop = min(int(np.searchsorted(t, end, side="right")) + 1, t.size)
    if stop <= first:
        return np.zeros(0, dtype=np.int64)
    if stop - first <= points:
        return np.arange(first, stop + 1)
    inner = first + np.searchsorted(t[first:stop], np.linspace(t[first], t[stop - 1], points + 1)[1:-1])
    edges = np.concatenate([[first], inner, [stop]])
    if stop - first > levels.BLOCKS * levels.BLOCK * points:
        edges = edges // levels.BLOCK * levels.BLOCK
        edges[-1] = min(-(-stop // levels.BLOCK) * levels.BLOCK, t.size)
    return np.unique(edges)


def breaks(t: Array, edges: IntArray, gap: float) -> BoolArray:
    """(n,) does a gap longer than `gap` lie before each stretch? The first has none."""
    out = np.zeros(max(edges.size - 1, 0), dtype=bool)
    inner = edges[1:-1]
    out[1:] = t[inner] - t[inner - 1] > gap
    return out
