"""Autoregressive noise models: which past samples share a coefficient, and prediction errors beside missing samples."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from trueplant.arrays import Array, BoolArray, IntArray
from trueplant.compiled import compiled
from trueplant.identify import levels

BLOCK = 1024
"""Samples that are filtered at a time."""


class Lags(NamedTuple):
    """Which past samples have a coefficient of their own in a noise model, and which share one.

    The nearest have one each. Of those further back more and more share one, so that few coefficients reach far: what
    is measured of noise long ago counts by its mean. All groups are parts of the same ones (`_group_end`).
    """

    single: int = 0
    """Samples with a coefficient each."""
    groups: int = 0
    """Groups of samples behind them."""

    @property
    def order(self) -> int:
        """Coefficients."""
        return self.single + self.groups

    @property
    def ends(self) -> IntArray:
        """(order,) the last lag of each coefficient."""
        return _ends(self)

    @property
    def starts(self) -> IntArray:
        """(order,) the first lag of each coefficient."""
        return np.append(1, self.ends[:-1] + 1)[: self.order]

    @property
    def reach(self) -> int:
        """The last lag of all."""
        return int(self.ends[-1]) if self.order else 0

    def within(self, reach: int) -> Lags:
        """The same with as many single lags and groups as do not reach further back."""
        single, groups = min(self.single, reach), self.groups
        while groups and Lags(single, groups).reach > reach:
            groups -= 1
        return Lags(single, groups)

    def predicted(self, measured: BoolArray, reach: int) -> BoolArray:
        """(n - reach,) which samples from the reach on are predicted from measured ones.

        Behind the single lags a few missing samples in a row do not matter: they are bridged (`bridge`).
        """
        if measured.all():
            return np.ones(max(measured.size - reach, 0), dtype=bool)
        edges = np.flatnonzero(np.diff(np.concatenate([[True], measured, [True]]).astype(np.int8)))
        bridged = measured.copy()
        for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            if begin > 0 and end < measured.size and end - begin <= levels.SPIKE_SAMPLES:
                bridged[begin:end] = True
        near = int(np.sum(self.starts == self.ends))
        good: BoolArray = _predicted(min(near, reach), reach, measured, bridged)
        return good

    def summed(self, by_lag: Array) -> Array:
        """(..., order) sums over the lags of each coefficient, of what is given for each lag (..., reach)."""
        if not self.groups:
            return by_lag
        return np.asarray(np.add.reduceat(by_lag, self.starts - 1, axis=-1))

    def past(self, v: Array, reach: int, out: Array | None = None) -> Array:
        """(order, n - reach) sums of ``v[k - lag]`` over the lags of each coefficient, for k from the reach on."""
        n = v.size
        out = np.empty((self.order, max(n - reach, 0))) if out is None else out
        whole = np.append(0.0, np.cumsum(v)) if self.groups else v
        for row, first, last in zip(out, self.starts.tolist(), self.ends.tolist(), strict=True):
            if first == last:
                row[:] = v[reach - first : n - first]
            else:
                row[:] = whole[reach - first + 1 : n - first + 1] - whole[reach - last : n - last]
        return out


def _group_end(first: int) -> int:
    """The last lag of the group that a lag is in: groups are a quarter as wide as they are far away."""
    begin = 1
    while True:
        width = max(1, int(begin * levels.SHARED_SPAN))
        if first < begin + width:
            return begin + width - 1
        begin += width


@lru_cache(maxsize=1024)
def _ends(lags: Lags) -> IntArray:
    ends = list(range(1, lags.single + 1))
    for _ in range(lags.groups):
        ends.append(_group_end((ends[-1] if ends else 0) + 1))
    return np.array(ends, dtype=int)


@lru_cache(maxsize=1024)
def furthest(single: int, reach: int) -> Lags:
    """So many single lags, and all groups behind them that do not reach beyond: the largest noise model."""
    lags = Lags(min(single, reach))
    while (more := Lags(lags.single, lags.groups + 1)).reach <= reach:
        lags = more
    return lags


@dataclass(frozen=True, eq=False)
class Autoregression:
    """A noise model: A(q) v = e, A(q) = 1 + a1 q^-1 + ..., e white."""

    coefficients: Array
    """(order,)"""
    lags: Lags
    waits: int = 0
    """Samples of which none is predicted, though the past of some may suffice."""

    @classmethod
    def plain(cls, coefficients: Array) -> Autoregression:
        """Of single lags."""
        return cls(coefficients, Lags(len(coefficients)))

    @property
    def order(self) -> int:
        """Coefficients."""
        return self.lags.order

    @property
    def reach(self) -> int:
        """Samples before the first that is predicted."""
        return max(self.lags.reach, self.waits)

    @property
    def taps(self) -> Array:
        """The coefficients of A(q), lag by lag, with the one that is 1."""
        widths = self.lags.ends - self.lags.starts + 1
        return np.append(1.0, np.repeat(self.coefficients, widths))

    @property
    def near_taps(self) -> Array:
        """Those as far as each sample has a coefficient of its own: further back no single sample shows."""
        lags = self.lags
        return self.taps[: 1 + int(np.sum(lags.starts == lags.ends))]

    def with_coefficients(self, coefficients: Array) -> Autoregression:
        return replace(self, coefficients=coefficients)

    def whiten(self, x: Array) -> Array:
        """A(q) x along the first axis of x (n,) or (n, m), without the first `reach` samples."""
        rows = np.ascontiguousarray(x.T, dtype=float).reshape(-1, len(x))
        out = self.whitened_rows(rows, 0)
        return out[0] if x.ndim == 1 else out.T

    def whitened_rows(self, rows: Array, first: int) -> Array:
        """(m, n) A(q) x of rows x (m, N) from sample reach + first on."""
        out = np.empty((len(rows), max(rows.shape[1] - self.reach - first, 0)))
        filter_rows(np.append(1.0, self.coefficients), self.lags.starts, self.lags.ends, rows, first + self.reach, out)
        return out

    def valid(self, measured: BoolArray) -> BoolArray:
        """(n - reach,) which samples are predicted from measured ones."""
        return self.lags.predicted(measured, self.reach)


NO_NOISE_MODEL = Autoregression.plain(np.zeros(0))


def whiten(coefficients: Array, x: Array) -> Array:
    """``x[k] + a1 x[k-1] + ... `` along the first axis of x (n,) or (n, m), without the first samples."""
    return Autoregression.plain(coefficients).whiten(x)


@compiled
def filter_rows(coefficients: Array, starts: IntArray, ends: IntArray, rows: Array, first: int, out: Array) -> None:
    """``c[0] x[k] + c[1] (x[k - starts[0]] + ... + x[k - ends[0]]) + ...`` of rows x (m, N) into (m, n), from sample
    `first` on.

    In blocks that stay in the fastest cache, coefficient by coefficient.
    """
    order, n = starts.size, out.shape[1]
    single = 0
    while single < order and starts[single] == ends[single]:
        single += 1
    sums = np.zeros(rows.shape[1] + 1)
    for i in range(out.shape[0]):
        x = rows[i]
        if single < order:
            for k in range(x.size):
                sums[k + 1] = sums[k] + x[k]
        for begin in range(0, n, BLOCK):
            end = min(begin + BLOCK, n)
            block = out[i, begin:end]
            block[:] = coefficients[0] * x[begin + first : end + first]
            for lag in range(1, single + 1):
                _add(block, coefficients[lag], x[begin + first - lag :])
            if single < order:  # what lies between two groups adds to the one and is taken from the other
                _add(block, coefficients[single + 1], sums[begin + first - single :])
                for c in range(single, order):
                    next_one = coefficients[c + 2] if c + 1 < order else 0.0
                    _add(block, next_one - coefficients[c + 1], sums[begin + first - ends[c] :])


@compiled
def _add(block: Array, weight: float, x: Array) -> None:
    for k in range(block.size):
        block[k] += weight * x[k]


def bridge(rows: Array, measured: BoolArray) -> Array:
    """Rows (..., n) with a straight line between those measured in place of what was not."""
    if measured.all() or not measured.any():
        return rows
    there, missing = np.flatnonzero(measured), np.flatnonzero(~measured)
    place = np.searchsorted(there, missing)
    before, after = there[np.maximum(place - 1, 0)], there[np.minimum(place, there.size - 1)]
    share = (missing - before) / np.maximum(after - before, 1)
    out: Array = rows.copy()
    out[..., missing] = (1 - share) * rows[..., before] + share * rows[..., after]
    return out


@compiled
def _predicted(near: int, reach: int, measured: BoolArray, bridged: BoolArray) -> BoolArray:
    """(n - reach,) where a sample and the `near` ones before it were measured, the others of the reach bridged."""
    good = np.zeros(max(measured.size - reach, 0), dtype=np.bool_)
    own = whole = 0
    for k in range(measured.size):
        own = own + 1 if measured[k] else 0
        whole = whole + 1 if bridged[k] else 0
        if k >= reach:
            good[k - reach] = own > near and whole > reach
    return good


def whitened_valid(order: int, valid: BoolArray) -> BoolArray:
    """Where a prediction error of this order uses measured samples only."""
    good: BoolArray = _predicted(order, order, valid, valid)
    return good
