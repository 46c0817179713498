"""Runs of equal values and of True, without loops over samples."""

from __future__ import annotations

import numpy as np

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.record import levels


def several(x: Array, count: int) -> bool:
    """Does x take at least so many different values?"""
    seen: set[float] = set()
    for k in range(0, x.size, levels.BLOCK):
        seen.update(np.unique(x[k : k + levels.BLOCK])[:count].tolist())
        if len(seen) >= count:
            return True
    return False


def true_runs(mask: BoolArray) -> tuple[IntArray, IntArray]:
    """First index and length of each run of True."""
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    begin = np.flatnonzero(edges == 1)
    return begin, np.flatnonzero(edges == -1) - begin


def equal_runs(x: Array) -> tuple[IntArray, IntArray]:
    """First index and length of each run of equal values."""
    begin = np.concatenate([[0], np.flatnonzero(np.diff(x) != 0) + 1])
    return begin, np.diff(np.concatenate([begin, [x.size]]))


def spread(begin: IntArray, length: IntArray, size: int) -> BoolArray:
    """The mask (size,) that is True on the given runs; the inverse of `true_runs`."""
    edges = np.zeros(size + 1, dtype=np.int64)
    np.add.at(edges, begin, 1)
    np.add.at(edges, begin + length, -1)
    return np.asarray(np.cumsum(edges[:-1]) > 0, dtype=bool)


def spans_of(t: Array, mask: BoolArray) -> tuple[tuple[float, float], ...]:
    """(from, to) of each run of True, in the time of t: of very many the longest, in their order."""
    begin, length = true_runs(mask)
    if begin.size > levels.MOST_SPANS:
        longest = np.sort(np.argsort(-length, kind="stable")[: levels.MOST_SPANS])
        begin, length = begin[longest], length[longest]
    return tuple((float(t[a]), float(t[b])) for a, b in zip(begin, begin + length - 1, strict=True))


def hold_short(x: Array, longest: int) -> tuple[Array, BoolArray]:
    """x (N, m) with NaN runs of up to `longest` samples filled by the value before; and where that was done.

    It is x itself where nothing is missing.
    """
    where = np.zeros(x.shape, dtype=bool)
    missing = np.isnan(x)
    if not missing.any():
        return x, where
    filled = x.copy()
    for j in range(x.shape[1]):
        begin, length = true_runs(missing[:, j])
        short = (length <= longest) & (begin > 0)
        if short.any():
            where[:, j] = spread(begin[short], length[short], x.shape[0])
            last = np.maximum.accumulate(np.where(where[:, j], 0, np.arange(x.shape[0])))
            filled[:, j] = x[last, j]
    return filled, where


def hold_same(x: Array) -> Array:
    """x (N, m) with NaN runs filled where the values before and after are the same, as those of a set-point are.

    It is x itself where nothing is missing.
    """
    missing = np.isnan(x)
    if not missing.any():
        return x
    filled = x.copy()
    for j in range(x.shape[1]):
        begin, length = true_runs(missing[:, j])
        inner = (begin > 0) & (begin + length < x.shape[0])
        begin, length = begin[inner], length[inner]
        same = x[begin - 1, j] == x[begin + length, j]
        filled[spread(begin[same], length[same], x.shape[0]), j] = np.repeat(x[begin[same] - 1, j], length[same])
    return filled
