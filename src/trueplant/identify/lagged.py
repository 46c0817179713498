"""Sums of products with a signal and its past samples, as normal equations with many coefficients of noise need them.

The derivative of a prediction error by a coefficient of the noise model is the output error one sample earlier than
that by the coefficient before it. The sums are correlations, then, and those of the past with itself follow from one
row of them, sample by sample: nothing has to be written out once a coefficient.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from trueplant.arrays import Array, BoolArray
from trueplant.compiled import compiled


def at_samples(rows: Array, use: slice | BoolArray, order: int, n: int) -> Array:
    """(m, n) rows (m, n_used) of what `use` picks from sample `order` on, at their samples; 0 at all others."""
    out = np.zeros((len(rows), n))
    out[:, order:][:, use] = rows
    return out


def with_past(now: Array, past: Array, order: int) -> Array:
    """(m, order) sums over k of ``now[k] past[k - i]`` for i = 1 ... order, of now (m, n) and past (n,) or (m, n).

    `now` has to be 0 at its first `order` samples.
    """
    size = next_fast_len(now.shape[1] + order, real=True)
    return np.asarray(irfft(rfft(now, size) * rfft(past, size).conj(), size)[:, 1 : order + 1])


def gram_of_past(past: Array, use: slice | BoolArray, order: int) -> Array:
    """(order, order) sums of ``past[k - i] past[k - j]`` over the samples k that `use` picks from `order` on."""
    whole = _picked(past, use, order)
    return _gram(with_past(_before(past, whole)[None], past, order)[0], past, whole)


def moments_of_past(x: Array, use: slice | BoolArray, order: int) -> tuple[Array, Array]:
    """(order,) sums of ``x[k] x[k - i]`` over the samples k that `use` picks, and the `gram_of_past` of x."""
    whole = _picked(x, use, order)
    moment, first = with_past(np.stack([np.where(whole, x, 0.0), _before(x, whole)]), x, order)
    return moment, _gram(first, x, whole)


def _picked(x: Array, use: slice | BoolArray, order: int) -> BoolArray:
    whole = np.zeros(x.size, dtype=bool)
    whole[order:][use] = True
    return whole


def _before(past: Array, whole: BoolArray) -> Array:
    """(n,) the sample before each of the whole ones; 0 at all others."""
    before = np.zeros(past.size)
    before[1:] = np.where(whole[1:], past[:-1], 0.0)
    return before


def _gram(first: Array, past: Array, whole: BoolArray) -> Array:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], whole, [False]]).astype(np.int8)))
    gram: Array = _filled(first, past, edges[::2], edges[1::2] - 1)
    return gram


@compiled
def _filled(first: Array, past: Array, begins: Array, ends: Array) -> Array:
    """The gram from its first row: from one diagonal place to the next, each run of samples moves back by one."""
    order = first.size
    gram = np.empty((order, order))
    for apart in range(order):
        value = first[apart]
        gram[0, apart] = gram[apart, 0] = value
        for i in range(1, order - apart):
            for run in range(begins.size):
                early, late = begins[run] - 1 - i, ends[run] - i
                value += past[early] * past[early - apart] - past[late] * past[late - apart]
            gram[i, i + apart] = gram[i + apart, i] = value
    return gram
