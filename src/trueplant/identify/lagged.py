"""Sums of products of a signal and the past samples of another: correlations, by Fourier transforms."""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from trueplant.arrays import Array, BoolArray


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
